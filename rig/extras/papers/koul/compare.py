"""Compute figures 7 and 8 of Koul et al.: single impacts without damping, with uniform and with dual-rate sampling.

This project chose the conditions that the paper does not give: koul-rigid without a hand, 70 g at its end; K = 40
N·m/rad, B = 0.2 N·m·s/rad; 60 mN·m on the link, inside and outside the wall; start 2 mrad before the wall at 1.5 rad/s;
×4 decoding.

In floating point a uniform wall is damped as well as a dual-rate one. Figure 7 needs a filter whose state has few
fractional bits and is truncated towards zero: at a high velocity rate the estimate of a slow handle is then zero, and
the damping is lost. Between these extremes the result depends on the position of the counts: with 4 bits at 10 kHz the
peak of the uniform wall is 35 to 46 counts, depending on the encoder's offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment, presets
from rig.config.controller import resolution
from rig.config.schemes import Scheme
from rig.control.estimators import Floats
from rig.core.errors import ConfigError
from rig.core.present import plain, reported
from rig.experiments.estimation.interface import Case, Variant, delay, estimates
from rig.experiments.hits.compare import OFFSETS, Entry, SchemeComparison, Start, compare, simulate

START = Start(position=-2e-3, velocity=1.5, external_effort=0.06)
WALL = {"wall.stiffness": 40.0, "wall.damping": 0.2}
POSITION_RATES = (20_000, 10_000)
VELOCITY_RATE = 2000
CUTOFF_HZ = 200.0  # of the dual-rate scheme
UNIFORM_SHARE = 1 / 20  # cut-off of the uniform scheme over its rate: "10 % Nyquist"
FLOAT, FIXED = "floating point", "fixed point"
ESTIMATORS = {FLOAT: "fdm-butterworth", FIXED: "fdm-butterworth-fixed"}
COEFFICIENT_BITS, STATE_BITS, ROUNDING = 14, 4, "zero"
FIRST_IMPACT_S = 0.05
LIKE_NONE, BETWEEN, MUCH_LESS = 0.95, 0.1, 0.6  # peaks over those of another wall: what the paper shows

EARLY, LATE = (1.0, 0.25), (0.25, 0.02)  # parts of the impact, by speed over that of the first contact


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel of figure 7: impacts with no, uniform and dual-rate damping at one position rate and arithmetic."""

    position_rate: int
    arithmetic: str
    comparison: SchemeComparison

    @property
    def peaks(self) -> tuple[float, float, float]:
        """Return the mean peak penetrations (counts) with no, uniform and dual-rate damping."""
        none, uniform, dual = (self.comparison[name].numbers.peak for name in ("none", "uniform", "dual"))
        return none, uniform, dual

    @property
    def decays(self) -> tuple[float, float, float]:
        """Return the mean decay of the oscillation with no, uniform and dual-rate damping (0: none, 1: undamped)."""
        none, uniform, dual = (self.comparison[name].numbers.decay for name in ("none", "uniform", "dual"))
        return none, uniform, dual

    def as_mapping(self) -> dict[str, Any]:
        """Return rates, arithmetic and the simulated impacts for JSON."""
        return {"position_rate": self.position_rate, "arithmetic": self.arithmetic, **plain(self.comparison)}


@dataclass(frozen=True, slots=True, kw_only=True)
class WordLength:
    """Mean peak penetrations (counts) with one word length (fractional bits of the filter's state) and cut-off."""

    state_bits: int
    uniform_share: float  # cut-off over velocity rate
    none: dict[int, float]  # by position rate (Hz)
    uniform: dict[int, float]
    dual: dict[int, float]

    @reported
    def as_in_the_paper(self) -> bool:
        """True if the peak penetrations are ordered as in figure 7.

        At 20 kHz the uniform peak is at least 95 % of the undamped one; at 10 kHz it lies between the dual-rate and the
        undamped peak, 10 % away from each; and the dual-rate peak is at most 0.6 of the undamped one at both rates.
        """
        fast, slow = POSITION_RATES
        return (
            self.uniform[fast] >= LIKE_NONE * self.none[fast]
            and (1.0 + BETWEEN) * self.dual[slow] <= self.uniform[slow] <= (1.0 - BETWEEN) * self.none[slow]
            and all(self.dual[rate] <= MUCH_LESS * self.none[rate] for rate in POSITION_RATES)
        )


