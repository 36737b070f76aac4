"""Score velocity estimators on motions with a known velocity: error, delay, and noise at rest.

`rig estimators compare`, tuning, papers and the console use this module. A *case* is a series of counts with its true
velocity (`rig.experiments.estimation.cases`). A *variant* is an estimator with its settings.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from rig.control import estimators
from rig.control.estimators import Estimator, Floats, Prepared, inputs, require_effort, run
from rig.core.errors import ConfigError
from rig.core.present import Item, Row
from rig.core.sample import unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments.estimation.cases import DELAY_STEP_S, Case

# Durations of approach and rest, and the part of the rest in which noise is measured (s).
APPROACH_S, REST_S, LISTENED_S = 0.2, 1.0, 0.5
APPROACH_PERIOD_COUNTS = 0.1 * math.pi  # speed of the approach (counts per period), not a whole number
SILENCE_COUNTS = 1e-6  # a lower velocity (counts per period) counts as zero
TIMED_SAMPLES = 50_000
TIMED_RUNS = 9


@dataclass(frozen=True)
class Variant:
    """An estimator with settings; a setting that is not given has its default value."""

    estimator: str
    settings: Mapping[str, float | str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Variant:
        """Return estimator and settings of a text like ``kalman:gain=steady``; raise `ConfigError` if it is invalid."""
        name, _, rest = text.partition(":")
        settings: dict[str, float | str] = {}
        for part in filter(None, rest.split(",")):
            key, equals, value = part.partition("=")
            if not equals:
                raise ConfigError(
                    f"{text}: the setting {part!r} has no value",
                    remedy="write NAME:setting=value,setting=value",
                )
            try:
                settings[key.strip()] = float(value)
            except ValueError:
                settings[key.strip()] = value.strip()
        return cls(name, settings)

    @property
    def label(self) -> str:
        """Return name and settings of the estimator as text, for tables and legends."""
        settings = (
            f"{k}={v:g}" if isinstance(v, int | float) else f"{k}={v}" for k, v in self.settings.items()
        )
        return " ".join((self.estimator, *settings))


@dataclass(frozen=True, slots=True)
class Score:
    """A score of one estimator on one test case. Velocities are in rad/s or m/s; a number that does not apply is NaN.

    Attributes
    ----------
    rms
        Rms error of the estimated velocity.
    delay_s
        Delay of the estimate (s): the shift of the true velocity that minimises the error. It is negative for an
        estimate ahead of time, and NaN if noise or a constant velocity hides it.
    rms_without_delay
        Rms error after correction of the delay.
    rest_rms, toggling_rms
        Rms of the estimated velocity at rest after a motion: with a constant count, and with a count that toggles at
        random between two neighbours.
    ns_per_sample
        Time of one update on this machine (ns); NaN if it was not measured.
    refused
        Reason why the estimator cannot run at this rate; all numbers are then NaN. None if the estimator can run.
    """

    case: str
    rate_hz: float
    resolution: float
    estimator: str
    settings: Mapping[str, float | str]
    rms: float = math.nan
    delay_s: float = math.nan
    rms_without_delay: float = math.nan
    rest_rms: float = math.nan
    toggling_rms: float = math.nan
    ns_per_sample: float = math.nan
    refused: str | None = None


@dataclass(frozen=True, slots=True, repr=False)
class EstimatorComparison(Shown, Drawn):
    """Scores of velocity estimators on test cases (counts with a known velocity), sorted by case, then by estimator."""

    cases: tuple[Case, ...]
    variants: tuple[Variant, ...]
    scores: tuple[Score, ...]

    def brief(self) -> list[Item]:
        """Return the lines of a short report: error and delay of each estimator on each test case."""
        rows: list[Item] = []
        number = len(self.variants)
        for case, first in zip(self.cases, range(0, len(self.scores), number), strict=True):
            unit = unit_of("velocity", case.motion)
            rows += [f"{case.name} at {case.rate_hz:g} Hz, {case.speed_rms:.3g} {unit} rms"]
            for variant, score in zip(self.variants, self.scores[first : first + number], strict=True):
                late = "" if math.isnan(score.delay_s) else f"{1e3 * score.delay_s:.3g} ms late"
                rows += [Row(variant.label, score.refused or score.rms, "" if score.refused else unit, late)]
        return rows


def default_variants(names: Iterable[str] | None = None) -> tuple[Variant, ...]:
    """Return the named estimators with their default settings; None: all installed estimators that can be loaded."""
    if names is None:
        names = (name for name in estimators.names() if not estimators.broken(name))
    return tuple(Variant(name) for name in names)


def compare_estimators(
    cases: Case | Sequence[Case], variants: Sequence[str | Variant] = (), *, timed: bool = False
) -> EstimatorComparison:
    """Score velocity estimators on motions with a known velocity (`rig estimators compare`).

    Parameters
    ----------
    cases
        Counts with their true velocity: `counts_case` makes a case of arrays, `recording_case` of a recording.
    variants
        Estimators with their settings, like ``"kalman:gain=steady"``. If empty: all estimators, with default settings.
    timed
        True to measure also the time of one update on this machine (ns).

    Returns
    -------
    EstimatorComparison
        A `Score` for each variant on each case: rms error, delay (s), rms error without that delay, and rms noise at
        rest (rad/s or m/s).

    Raises
    ------
    ConfigError
        An estimator is unknown. Settings that cannot run at the rate of a case are reported in `Score.refused`.
    """
    cases = (cases,) if isinstance(cases, Case) else tuple(cases)
    chosen = tuple(Variant.parse(one) if isinstance(one, str) else one for one in variants)
    chosen = chosen or default_variants()
    for variant in chosen:
        estimators.get(variant.estimator)
    scores = tuple(score(case, variant, timed=timed) for case in cases for variant in chosen)
    return EstimatorComparison(cases, chosen, scores)


def score(case: Case, variant: Variant, *, timed: bool = False) -> Score:
    """Return errors and delay of an estimator on a test case (counts with known velocity); `timed`: also its cost."""
    named = (case.name, case.rate_hz, abs(case.resolution), variant.estimator, variant.settings)
    try:
        velocity = estimates(case, variant)
    except ConfigError as error:
        return Score(*named, refused=str(error))
    rms, delay_s, rms_without_delay = errors(case, velocity)
    at_rest = rest_noise(replace(variant, settings=_settings(case, variant)), case.dt, case.resolution)
    cost = cost_ns(case, variant) if timed else math.nan
    return Score(*named, rms, delay_s, rms_without_delay, *at_rest, cost)


def estimates(case: Case, variant: Variant) -> Floats:
    """Return the velocity estimated at each sample (rad/s or m/s), (n,); `ConfigError` if settings are invalid."""
    require_effort(estimators.get(variant.estimator), case.effort)
    return run(_prepared(case, variant), *case.arrays, case.effort)[0]


def _prepared(case: Case, variant: Variant) -> Prepared:
    estimator = estimators.get(variant.estimator)
    return estimator.prepare(_settings(case, variant), case.resolution, case.dt)


def _settings(case: Case, variant: Variant) -> dict[str, float | str]:
    """Return the estimator's settings: those of `variant`, and rig properties (like inertia) of the case."""
    return {**estimators.get(variant.estimator).settings_of(case.rig), **variant.settings}


