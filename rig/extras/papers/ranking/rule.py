"""What the ranking of estimators and laws compares: rigs and their variations, hands, delays, and which walls count.

All numbers of the rule, which ``rig/decisions/0019`` explains, are in this file. It must not run a hit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any

import numpy as np

from rig import config
from rig.analysis import theory
from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.devices.simulated import SimulatedHit
from rig.experiments.mapping.interface import StiffnessSearch, search_for

SEED, SPREAD, VARIATIONS = 19, 0.2, 8  # of random rigs: parameters within ±20 %
CONDITIONS = ("none", "relaxed", "normal", "firm")  # no hand, and the three grips
GRIPS = CONDITIONS[1:]
DELAYS = (0, 1, 2)  # ticks
OFFSETS, TUNING_OFFSET = (0.1, 0.6, 0.85), 0.35  # counts
JUDGED_SEED = 1000  # added to the number of the variation; tuning uses the preset's seed
TUNING_CONDITIONS = ("none", "normal")
PER_DECADE, COARSE = 12, 4  # values of a tuning grid; every fourth of them first
STIFFNESS_WITHIN, DAMPING_WITHIN = (0.7, 1.4), (0.5, 2.0)  # rendered over commanded
WIN = 1.25  # ratio of areas
CONFIDENCE, RESAMPLED = 0.95, 10_000  # level and resamples of its bootstrap interval
RATIO = 1.15  # of neighbouring stiffnesses
DAMPING_RATIO = math.sqrt(2.0)  # of neighbouring dampings
FIRST_DAMPING = 1.0 / 32.0  # smallest damping above 0, over the largest stable damping of linear theory
MOST_COLUMNS, FEWEST_COLUMNS = 24, 8  # dampings; the fewest are tried while no wall has counted
EMPTY_COLUMNS = 2  # dampings without a wall that counts, after which the search ends
DUAL_HZ = 2000  # velocity rate of dual-rate pairs

# The five that differ most first. Not smartknob: its motor cannot hold the press of a relaxed and of a firm grip.
RIGS: dict[str, tuple[str, int | None]] = {
    "koul-rigid": ("koul-rigid", None),
    "chawda-linear-10k": ("chawda-linear", 10_000),
    "chawda-linear": ("chawda-linear", None),
    "hapkit": ("hapkit", None),
    "koul-compliant": ("koul-compliant", None),
    "course-paddle": ("course-paddle", None),
    "woodenhaptics": ("woodenhaptics", None),
    "moteus-knob": ("moteus-knob", None),
}
_KOUL_PUSH = {"trial.effort": 0.4, "trial.start": -0.004}  # of the reproduction


Settings = dict[str, float | str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """Estimator with its one tuned parameter: a grid from `low` to `high`, times the velocity rate if `per_rate`."""

    estimator: str
    parameter: str = ""  # empty: the estimator has none
    low: float = 1 / 500
    high: float = 0.4
    per_rate: bool = True
    whole: bool = False
    fixed: Settings = field(default_factory=dict)

    def grid(self, rate_hz: float) -> list[Settings]:
        """Return the settings to try, `PER_DECADE` values a decade; a single one if the estimator has no parameter."""
        if not self.parameter:
            return [dict(self.fixed)]
        scale = rate_hz if self.per_rate else 1.0
        first, last = (round(PER_DECADE * math.log10(end * scale)) for end in (self.low, self.high))
        values = (10.0 ** (step / PER_DECADE) for step in range(first, last + 1))
        rounded = sorted({float(round(v)) if self.whole else float(f"{v:.6g}") for v in values})
        return [{**self.fixed, self.parameter: value} for value in rounded]


ESTIMATORS = {
    one.estimator: one
    for one in (
        Tuned(estimator="fdm"),
        Tuned(estimator="fdm-butterworth", parameter="cutoff_hz"),
        Tuned(
            estimator="foaw-best", parameter="window_limit", low=2.0, high=32.0, per_rate=False, whole=True
        ),
        Tuned(estimator="kalman", parameter="bandwidth_hz", fixed={"gain": "steady"}),
        Tuned(estimator="levant", parameter="lipschitz", low=1.0, high=1e5, per_rate=False),
        Tuned(estimator="tracking", parameter="frequency_hz"),
        Tuned(estimator="disturbance", parameter="frequency_hz"),
    )
}
PLAIN, PASSIVE, ESTIMATED = "plain", "passive", "estimated position"


@dataclass(frozen=True, slots=True)
class Pair:
    """Estimator, sampling (single- or dual-rate) and control law of the wall, which are ranked together."""

    estimator: str
    dual: bool = False
    law: str = PLAIN

    @property
    def name(self) -> str:
        """Name of the estimator–law pair in tables and as a key."""
        return ", ".join([self.estimator, *["dual-rate"] * self.dual, *[self.law] * (self.law != PLAIN)])

    @property
    def plain(self) -> Pair:
        """The pair with the same estimator and sampling and the plain wall, on which the estimator is tuned."""
        return replace(self, law=PLAIN)


PAIRS = (
    *(Pair(name) for name in ESTIMATORS),
    Pair("fdm-butterworth", dual=True),
    Pair("disturbance", dual=True),
    Pair("fdm-butterworth", law=PASSIVE),
    Pair("disturbance", law=PASSIVE),
    Pair("tracking", law=ESTIMATED),
    Pair("disturbance", law=ESTIMATED),
)


@dataclass(frozen=True)
class Ground:
    """A rig of the ranking, with what is the same for all estimator–law pairs: preset and range of dampings."""

    name: str
    preset: Experiment
    largest_damping: float  # of linear theory (N·m·s/rad or N·s/m)

    @classmethod
    @cache
    def of(cls, name: str) -> Ground:
        """Return the rig with this name in the ranking; raise `ConfigError` for another name."""
        if name not in RIGS:
            raise ConfigError(f"rig {name} is not in the ranking", remedy=f"choose one of {', '.join(RIGS)}")
        preset, rate = RIGS[name]
        changes: dict[str, Any] = dict(_KOUL_PUSH) if preset.startswith("koul") else {}
        experiment = config.override(presets.load(preset), changes, "the ranking")
        rate = rate or experiment.controller.position_rate
        uniform = Scheme(position_rate=rate, velocity_rate=rate, estimator="fdm-butterworth").applied(
            experiment
        )
        widest = theory.damping_range(theory.with_linear_wall(uniform), Scheme.of(uniform))
        return cls(name, uniform, widest)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Estimator–law pairs that this rig can run: dual-rate only where 2 kHz divides a higher position rate."""
        rate = self.preset.controller.position_rate
        return tuple(one for one in PAIRS if not one.dual or (rate > DUAL_HZ and rate % DUAL_HZ == 0))

    def velocity_rate(self, pair: Pair) -> int:
        """Return the velocity rate of an estimator–law pair (Hz), the position rate unless the pair is dual-rate."""
        return DUAL_HZ if pair.dual else self.preset.controller.position_rate

    def dampings(self) -> list[float]:
        """Return the wall dampings to measure, ascending (N·m·s/rad or N·s/m)."""
        first = FIRST_DAMPING * self.largest_damping
        return [0.0, *(first * DAMPING_RATIO**step for step in range(MOST_COLUMNS - 1))]

    def condition(self, grip: str, delay: int) -> Experiment:
        """Return the rig's preset with a grip ("none": no hand) and a computation delay (ticks)."""
        changes: dict[str, Any] = {"rig.simulation.computation_delay_ticks": delay}
        if grip != "none":
            changes |= {"trial.kind": "human", "operator.grip": grip, "rig.limits.human": False}
        return config.override(self.preset, changes, "the ranking")

    def search(self, grip: str) -> StiffnessSearch:
        """Return the stiffness search for a grip; it is the same for all estimator–law pairs, delays and variations."""
        return search_for(self.condition(grip, 0), "bisection", ratio=RATIO)

    def experiment(self, pair: Pair, settings: Settings, grip: str, delay: int) -> Experiment:
        """Return the experiment for an estimator–law pair with settings of its estimator, a grip, a delay (ticks)."""
        scheme = Scheme(
            position_rate=self.preset.controller.position_rate,
            velocity_rate=self.velocity_rate(pair),
            estimator=pair.estimator,
            parameters=settings,
        )
        laws: dict[str, dict[str, Any]] = {
            PLAIN: {},
            PASSIVE: {"wall.passive_damping": 0.5 * self.largest_damping},
            ESTIMATED: {"wall.position_from": "estimator"},
        }
        return config.override(scheme.applied(self.condition(grip, delay)), laws[pair.law], "the ranking")