def koul_experiment(arithmetic: str = FLOAT, state_bits: int = STATE_BITS) -> Experiment:
    """Return the rig, wall and dual-rate filter of figures 7 and 8; `arithmetic` is `FLOAT` or `FIXED` (point)."""
    words = {"coefficient_bits": COEFFICIENT_BITS, "state_bits": state_bits, "rounding": ROUNDING}
    parameters = {"cutoff_hz": CUTOFF_HZ, **(words if arithmetic == FIXED else {})}
    changes = {
        **WALL,
        "controller.position_rate": POSITION_RATES[0],
        "controller.velocity_rate": VELOCITY_RATE,
        "controller.estimator": ESTIMATORS[arithmetic],
        "controller.parameters": parameters,
        "trial.duration_s": 0.4,
        "verdict.tail_s": 0.1,
    }
    return config.override(presets.load("koul-rigid"), changes, "figure 7")


def koul_entries(position_rate: int, uniform_share: float = UNIFORM_SHARE) -> tuple[Entry, Entry, Entry]:
    """Return three sampling schemes to compare at a position rate (Hz): without damping, uniform and dual-rate.

    `uniform_share` is the cut-off of the uniform scheme divided by its velocity rate.
    """
    uniform = Scheme(
        position_rate=position_rate,
        velocity_rate=position_rate,
        parameters={"cutoff_hz": uniform_share * position_rate},
    )
    dual = Scheme(
        position_rate=position_rate, velocity_rate=VELOCITY_RATE, parameters={"cutoff_hz": CUTOFF_HZ}
    )
    return (
        Entry(name="none", scheme=uniform, damping=0.0),
        Entry(name="uniform", scheme=uniform),
        Entry(name="dual", scheme=dual),
    )


def koul_figure_7(
    *,
    state_bits: int = STATE_BITS,
    uniform_share: float = UNIFORM_SHARE,
    position_rates: Sequence[int] = POSITION_RATES,
    offsets: Sequence[float] = OFFSETS,
) -> tuple[Panel, ...]:
    """Compute the penetration after the first impact, for each position rate in floating and in fixed point.

    Parameters
    ----------
    state_bits
        Fractional bits of the fixed-point filter's input and output.
    uniform_share
        Cut-off of the uniform sampling scheme divided by its velocity rate; the dual-rate scheme has 200 Hz at 2 kHz.
    position_rates
        Position rates of the panels (Hz).
    offsets
        Positions of zero in its encoder cell (counts, 0 to 1), with which each impact is repeated.
    """
    return tuple(
        Panel(
            position_rate=rate,
            arithmetic=arithmetic,
            comparison=compare(
                koul_experiment(arithmetic, state_bits),
                koul_entries(rate, uniform_share),
                start=START,
                offsets=offsets,
            ),
        )
        for arithmetic in (FLOAT, FIXED)
        for rate in position_rates
    )