def errors(case: Case, velocity: Floats) -> tuple[float, float, float]:
    """Return rms error (rad/s or m/s) of an estimated velocity, its delay (s), and rms error without that delay."""
    # Three numbers, because the raw error alone prefers the least delayed estimator despite its noise, and the
    # corrected error alone prefers the slowest filter.
    raw, delay_s = raw_error(case, velocity), delay(case, velocity)
    if math.isnan(delay_s):
        return raw, delay_s, raw
    return raw, delay_s, _rms(velocity[case.judged] - case.truth(case.judged_time_s - delay_s))


def raw_error(case: Case, velocity: Floats) -> float:
    """Return the rms error (rad/s or m/s) of an estimated velocity of shape (n,), over the samples to be scored."""
    return _rms(velocity[case.judged] - case.true_velocity)


def delay(case: Case, velocity: Floats) -> float:
    """Return the delay (s) of an estimated velocity of shape (n,), by least squares; NaN if it cannot be identified.

    Delays of −5 to 50 ms are tested and interpolated. The delay cannot be identified if the true velocity is constant,
    if the best delay is at an end of this range, or if noise makes its standard error larger than a step of 0.25 ms.
    """
    if np.ptp(case.true_velocity) <= 1e-9 * case.speed_rms:
        return math.nan
    chosen, delays, truths, powers = case.delayed_truths
    estimate = velocity[case.judged][chosen]
    squares = powers - 2.0 * (truths @ estimate) + np.sum(np.square(estimate))
    best = int(np.argmin(squares))
    if not 0 < best < len(delays) - 1:
        return math.nan
    # The error is smooth over many steps of the grid: a parabola through the best point and its neighbours determines
    # the delay to microseconds.
    before, least, after = squares[best - 1 : best + 2]
    bend = before - 2.0 * least + after
    # Least squares: the variance of the shift is 2·step²·least / (n·bend).
    if bend <= 2.0 * least / len(estimate):
        return math.nan
    return float(delays[best] + 0.5 * DELAY_STEP_S * (before - after) / bend)