def vary(model: RigModel, number: int) -> RigModel:
    """Return variation `number` of a rig; 0 is the rig itself.

    Every mechanical parameter, the effort constant and the encoder's resolution are multiplied by factors of ±20 %.
    """
    if number == 0:
        return model
    random = np.random.default_rng([SEED, number])

    def factor() -> float:
        return float(random.uniform(1.0 - SPREAD, 1.0 + SPREAD))

    drawn = {one.name: factor() for one in fields(model.mechanics) if one.name != "structure"}
    mechanics = replace(
        model.mechanics, **{name: drawn[name] * getattr(model.mechanics, name) for name in drawn}
    )
    amplifier, encoder = model.amplifier, model.encoder
    gain, resolution = factor(), factor()
    return replace(
        model,
        mechanics=mechanics,
        amplifier=replace(amplifier, effort_per_ampere=gain * amplifier.effort_per_ampere),
        encoder=replace(encoder, counts_per_revolution=None, quantum=resolution * encoder.resolution),
    )


def counts(hit: SimulatedHit, stiffness: float, damping: float) -> bool:
    """Return True if a wall counts: its hit has no effort ripple, and it renders about this stiffness and damping."""
    if hit.recorded.passes("heard") is not True:
        return False
    low, high = STIFFNESS_WITHIN
    if not low * stiffness <= hit.rendering.stiffness <= high * stiffness:
        return False
    least, most = DAMPING_WITHIN
    return damping == 0.0 or least * damping <= hit.rendering.damping <= most * damping
