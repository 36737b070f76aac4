"""Compute ranges of damping, linear limits, random plants and velocity noise for the paper of Koul et al.

Each public function with a `payload` is the work of one task of the sweep that runs the reproduction
(`rig.extras.papers.parts`): it takes and returns values that JSON can store, and has no side effects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from rig import config
from rig.analysis import theory
from rig.analysis.theory import passive_curve, stiffnesses
from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.control import estimators
from rig.control.verdict import CRITERIA
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.core.operators import GRIPS
from rig.core.present import plain
from rig.experiments.estimation.interface import SIGNALS, signal_case, tune_estimator
from rig.experiments.hits.compare import simulate
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.experiments.mapping.interface import (
    TRUE,
    MapPlan,
    Outcomes,
    StiffnessSearch,
    drive,
    limit_of,
    run_series,
)
from rig.experiments.sweep import Task
from rig.extras.papers.koul import compare as compare_koul
from rig.extras.papers.koul import rigs, rules
from rig.extras.papers.parts import Part

PASSIVE_POINTS = 12  # of the curve below which walls are passive

# --- a series of a map -----------------------------------------------------------------------------------------

# Columns that the report shows; the journal of the sweep stores every result.
_KEPT = ("stiffness", f"kind{TRUE}", *(f"passes_{criterion}{TRUE}" for criterion in CRITERIA))


def series(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Run the hits of one stiffness search (one scheme, damping and encoder offset) that `payload` describes.

    Return a dict for each hit: stiffness and results.
    """
    return [{name: row[name] for name in _KEPT} for row in run_series(payload)]


def map_part(plan: MapPlan) -> Part:
    """Return the tasks that measure a map of stable walls; the weight of a task is its cost in hits of a 20 kHz rig."""
    rungs = len(plan.search.rungs)
    hits = {"grid": rungs, "ladder": 0.6 * rungs, "bisection": 4.0 + 2.0 * np.log2(rungs)}[plan.search.way]
    return [replace(task, work=series, weight=float(hits) * task.weight / 20_000) for task in plan.tasks]


# --- the range of damping of a soft wall, in simulation --------------------------------------------------


def range_tasks(
    experiment: Experiment,
    schemes: Sequence[Scheme],
    offsets: Sequence[float],
    *,
    stiffness: float,
    search: StiffnessSearch,
    weight: float,
) -> Part:
    """Return tasks that find the largest stable damping at one stiffness, by sampling scheme and encoder offset."""
    applied = [scheme.applied(experiment) for scheme in schemes]
    return tuple(
        Task(
            f"{number}/{offset!r}",
            damping_range,
            {
                "experiment": config.as_mapping(
                    config.override(applied[number], {"rig.encoder.offset": offset}, "a range")
                ),
                "stiffness": stiffness,
                "search": asdict(search),
            },
            weight=weight * scheme.position_rate / 20_000,
        )
        for number, scheme in enumerate(schemes)
        for offset in offsets
    )


def damping_range(payload: Mapping[str, Any]) -> dict[str, Any]:
    """Search the largest damping (N·m·s/rad) with which a wall of one stiffness is stable.

    `payload` has the experiment, the stiffness and the search. The result has ``damping`` and ``capped`` (True: the
    search ended before a wall failed) for each stability criterion, and the number of ``hits``.
    """
    simulator = HitSimulator(config.restore_experiment(payload["experiment"]))
    tried: dict[str, dict[float, bool | None]] = {criterion: {} for criterion in CRITERIA}

    def hit(damping: float) -> Outcomes:
        true = simulator.hit(payload["stiffness"], damping).true
        outcomes = {criterion: true.passes(criterion) for criterion in CRITERIA}
        for criterion, passes in outcomes.items():
            tried[criterion][damping] = passes
        return outcomes

    drive(StiffnessSearch(**payload["search"]).walk(CRITERIA), hit)
    limits = {criterion: limit_of(rungs) for criterion, rungs in tried.items()}
    return {
        criterion: {"damping": limit.stiffness, "capped": limit.capped} for criterion, limit in limits.items()
    } | {"hits": len(tried[CRITERIA[0]])}