def rest_noise(variant: Variant, dt: float, resolution: float) -> tuple[float, float]:
    """Return the rms velocity at rest after a steady approach (rad/s or m/s): with a constant and a toggling count.

    `dt` is the velocity period (s), `resolution` the travel for one count (rad or m).
    """
    return _rest_noise(estimators.get(variant.estimator), tuple(variant.settings.items()), dt, resolution)


@lru_cache(maxsize=256)  # the result does not depend on the test case
def _rest_noise(
    estimator: Estimator, settings: tuple[tuple[str, float | str], ...], dt: float, resolution: float
) -> tuple[float, float]:
    approach, rest = round(APPROACH_S / dt), round(REST_S / dt)
    path = APPROACH_PERIOD_COUNTS * np.minimum(np.arange(approach + rest), approach)
    counts = np.floor(path).astype(np.int64)
    # The count of a handle that rests on the boundary of an encoder cell.
    toggle = np.where(
        np.arange(len(counts)) > approach, np.random.default_rng(1).integers(0, 2, len(counts)), 0
    )
    listened = slice(-round(LISTENED_S / dt), None)
    found: list[float] = []
    for each in (counts, counts + toggle):
        prepared = estimator.prepare(dict(settings), resolution, dt)
        found.append(_rms(run(prepared, *inputs(each, dt))[0][listened]))
    # The decaying output of a filter is not noise.
    silence = SILENCE_COUNTS * abs(resolution) / dt
    resting, toggling = (0.0 if rms < silence else rms for rms in found)
    return resting, toggling


def cost_ns(case: Case, variant: Variant) -> float:
    """Return the shortest measured time of an update in a compiled loop (ns), over the case forwards and backwards."""
    times = math.ceil(TIMED_SAMPLES / len(case.counts))
    counts = np.concatenate([case.counts if i % 2 == 0 else case.counts[::-1] for i in range(times)])
    arrays = inputs(counts, case.dt)
    best = math.inf
    for _ in range(TIMED_RUNS):
        prepared = _prepared(case, variant)
        started = time.perf_counter_ns()
        run(prepared, *arrays)
        # The shortest of several runs: other programs can only add time.
        best = min(best, (time.perf_counter_ns() - started) / len(counts))
    return best


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan
