"""Compute figures 7 and 8 of Koul et al.: single impacts without damping, with uniform and with dual-rate sampling.

This project chose the conditions that the paper does not give: koul-rigid without a hand, 70 g at its end; K = 40
N·m/rad, B = 0.2 N·m·s/rad; 60 mN·m on the link, inside and outside the wall; start 2 mrad before the wall at 1.5 rad/s;
×4 decoding. The reproduction of Koul et al. and `rig reproduce koul --impacts` use it.

In floating point a uniform wall is damped as well as a dual-rate one; figure 7 needs a filter with few fractional bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

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
# With few fractional bits, truncated towards zero, the estimate of a slow handle at a high velocity rate is zero, and
# the damping is lost. Between the extremes the result depends on the position of the counts: with 4 bits at 10 kHz the
# peak of the uniform wall is 35 to 46 counts, depending on the encoder's offset.
COEFFICIENT_BITS, STATE_BITS, ROUNDING = 14, 4, "zero"
FIRST_IMPACT_S = 0.05
LIKE_NONE, BETWEEN, MUCH_LESS = 0.95, 0.1, 0.6  # peaks over those of another wall: what the paper shows

EARLY, LATE = (1.0, 0.25), (0.25, 0.02)  # parts of the impact, by speed over that of the first contact


class PerDamping(NamedTuple):
    """A value without damping, with uniform and with dual-rate damping."""

    none: float
    uniform: float
    dual: float


class Entries(NamedTuple):
    """Sampling schemes to compare: without damping, uniform and dual-rate."""

    none: Entry
    uniform: Entry
    dual: Entry


class ImpactSpan(NamedTuple):
    """Begin and end of a part of an impact (s since the first contact)."""

    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel of figure 7: impacts with no, uniform and dual-rate damping at one position rate and arithmetic."""

    position_rate: int
    arithmetic: str
    comparison: SchemeComparison

    @property
    def peaks(self) -> PerDamping:
        """Return the mean peak penetrations (counts) with no, uniform and dual-rate damping."""
        return PerDamping(*(self.comparison[name].numbers.peak for name in PerDamping._fields))

    @property
    def decays(self) -> PerDamping:
        """Mean decay of the oscillation with no, uniform and dual-rate damping (1: it does not decay)."""
        return PerDamping(*(self.comparison[name].numbers.decay for name in PerDamping._fields))

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


def koul_entries(position_rate: int, uniform_share: float = UNIFORM_SHARE) -> Entries:
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
    return Entries(
        none=Entry(name="none", scheme=uniform, damping=0.0),
        uniform=Entry(name="uniform", scheme=uniform),
        dual=Entry(name="dual", scheme=dual),
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
    none = {rate: _peak(koul_experiment(), koul_entries(rate).none, offsets) for rate in POSITION_RATES}
    table: list[WordLength] = []
    for bits in state_bits:
        experiment = koul_experiment(FIXED, bits)
        dual = {rate: _peak(experiment, koul_entries(rate).dual, offsets) for rate in POSITION_RATES}
        for share in uniform_shares:
            uniform = {
                rate: _peak(experiment, koul_entries(rate, share).uniform, offsets) for rate in POSITION_RATES
            }
            table.append(
                WordLength(state_bits=bits, uniform_share=share, none=none, uniform=uniform, dual=dual)
            )
    return tuple(table)


def _peak(experiment: Experiment, entry: Entry, offsets: Sequence[float]) -> float:
    short = config.override(experiment, {"trial.duration_s": FIRST_IMPACT_S, "verdict.tail_s": 0.02})
    applied = entry.applied(short)
    traces = (trace for _, _, trace in (simulate(applied, START, offset) for offset in offsets))
    return float(np.mean([trace.counts.max() for trace in traces]))


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

    `offset` is the position of zero in its encoder cell (counts, 0 to 1), `state_bits` are the fractional bits of the
    fixed-point filter, `uniform_share` is the cut-off of the estimator at 20 kHz divided by its rate.
    """
    rate = POSITION_RATES[0]
    # One motion for all estimators, of the wall without damping, so that no estimate affects the motion.
    experiment = koul_entries(rate).none.applied(koul_experiment())
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
                judged=_within(time_s[every], ImpactSpan(early.begin_s, late.end_s)),
                truth=lambda at_s: np.interp(at_s, time_s, true),
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


def _split_impact(time_s: Floats, velocity: Floats) -> tuple[ImpactSpan, ImpactSpan]:

    def last(share: float) -> float:
        above = np.flatnonzero(np.abs(velocity) >= share * abs(velocity[0]))
        return float(time_s[above[-1]])

    _, early_end = EARLY
    late_begin, late_end = LATE
    if last(late_end) <= last(late_begin):
        raise ConfigError(
            "the simulated impact ends while the handle is still fast, so its slow part cannot be evaluated",
            remedy="increase trial.duration_s",
        )
    return ImpactSpan(0.0, last(early_end)), ImpactSpan(last(late_begin), last(late_end))


def _profile(
    case: Case,
    arithmetic: str,
    settings: dict[str, float | str],
    early: ImpactSpan,
    late: ImpactSpan,
) -> EstimatorProfile:
    velocity = estimates(case, Variant(ESTIMATORS[arithmetic], settings))
    found = delay(case, velocity)
    delay_s = None if np.isnan(found) else found
    truth = case.truth(case.time_s - (delay_s or 0.0))
    error = velocity - truth
    fast, slow = _within(case.time_s, early), _within(case.time_s, late)
    seen = case.time_s >= 0.0
    return EstimatorProfile(
        velocity_rate=round(case.rate_hz),
        arithmetic=arithmetic,
        cutoff_hz=float(settings["cutoff_hz"]),
        time_s=case.time_s[seen],
        velocity=velocity[seen],
        delay_s=delay_s,
        noise_early=_rms(error[fast]),
        noise_late=_rms(error[slow]),
        reading_early=_rms(velocity[fast]) / _rms(truth[fast]),
        reading_late=_rms(velocity[slow]) / _rms(truth[slow]),
    )


def _within(time_s: Floats, span: ImpactSpan) -> Any:
    return (time_s >= span.begin_s) & (time_s < span.end_s)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