@dataclass(frozen=True, slots=True)
class DampingRange:
    """Largest stable damping (N·m·s/rad) of a soft wall: mean, least and largest over the encoder offsets.

    `capped` is True if a search ended before a wall failed, so that the true damping is larger.
    """

    damping: float
    lowest: float
    highest: float
    capped: bool


def ranges_of(results: Sequence[Mapping[str, Any]], offsets: int) -> list[dict[str, DampingRange]]:
    """Return the largest stable dampings from the results of `range_tasks`, by ripple, for each sampling scheme.

    `offsets` is the number of encoder offsets.
    """
    found = []
    for first in range(0, len(results), offsets):
        some = results[first : first + offsets]
        found.append({criterion: _range([one[criterion] for one in some]) for criterion in CRITERIA})
    return found


def _range(limits: Sequence[Mapping[str, Any]]) -> DampingRange:
    b = [limit["damping"] for limit in limits]
    return DampingRange(float(np.mean(b)), min(b), max(b), any(limit["capped"] for limit in limits))


# --- linear theory -------------------------------------------------------------------------------------------

_GRID, _REFINEMENTS = 60, 3
_ISLAND_STIFFNESSES, _ISLAND_HIGHEST = 16, 3e3  # N·m/rad
_ISLAND_DAMPINGS, _ISLAND_REACH = 40, 4.0  # times the connected range


def linear_range(lifted: theory.Lifted) -> float:
    """Return the damping (N·m·s/rad) up to which the softest wall is stable; stable walls above a gap are ignored."""
    loop = lifted.loop
    lowest = float(stiffnesses(lifted, 0.0)[0])
    top = 8.0 * loop.subject.inertia / loop.period_s + loop.subject.damping
    dampings = np.geomspace(1e-5 * top, top, _GRID)
    for _ in range(_REFINEMENTS):
        unstable = np.flatnonzero(~lifted.stable(lowest, dampings))
        if len(unstable) == 0:
            return float(dampings[-1])
        first = int(unstable[0])
        if first == 0:
            return 0.0
        dampings = np.linspace(dampings[first - 1], dampings[first], _GRID)
    return float(dampings[0])


def range_with_islands(lifted: theory.Lifted, connected: float) -> float:
    """Return the largest damping (N·m·s/rad) of any stable wall, also above unstable gaps; at least `connected`."""
    k = np.geomspace(float(stiffnesses(lifted, 0.0)[0]), _ISLAND_HIGHEST, _ISLAND_STIFFNESSES)
    b = np.geomspace(1.0, _ISLAND_REACH, _ISLAND_DAMPINGS) * connected
    some = np.flatnonzero(lifted.stable(k, b[:, None]).any(axis=1))
    return float(b[some[-1]]) if len(some) else connected


def linear_limits(payload: Mapping[str, Any]) -> dict[str, Any]:
    """Compute a sampling scheme's limits by exact linear theory: largest stable K at each damping, largest damping.

    ``islands`` in the payload adds the largest damping beyond unstable gaps, ``passivity`` the limits of passive walls.
    For a payload with ``rates`` (Hz) the result is K_max at B = 0 for each uniform rate instead. For a scheme that is
    not linear the result is the reason, as ``not_linear``.
    """
    experiment = config.restore_experiment(payload["experiment"])
    if "rates" in payload:
        schemes = [
            Scheme(position_rate=rate, velocity_rate=rate, estimator="fdm") for rate in payload["rates"]
        ]
        return {"stiffness": [theory.k_max(experiment, scheme, 0.0).stiffness for scheme in schemes]}
    try:
        lifted = theory.as_lifted(experiment, Scheme.parse(payload["scheme"]))
    except ConfigError as error:  # a non-linear estimator, or an adaptive rate
        return {"not_linear": error.message}
    undamped, *curve = theory.k_max_curve(lifted, None, [0.0, *payload["dampings"]])
    largest = theory.b_max(lifted) if payload["islands"] else None
    return {
        "undamped": undamped.stiffness,
        "peak": max(limit.stiffness for limit in (undamped, *curve)),
        "range": linear_range(lifted),
        "range_with_islands": None if largest is None else largest.with_islands,
        "frequency_hz": None if largest is None else largest.frequency_hz,
        "curve": [[limit.damping, limit.stiffness] for limit in curve],
        "islands": [[limit.damping, i.low, i.high] for limit in curve for i in limit.islands if not i.capped],
        **(_passivity(lifted) if payload["passivity"] else {}),
    }