def word_lengths(
    state_bits: Sequence[int] = (0, 1, 2, 3, 4, 5, 6, 8, 16),
    uniform_shares: Sequence[float] = (1 / 20, 1 / 10),
    *,
    offsets: Sequence[float] = OFFSETS,
) -> tuple[WordLength, ...]:
    """Compute the peak penetrations of figure 7 for each word length of the filter and each of `uniform_shares`.

    A share is the cut-off divided by the velocity rate; the paper's "10 % Nyquist" can mean either default.
    """
    none = {rate: _peak(koul_experiment(), koul_entries(rate)[0], offsets) for rate in POSITION_RATES}
    table: list[WordLength] = []
    for bits in state_bits:
        experiment = koul_experiment(FIXED, bits)
        dual = {rate: _peak(experiment, koul_entries(rate)[2], offsets) for rate in POSITION_RATES}
        for share in uniform_shares:
            uniform = {
                rate: _peak(experiment, koul_entries(rate, share)[1], offsets) for rate in POSITION_RATES
            }
            table.append(
                WordLength(state_bits=bits, uniform_share=share, none=none, uniform=uniform, dual=dual)
            )
    return tuple(table)


def _peak(experiment: Experiment, entry: Entry, offsets: Sequence[float]) -> float:
    """Return the deepest penetration of the first impact (counts), as a mean over the encoder offsets."""
    short = config.override(experiment, {"trial.duration_s": FIRST_IMPACT_S, "verdict.tail_s": 0.02})
    applied = entry.applied(short)
    return float(np.mean([simulate(applied, START, offset)[2].counts.max() for offset in offsets]))


# --- figure 8 ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorProfile:
    """Velocity that one estimator reports after the impact, and its error against the delayed true velocity.

    Attributes
    ----------
    velocity_rate, arithmetic, cutoff_hz
        Rate (Hz), arithmetic and cut-off (Hz) of the estimator.
    time_s, velocity
        Time since the first contact (s) and estimated velocity (rad/s), one value for each velocity sample.
    delay_s
        Shift of the true velocity that gives the least error over the impact (s); None if it cannot be determined.
    noise_early, noise_late
        Rms error (rad/s) while the handle is fast and while it is slow (`EARLY`, `LATE`); without a delay the true
        velocity is not shifted.
    reading_early, reading_late
        Rms of the estimate divided by the rms of the true velocity; 0 if the estimator reports no motion.
    """

    velocity_rate: int
    arithmetic: str
    cutoff_hz: float
    time_s: Floats = field(repr=False)
    velocity: Floats = field(repr=False)
    delay_s: float | None
    noise_early: float
    noise_late: float
    reading_early: float
    reading_late: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Profiles:
    """Figure 8: one motion, and velocities that several estimators compute from it.

    Attributes
    ----------
    time_s, velocity_true, counts
        The motion from the first contact on, one value each tick: time (s), velocity (rad/s), penetration (counts).
    early_s, late_s
        Begin and end (s) of the time when the handle is fast, and when it is slow.
    speed_early, speed_late
        Rms of the true velocity in these times (rad/s).
    profiles
        One profile for each velocity rate in each arithmetic.
    """

    time_s: Floats = field(repr=False)
    velocity_true: Floats = field(repr=False)
    counts: Floats = field(repr=False)
    early_s: tuple[float, float]
    late_s: tuple[float, float]
    speed_early: float
    speed_late: float
    profiles: tuple[EstimatorProfile, ...]

    def __getitem__(self, key: tuple[int, str]) -> EstimatorProfile:
        """Return the velocity profile for a velocity rate (Hz) and an arithmetic; raise `KeyError` if it is missing."""
        for profile in self.profiles:
            if (profile.velocity_rate, profile.arithmetic) == key:
                return profile
        raise KeyError(f"no velocity curve is stored for (velocity rate in Hz, arithmetic) = {key}")


