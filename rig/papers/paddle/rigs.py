"""The rigs that could have given the measured curves: what is known of the paddle, and priors over what is not.

All at the handle, as a linear rig: the curves are in N/mm and N·s/mm there, so that neither lever nor transmission is
needed. The priors are wide, log-uniform where a quantity has a scale, and centred on the one course paddle of which the
firmware is public (preset course-paddle: a tick every 350 µs, 0.062 kg and 16 µm at its handle of 75 mm, 0.14 N of dry
friction, which other projects on that board measured as 0.14 to 0.18 N; a motor of 21 to 32 mN·m, 4.2 to 6.5 N).

Two of them were chosen after results: a first full run, with up to 0.15 kg and either order, left 5 of 60 rigs
plausible. They come from the difference's measured range of damping, which linear theory ties to the inertia: with a
filter of second order it is some 310 N·s/m for each kilogram, with one of first order it was more than twice the
measured range on all of the first rigs drawn. So the filter is of second order here, and nothing is heavier than 80 g.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.experiments.searches import Search
from rig.experiments.zwidth import MapPlan
from rig.papers.paddle import data

BASE = "chawda-linear"  # every number of it that matters here is replaced
SEED = 0
RATE = 2860  # Hz: a tick every 350 µs
START_M = 7e-4  # the way to the wall: 0.5° at 75 mm, as in the public project
LOWEST, HIGHEST = 100.0, 25_000.0  # N/m, of the walls that are hit: the measured ones end at 6200
GAINS = ("hba-sc", "levant")  # of Levant's differentiator: (1.1, 1) and (1.1, 1.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Where a quantity that is not given may lie: log-uniform between two bounds."""

    low: float
    high: float
    unit: str
    meaning: str

    def draw(self, random: np.random.Generator) -> float:
        """One value."""
        return float(math.exp(random.uniform(math.log(self.low), math.log(self.high))))


PRIORS: Mapping[str, Prior] = {
    "mass": Prior(low=0.03, high=0.08, unit="kg", meaning="inertia at the handle"),
    "damping": Prior(low=0.05, high=1.0, unit="N·s/m", meaning="viscous friction"),
    "friction": Prior(low=0.07, high=0.4, unit="N", meaning="dry friction"),
    "quantum": Prior(low=5e-6, high=5e-5, unit="m", meaning="one count of the encoder"),
    "lag": Prior(low=5e-5, high=1e-3, unit="s", meaning="lag of the amplifier"),
    "push": Prior(low=0.5, high=2.0, unit="N", meaning="push of the motor"),
    "limit": Prior(low=4.2, high=6.5, unit="N", meaning="most force of the motor"),
    "window": Prior(low=5.0, high=40.0, unit="samples", meaning="longest window of FOAW"),
    "bandwidth": Prior(low=20.0, high=200.0, unit="Hz", meaning="bandwidth of the Kalman filter"),
    "lipschitz": Prior(low=3.0, high=300.0, unit="m/s²", meaning="C of Levant's differentiator"),
}
DELAYS = (0, 1)  # ticks of computation
ORDER = 2  # of the difference's filter


@dataclass(frozen=True, slots=True)
class Rig:
    """A rig drawn from the priors, with the settings of its estimators."""

    number: int
    values: Mapping[str, float]
    delay: int
    gains: str

    @classmethod
    def drawn(cls, number: int) -> Rig:
        """The rig of a number: the same at every scale."""
        random = np.random.default_rng((SEED, number))
        values = {name: prior.draw(random) for name, prior in PRIORS.items()}
        return cls(
            number,
            values,
            int(random.choice(DELAYS)),
            str(random.choice(GAINS)),
        )

    def experiment(self) -> Experiment:
        """A hit on it: its motor pushes it into the wall."""
        v = self.values
        changes: dict[str, Any] = {
            "rig.name": "paddle",
            "rig.mechanics.motor_inertia": v["mass"],
            "rig.mechanics.motor_damping": v["damping"],
            "rig.mechanics.motor_coulomb": v["friction"],
            "rig.amplifier.effort_per_ampere": 1.0,
            "rig.amplifier.effort_limit": v["limit"],
            "rig.amplifier.lag_s": v["lag"],
            "rig.encoder.quantum": v["quantum"],
            "rig.limits.nominal_effort": v["limit"],
            "rig.limits.effort": v["limit"],
            "rig.limits.speed": 20.0,
            "rig.simulation.computation_delay_ticks": self.delay,
            "controller.position_rate": RATE,
            "controller.velocity_rate": RATE,
            "wall.stiffness": 1000.0,
            "wall.damping": 0.0,
            "homing.stiffness": 100.0,
            "homing.damping": 1.0,
            "homing.effort": 1.0,
            "trial.effort": v["push"],
            "trial.start": -START_M,
            "trial.duration_s": 0.8,
            "trial.minimum_rest_counts": 0.0,
            "trial.seed": SEED,
            "verdict.lowpass_hz": 500.0,
            "verdict.felt_velocity": 0.005,
            "verdict.heard_force": 0.3,
        }
        return config.override(presets.load(BASE), changes, "the reproduction")

    def schemes(self) -> tuple[Scheme, ...]:
        """The four estimators, in the order of `ESTIMATORS`."""
        v = self.values
        settings: dict[str, tuple[str, dict[str, float | str]]] = {
            data.DIFFERENCE: ("fdm-butterworth", {"cutoff_hz": data.CUTOFF_HZ, "order": ORDER}),
            data.FOAW: ("foaw-best", {"window_limit": round(v["window"])}),
            data.KALMAN: ("kalman", {"bandwidth_hz": v["bandwidth"]}),
            data.LEVANT: ("levant", {"lipschitz": v["lipschitz"], "gains": self.gains}),
        }
        return tuple(
            Scheme(position_rate=RATE, velocity_rate=RATE, estimator=name, parameters=parameters)
            for name, parameters in (settings[estimator] for estimator in data.ESTIMATORS)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """How fine everything is computed."""

    name: str
    rigs: int
    every: int  # of the measured dampings one in so many
    ratio: float  # between rungs of stiffness
    offsets: tuple[float, ...]

    @property
    def dampings(self) -> tuple[float, ...]:
        """Dampings of a map (N·s/m): a column more than the longest curve has."""
        return data.dampings(data.COLUMNS + 1)[:: self.every]


FULL = Scale(name="full", rigs=60, every=1, ratio=1.12, offsets=(0.3,))
QUICK = Scale(name="quick", rigs=6, every=4, ratio=1.6, offsets=(0.3,))


def map_plan(rig: Rig, scale: Scale) -> MapPlan:
    """The walls that are hit on a rig: upwards until all has failed, as the measured ones were found."""
    return MapPlan(
        experiment=rig.experiment(),
        schemes=rig.schemes(),
        dampings=scale.dampings,
        search=Search(way="ladder", lowest=LOWEST, highest=HIGHEST, ratio=scale.ratio),
        offsets=scale.offsets,
        judged="true",
    )
