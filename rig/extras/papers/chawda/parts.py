"""Compute linear theory, the constant C of Levant's differentiator, and check values for the paper of Chawda et al.

Each public function is the work of one task of the sweep that runs the reproduction (`rig.extras.papers.parts`): it
takes and returns values that JSON can store, and has no side effects.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from rig import config
from rig.analysis import theory
from rig.analysis.impedance import periodic
from rig.analysis.theory import linear_loop
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.experiments.estimation.interface import AFTER_CONTACT_S, BEFORE_CONTACT_S, identify_lipschitz
from rig.experiments.hits.compare import Start, simulate
from rig.experiments.mapping.interface import StiffnessSearch, passive_limit
from rig.experiments.trials.excitation_run import ExcitedRig
from rig.extras.papers.chawda.readings import read
from rig.extras.papers.chawda.rigs import FIGURE_3_RATE, FILTERED_SCHEME, Reading, pushed_rig

# A rig as linear theory sees it: no friction, next to no quantum.
# The protocol has 16 bits for a current, which limits the efforts.
IDEAL = {
    "rig.mechanics.motor_coulomb": 0.0,
    "rig.encoder.quantum": 1e-12,
    "rig.amplifier.current_quantum_a": 1e-7,
    "rig.amplifier.effort_per_ampere": 100.0,
    "rig.amplifier.effort_limit": 0.3,
    "rig.limits.effort": 0.3,
    "rig.limits.nominal_effort": 0.3,
    "homing.effort": 0.1,
    "trial.effort": 0.1,
    "trial.minimum_rest_counts": 0.0,
    "excitation.rms": 0.02,
}
LIPSCHITZ_OFFSET = 0.1  # of the encoder
LIPSCHITZ_S = 0.5  # of the hit: the fit takes the first 60 ms of contact
# A wall at 99 % of its passive stiffness leaves a mass of 0.52 kg a damping of 0.13 N·s/m: its oscillation needs 8 s.
CONTROL_SETTLING = 40  # periods


def linear(payload: Mapping[str, Any]) -> dict[str, Any]:
    """Compute the largest stable and the largest passive stiffness (N/m) of one sampling scheme by linear theory.

    `payload` has ``experiment``, ``scheme`` (with a linear estimator), ``dampings`` (N·s/m), and the lower and upper
    edges (``low_hz``, ``highest_hz``) of the bands in which passivity is tested, every 1 Hz. In the result ``stable``
    has a stiffness for each damping, ``passive`` a list of stiffnesses for each upper edge; ``range`` is the largest
    stable damping (N·s/m).
    """
    experiment = config.restore_experiment(payload["experiment"])
    scheme, dampings = Scheme.parse(payload["scheme"]), payload["dampings"]
    stable = [limit.stiffness for limit in theory.k_max_curve(experiment, scheme, dampings)]
    loop = linear_loop(experiment, scheme)
    passive = [
        [
            passive_limit(loop, b, k, np.arange(payload["low_hz"], high + 1.0))
            for b, k in zip(dampings, stable, strict=True)
        ]
        for high in payload["highest_hz"]
    ]
    return {"stable": stable, "passive": passive, "range": theory.damping_range(experiment, scheme)}


def constant(payload: Mapping[str, Any]) -> dict[str, float]:
    """Identify the constant C of Levant's differentiator from a simulated hit on a wall.

    `payload` has the wall's ``stiffness`` (N/m) and ``damping`` (N·s/m).
    """
    return identify_wall(payload["stiffness"], payload["damping"])


def identify_wall(stiffness: float, damping: float) -> dict[str, float]:
    """Identify C, the bound of the acceleration for Levant's differentiator, from one simulated hit on a wall.

    The hit has a rate of 10 kHz and uses the filtered difference. A sum of sines is fitted to the encoder counts around
    the contact. The result has ``lipschitz``, C (m/s²) to three digits; ``residual_rms`` of the fit (m); ``true``, the
    largest acceleration of the simulation in the same interval (m/s²); ``impact_velocity`` (m/s); and the wall's
    ``stiffness`` and ``damping``.
    """
    changes = {"wall.stiffness": stiffness, "wall.damping": damping, "trial.duration_s": LIPSCHITZ_S}
    experiment = config.override(FILTERED_SCHEME.applied(pushed_rig(FIGURE_3_RATE)), changes, "a hit")
    _, plant, trace = simulate(experiment, Start.of(experiment), LIPSCHITZ_OFFSET)
    position = trace.counts * experiment.rig.encoder.resolution
    time_s = np.arange(len(position)) / FIGURE_3_RATE
    contact = int(np.flatnonzero(trace.counts > 0)[0])
    since = time_s - time_s[contact]
    chosen = (since >= -BEFORE_CONTACT_S) & (since <= AFTER_CONTACT_S)
    fitted = identify_lipschitz(time_s[chosen], position[chosen])
    velocity = trace.states[:, plant.sensed_position + 1]
    return {
        "stiffness": stiffness,
        "damping": damping,
        "lipschitz": float(f"{fitted.lipschitz:.3g}"),
        "residual_rms": fitted.residual_rms,
        "true": float(np.abs(np.diff(velocity[chosen])).max() * FIGURE_3_RATE),
        "impact_velocity": float(velocity[contact]),
    }


def control(payload: Mapping[str, Any]) -> dict[str, float]:
    """Compute two values that theory predicts, to check the method, on a rig without friction and encoder quantisation.

    `payload` has the experiment, the scheme, the search and the band. ``stiffness`` is the largest K (N/m) at B = 0
    whose impedance is passive without any tolerance, by bisection; ``fidelity`` is the rms of |Z| without a wall
    (N·s/m).
    """
    experiment = _ideal(config.restore_experiment(payload["experiment"]))
    reading = [Reading(low_hz=payload["low_hz"], high_hz=payload["high_hz"], tolerance=0.0)]
    bench = ExcitedRig(experiment)

    def excited(stiffness: float) -> tuple[bool, float]:
        run = bench.excite(stiffness, 0.0)
        if run.record is None:
            return False, math.nan
        passes, errors = read(periodic([run.record]), stiffness, 0.0, reading)
        return bool(passes[0]), float(errors[0])

    rungs = StiffnessSearch(**payload["search"]).rungs
    low, high = -1, len(rungs)
    while high - low > 1:
        middle = (low + high) // 2
        passes, _ = excited(rungs[middle])
        low, high = (middle, high) if passes else (low, middle)
    _, fidelity = excited(0.0)
    return {"stiffness": rungs[low] if low >= 0 else 0.0, "fidelity": fidelity}


def control_payload(
    experiment: Experiment, scheme: Scheme, search: StiffnessSearch, band: tuple[float, float]
) -> Any:
    """Return the argument of `control`, which compares a sampling scheme with theory; `band` is in Hz."""
    applied, (low_hz, high_hz) = scheme.applied(config.excited(experiment)), band
    return {
        "experiment": config.as_mapping(applied),
        "search": asdict(search),
        "low_hz": low_hz,
        "high_hz": high_hz,
    }


def _ideal(experiment: Experiment) -> Experiment:
    """Return the experiment without friction and quantisation, with one draw of the excitation's phases."""
    ideal = config.override(experiment, IDEAL, "a control")
    return replace(
        ideal,
        excitation=replace(ideal.excitation, realisations=1, settle_periods=CONTROL_SETTLING, periods=2),
    )


def fidelity_without_wall(mass: float, damping: float, band: tuple[float, float]) -> float:
    """Return the rms of |Z| (N·s/m) of a rig without a wall over the frequencies of `band` (Hz), 1 Hz apart.

    The impedance is that of a mass m (kg) with viscous damping b (N·s/m): the result is √mean(b² + (2π·m·f)²).
    """
    low_hz, high_hz = band
    lines = np.arange(low_hz, high_hz + 1.0)
    return float(np.sqrt(np.mean(damping**2 + (2.0 * np.pi * mass * lines) ** 2)))