def koul_figure_8(
    *, offset: float = OFFSETS[1], state_bits: int = STATE_BITS, uniform_share: float = UNIFORM_SHARE
) -> Profiles:
    """Compute the velocity after the impact as estimated at 2 and 20 kHz in both arithmetics, and the true velocity.

    All estimators use the same motion, of the wall without damping at 20 kHz, so that no estimate affects the motion.

    Parameters
    ----------
    offset
        Position of zero in its encoder cell (counts, 0 to 1).
    state_bits
        Fractional bits of the fixed-point filter's input and output.
    uniform_share
        Cut-off of the estimator at 20 kHz divided by its rate.
    """
    rate = POSITION_RATES[0]
    experiment = koul_entries(rate)[0].applied(koul_experiment())
    _, plant, trace = simulate(experiment, START, offset)
    counts, true = trace.counts, trace.states[:, plant.sensed_position + 1]
    edge_age = trace.states[:, plant.edge_age]
    first = int(np.flatnonzero(counts > 0)[0])
    time_s = (np.arange(len(counts)) - first) / rate
    early, late = _split_impact(time_s[first:], true[first:])
    profiles: list[EstimatorProfile] = []
    for arithmetic in (FLOAT, FIXED):
        for velocity_rate in (VELOCITY_RATE, rate):
            cutoff_hz = CUTOFF_HZ if velocity_rate == VELOCITY_RATE else uniform_share * velocity_rate
            settings = {
                **koul_experiment(arithmetic, state_bits).controller.parameters,
                "cutoff_hz": cutoff_hz,
            }
            every = slice(None, None, rate // velocity_rate)
            case = Case(
                name="impact",
                motion="rotary",
                dt=1.0 / velocity_rate,
                resolution=resolution(experiment),
                time_s=time_s[every],
                counts=counts[every],
                edge_time=time_s[every] - time_s[0] - edge_age[every],
                elapsed=np.ones(len(counts[every]), np.int64),
                judged=(time_s[every] >= early[0]) & (time_s[every] < late[1]),
                truth=lambda t: np.interp(t, time_s, true),
                reference="the simulation's truth",
            )
            profiles.append(_profile(case, arithmetic, settings, early, late))
    shown = slice(first, None)
    return Profiles(
        time_s=time_s[shown],
        velocity_true=true[shown],
        counts=counts[shown].astype(np.float64),
        early_s=early,
        late_s=late,
        speed_early=_rms(true[_within(time_s, early)]),
        speed_late=_rms(true[_within(time_s, late)]),
        profiles=tuple(profiles),
    )


def _split_impact(time_s: Floats, velocity: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return begin and end (s) of the fast and of the slow part of an impact, separated by speed."""

    def last(share: float) -> float:
        above = np.flatnonzero(np.abs(velocity) >= share * abs(velocity[0]))
        return float(time_s[above[-1]])

    if last(LATE[1]) <= last(LATE[0]):
        raise ConfigError(
            "the simulated impact ends while the handle is still fast, so its slow part cannot be evaluated",
            remedy="increase trial.duration_s",
        )
    return (0.0, last(EARLY[1])), (last(LATE[0]), last(LATE[1]))


def _profile(
    case: Case,
    arithmetic: str,
    settings: dict[str, float | str],
    early: tuple[float, float],
    late: tuple[float, float],
) -> EstimatorProfile:
    velocity = estimates(case, Variant(ESTIMATORS[arithmetic], settings))
    found = delay(case, velocity)
    delay_s = None if np.isnan(found) else found
    truth = case.truth(case.time_s - (delay_s or 0.0))
    error = velocity - truth
    parts = [_within(case.time_s, part) for part in (early, late)]
    noise = [_rms(error[part]) for part in parts]
    reading = [_rms(velocity[part]) / _rms(truth[part]) for part in parts]
    seen = case.time_s >= 0.0
    return EstimatorProfile(
        velocity_rate=round(case.rate_hz),
        arithmetic=arithmetic,
        cutoff_hz=float(settings["cutoff_hz"]),
        time_s=case.time_s[seen],
        velocity=velocity[seen],
        delay_s=delay_s,
        noise_early=noise[0],
        noise_late=noise[1],
        reading_early=reading[0],
        reading_late=reading[1],
    )


def _within(time_s: Floats, part: tuple[float, float]) -> Any:
    return (time_s >= part[0]) & (time_s < part[1])


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