def _passivity(lifted: theory.Lifted) -> dict[str, Any]:
    passive = theory.passivity_bound(lifted)
    dampings = np.linspace(0.0, passive.largest_damping, PASSIVE_POINTS).tolist()
    return {
        "beta": passive.beta,
        "passive_stiffness": passive.stiffness,
        "passive_damping": passive.largest_damping,
        "passive_curve": [dampings, passive_curve(lifted, dampings)],
    }


# --- random plants ---------------------------------------------------------------------------------------------

# What is drawn, log-uniformly, at the link; the hand is one of the three grips or none.
PLANT_RANGES = {
    "motor_inertia": (1e-4, 3e-4),
    "link_inertia": (2e-4, 4e-3),
    "transmission_stiffness": (500.0, 2e4),
    "transmission_damping_ratio": (0.01, 0.1),
    "motor_damping": (1e-3, 3e-2),
    "link_damping": (3e-4, 3e-3),
}
LAGS_S = (3e-5, 3e-4)


def random_plants(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Draw random plants (two masses, amplifier lag, perhaps a hand); return each sampling scheme's largest damping.

    The dampings (N·m·s/rad) are those of the softest wall by linear theory.
    """
    schemes = [Scheme.parse(text) for text in payload["schemes"]]
    base = config.rig_model(presets.load("koul-compliant").rig)
    return [_plant(base, schemes, payload, number) for number in payload["numbers"]]


def _plant(
    base: RigModel, schemes: Sequence[Scheme], payload: Mapping[str, Any], number: int
) -> dict[str, Any]:
    random = np.random.default_rng([payload["seed"], number])
    drawn = {name: _log_uniform(random, *ends) for name, ends in PLANT_RANGES.items()}
    lag_s = _log_uniform(random, *LAGS_S)
    grip = str(random.choice(["none", *GRIPS]))
    mechanics = replace(base.mechanics, **drawn)  # type: ignore[arg-type]  # all that is drawn are floats
    model = replace(base, mechanics=mechanics, amplifier=replace(base.amplifier, lag_s=lag_s))
    lifted = [theory.as_lifted(model, scheme, grip) for scheme in schemes]
    ranges = [linear_range(one) for one in lifted]
    islands = [range_with_islands(lifted[i], ranges[i]) for i in payload["islands"]]
    return {**drawn, "lag_s": lag_s, "grip": grip, "ranges": ranges, "with_islands": islands}


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


# --- word lengths ----------------------------------------------------------------------------------------------


def word_lengths(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Compute figures 7 and 8 for a word length of the filter, at two cut-offs of the uniform sampling scheme.

    Each row has the peaks of `rig.extras.papers.koul.compare.word_lengths`. ``read`` is the rms of the estimated
    velocity of figure 8 divided by the rms of the true one: early and late in the impact, at 2 and at 20 kHz.
    """
    rows = []
    for word in compare_koul.word_lengths([payload["bits"]], offsets=payload["offsets"]):
        profiles = compare_koul.koul_figure_8(state_bits=word.state_bits, uniform_share=word.uniform_share)
        read = {
            str(p.velocity_rate): {"early": p.reading_early, "late": p.reading_late}
            for p in profiles.profiles
            if p.arithmetic == compare_koul.FIXED
        }
        rows.append({**plain(word), "read": read})
    return rows


# --- the noise of a count ----------------------------------------------------------------------------------------

_SHARES = (1 / 20, 1 / 10)  # cut-off over rate: both readings of the paper
FINER = 1024  # factor of the encoder's resolution, so fine that quantisation has no effect


def velocity_noise(payload: Mapping[str, Any]) -> dict[str, float]:
    """Return the velocity noise that the encoder's quantisation causes early in the impact of Fig. 8 (rad/s rms).

    Each estimator gets the same motion in counts and in counts a thousand times finer. It is linear, so the difference
    of its outputs is noise alone, without delay or filtering of the motion. The result is the root mean square over the
    encoder offsets. Keys are the velocity rate, and at 20 kHz also the cut-off, such as "20 kHz, fs/20".
    """
    offsets = payload["offsets"]
    fast, slow = compare_koul.POSITION_RATES[0], compare_koul.VELOCITY_RATE
    cutoffs = {"2 kHz": (slow, compare_koul.CUTOFF_HZ)} | {
        f"20 kHz, fs/{1 / share:g}": (fast, share * fast) for share in _SHARES
    }
    motions = [_early_motion(offset) for offset in offsets]
    return {
        name: float(np.sqrt(np.mean([_noise(motion, rate, cutoff) ** 2 for motion in motions])))
        for name, (rate, cutoff) in cutoffs.items()
    }


@dataclass(frozen=True, slots=True)
class _Motion:
    """A motion at 20 kHz in counts and in `FINER` times finer counts, the resolution (rad), and its early samples."""

    counts: Any
    fine: Any
    resolution: float
    early: slice


def _early_motion(offset: float) -> _Motion:
    rate = compare_koul.POSITION_RATES[0]
    experiment = compare_koul.koul_entries(rate).none.applied(compare_koul.koul_experiment())
    _, plant, trace = simulate(experiment, compare_koul.START, offset)
    resolution = experiment.rig.encoder.resolution
    position, velocity = (trace.states[:, plant.sensed_position + i] for i in (0, 1))
    inside = int(np.flatnonzero(trace.counts > 0)[0])
    fast = np.flatnonzero(np.abs(velocity) >= compare_koul.EARLY[1] * abs(velocity[inside]))
    fine = np.floor(position / (resolution / FINER)).astype(np.int64)
    return _Motion(trace.counts, fine, resolution, slice(inside, int(fast[-1])))


def _noise(motion: _Motion, rate_hz: int, cutoff_hz: float) -> float:
    every = compare_koul.POSITION_RATES[0] // rate_hz
    early = np.zeros(len(motion.counts), bool)
    early[motion.early] = True

    def seen(counts: Any, resolution: float) -> Any:
        return estimators.estimate(
            compare_koul.ESTIMATORS[compare_koul.FLOAT],
            counts[::every],
            1.0 / rate_hz,
            resolution=resolution,
            cutoff_hz=cutoff_hz,
        )

    error = seen(motion.counts, motion.resolution) - seen(motion.fine, motion.resolution / FINER)
    return float(np.sqrt(np.mean(np.square(error[early[::every]]))))


# --- other cut-offs and another estimator ------------------------------------------------------------------------


def lower_cutoffs(payload: Mapping[str, Any]) -> dict[str, list[float | None]]:
    """Return the rms velocity error (rad/s) in a hit of the preset's wall at 200 Hz, then at each of `rules.LOWER_HZ`.

    The wall is dual-rate and in floating point; keys are rig and push. An error is None if the wall is not stable: it
    would be that of another motion, an oscillation.
    """
    found: dict[str, list[float | None]] = {}
    for held in rigs.HELD:
        x, parameters = (
            held.experiment(),
            [{"cutoff_hz": hz} for hz in (compare_koul.CUTOFF_HZ, *rules.LOWER_HZ)],
        )
        schemes = [replace(rigs.SCHEMES[rigs.DUAL], parameters=one) for one in parameters]
        hits = [HitSimulator(one.applied(x)).hit(x.wall.stiffness, x.wall.damping) for one in schemes]
        found[held.name] = [hit.rendering.velocity_error if hit.true.passes("any") else None for hit in hits]
    return found


def differentiators(payload: Mapping[str, Any]) -> list[tuple[str, int, float, float]]:
    """Return (resolution, rate in Hz, rms error in m/s of the filtered difference, that of Levant's differentiator).

    Each is tuned on the reference hit at each rate, Levant's differentiator in two discretisations: the better counts.
    """
    found = []
    for resolution, rate in product((1e-6, 2e-5), payload["rates"]):
        case = signal_case(SIGNALS["wall-bounce"], rate, resolution)
        filtered = tune_estimator("fdm-butterworth", case, free=["cutoff_hz"]).objective_best
        forms = ({"discretisation": form} for form in ("explicit", "implicit"))
        levant = [tune_estimator("levant", case, settings=form, free=["lipschitz"]) for form in forms]
        found.append((f"{1e6 * resolution:g} µm", rate, filtered, min(one.objective_best for one in levant)))
    return found
