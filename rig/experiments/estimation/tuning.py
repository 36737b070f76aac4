"""Find the settings of an estimator that minimise an objective on one motion, and the sensitivity to each setting.

`rig estimators tune` calls this module. An optimum is valid for its motion, rate and resolution. The reported range, in
which the objective rises by at most a tenth, shows how sensitive the optimum is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rig.control import estimators
from rig.control.estimators import Estimator, Floats, Setting
from rig.core.deferred import optimize, stats
from rig.core.errors import ConfigError
from rig.core.present import Item, Row
from rig.core.shown import Shown
from rig.experiments.estimation.cases import Case
from rig.experiments.estimation.estimators import Score, Variant, errors, estimates, raw_error, score

DELAY_SCALE_S = 0.01
NEGLIGIBLE = 0.005  # a setting keeps its start value if its optimum is better by less than this fraction
WITHIN = 0.1  # largest relative increase of the objective in the reported range
DECADES = 3.0  # decades searched on both sides of the start, within the setting's allowed range
SCANNED_LOG2 = 5  # points of the first scan: 2^(this + number of settings)
MOST_EVALUATIONS = 200  # evaluations of the descent for each setting
LADDER = 100  # steps over the whole scale when the reported range is searched
DIGITS = 4  # significant digits of a tuned value

Settings = Mapping[str, float | str]


def _measure_corrected(case: Case, velocity: Floats) -> float:
    return errors(case, velocity)[2]


def _measure_both(case: Case, velocity: Floats) -> float:
    _, delay_s, left = errors(case, velocity)
    late = 0.0 if math.isnan(delay_s) else abs(delay_s)
    return left / case.speed_rms + late / DELAY_SCALE_S


# rms: the error that a damped wall reacts to; use it first. delay-corrected-rms: ignores delay, so that it selects the
# slowest filter that preserves the shape; for off-line analysis. rms+delay: a delay of 1 ms counts as much as an error
# of a tenth of the speed.
OBJECTIVES: dict[str, Callable[[Case, Floats], float]] = {
    "rms": raw_error,
    "delay-corrected-rms": _measure_corrected,
    "rms+delay": _measure_both,
}


@dataclass(frozen=True, slots=True)
class SettingRange:
    """Range of a tuned setting in which the objective is at most a tenth worse, with the other settings constant.

    `open_below` and `open_above` are True if the search ended at that bound, so that the range may be larger.
    """

    setting: str
    unit: str
    value: float
    low: float
    high: float
    open_below: bool
    open_above: bool


@dataclass(frozen=True, slots=True, repr=False)
class Tuning(Shown):
    """Result of tuning an estimator on one test case: the best settings, and the range of each tuned setting.

    `settings` has the given and the changed settings; all others have their default. `objective_start` and
    `objective_best` are the values of the objective before and after; `before` and `after` are the scores.
    """

    estimator: str
    case: str
    reference: str
    objective: str
    settings: Settings
    objective_start: float
    objective_best: float
    ranges: tuple[SettingRange, ...]
    before: Score
    after: Score
    evaluations: int

    def brief(self) -> list[Item]:
        """Return the lines of a short report: the tuned settings, each with its range."""
        rows = [Row(one.setting, one.value, note=f"within 10 %: {shown_range(one)}") for one in self.ranges]
        changed = f"{self.objective} {self.objective_start:.4g} before, {self.objective_best:.4g} now"
        return [f"{self.estimator} tuned on {self.case}: {changed}", *rows]

    def toml(self) -> str:
        """Return the ``[controller]`` section of an experiment file, with comments on objective, case and ranges."""
        comments = {each.setting: f"  # within 10 %: {shown_range(each)}" for each in self.ranges}
        lines = [
            f"# Tuned for {self.objective} on {self.case} ({self.reference}) at {self.after.rate_hz:g} Hz,",
            f"# {self.after.resolution:g} a count: {self.objective_start:.4g} before, {self.objective_best:.4g} now.",
            "[controller]",
            f'estimator = "{self.estimator}"',
            "",
            "[controller.parameters]",
        ]
        for name, value in self.settings.items():
            text = f'"{value}"' if isinstance(value, str) else f"{value!r}"
            lines.append(f"{name} = {text}{comments.get(name, '')}")
        return "\n".join(lines) + "\n"


def tune_estimator(
    estimator: str,
    case: Case,
    *,
    objective: str = "rms",
    settings: Settings | None = None,
    free: Sequence[str] | None = None,
) -> Tuning:
    """Find the settings of an estimator that minimise an objective on a test case (`rig estimators tune`).

    Parameters
    ----------
    estimator
        Name of the estimator.
    case
        Counts with their true velocity: `counts_case` makes a case of arrays, `recording_case` of a recording.
    objective
        ``"rms"``: rms error. ``"delay-corrected-rms"``: rms error after correction of the delay. ``"rms+delay"``: the
        corrected error divided by the rms speed, plus the delay divided by 10 ms.
    settings
        Start of the search; other settings start at their default. Settings that are not numbers are not changed.
    free
        Names of the numbers to tune. None: all numbers that can be changed and influence the estimate, except
        properties of the rig and numbers that start at zero, which means "not given".

    Returns
    -------
    Tuning
        Result of a scan by a Sobol sequence, then a search by Nelder and Mead from the best point; equal to the last
        bit in every run. A setting without influence stays at its start.

    Raises
    ------
    ConfigError
        An estimator, objective or setting is unknown, no setting can be tuned, or the estimator cannot run with the
        start settings.
    """
    if objective not in OBJECTIVES:
        raise ConfigError(
            f"unknown objective {objective!r}", remedy=f"choose one of: {', '.join(OBJECTIVES)}"
        )
    search = _TuningWalk(estimators.get(estimator), case, OBJECTIVES[objective], dict(settings or {}))
    search.open(free)
    best = search.plain(search.descend())
    return Tuning(
        estimator=estimator,
        case=case.name,
        reference=case.reference,
        objective=objective,
        settings=search.settings_at(best),
        objective_start=search.value(search.start),
        objective_best=search.value(search.settings_at(best)),
        ranges=tuple(search.range_of(i, best) for i in range(len(search.axes))),
        before=score(case, Variant(estimator, search.start)),
        after=score(case, Variant(estimator, search.settings_at(best))),
        evaluations=len(search.known),
    )


@dataclass(frozen=True, slots=True)
class _Axis:
    """A setting to tune, on a scale from 0 to 1 that is logarithmic if its range is positive."""

    setting: Setting
    low: float
    high: float
    whole: bool

    @classmethod
    def around(cls, setting: Setting, start: float, whole: bool) -> _Axis:
        if setting.minimum <= 0.0 or start <= 0.0:
            return cls(setting, setting.minimum, setting.maximum, whole)
        reach = 10.0**DECADES
        return cls(setting, max(setting.minimum, start / reach), min(setting.maximum, start * reach), whole)

    def value(self, place: float) -> float:
        place = min(max(place, 0.0), 1.0)
        if self.low > 0.0:
            value = self.low * (self.high / self.low) ** place
        else:
            value = self.low + place * (self.high - self.low)
        rounded = round(value) if self.whole else float(f"{value:.{DIGITS}g}")
        return float(min(max(rounded, self.low), self.high))

    def place(self, value: float) -> float:
        if self.high <= self.low:
            return 0.0
        if self.low > 0.0:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


class _TuningWalk:
    """A search for the best settings of an estimator, with a cache of the objective; scales run from 0 to 1."""

    def __init__(
        self,
        estimator: Estimator,
        case: Case,
        objective: Callable[[Case, Floats], float],
        given: dict[str, float | str],
    ) -> None:
        self.estimator, self.case, self.objective = estimator, case, objective
        self.known: dict[tuple[tuple[str, float | str], ...], float] = {}
        self.axes: list[_Axis] = []
        self.start = given
        # Raises if the start values are not realisable.
        self.reference = estimates(case, Variant(estimator.name, self.start))

    def value(self, settings: Settings) -> float:
        """Return the objective (smaller is better) for these settings; infinite if the estimator cannot run."""
        key = tuple(settings.items())
        if key not in self.known:
            self.known[key] = self._evaluate(settings)
        return self.known[key]

    def _evaluate(self, settings: Settings) -> float:
        try:
            velocity = estimates(self.case, Variant(self.estimator.name, settings))
        except ConfigError:
            # Infinity lets the search continue from other points.
            return math.inf
        found = self.objective(self.case, velocity)
        return found if math.isfinite(found) else math.inf

    def open(self, free: Sequence[str] | None) -> None:
        """Choose the settings to search: those named in `free`, or None: all numbers that change the estimate."""
        numbers = {s.name: s for s in self.estimator.settings if isinstance(s, Setting)}
        for name in free or ():
            if name not in numbers:
                raise ConfigError(
                    f"estimator {self.estimator.name} has no numeric setting {name!r} to tune",
                    remedy=f"choose one of its numeric settings: {', '.join(numbers)}"
                    if numbers
                    else "choose another estimator: this one has no numeric settings",
                )
        for name in free or numbers:
            if free is None and (numbers[name].of_rig or not self.begin(numbers[name])):
                continue
            axis = self._axis(numbers[name])
            if axis is not None:
                self.axes.append(axis)
        if not self.axes:
            raise ConfigError(
                f"estimator {self.estimator.name} has no tunable setting: none changes the estimate on this motion",
                remedy="choose another estimator, or other settings of this one",
            )

    def begin(self, setting: Setting) -> float:
        """Return the start value of a setting: given by the caller, else by the rig, else the default."""
        known = {**self.estimator.settings_of(self.case.rig), **self.start}
        return float(known.get(setting.name, setting.default or setting.minimum))

    def _axis(self, setting: Setting) -> _Axis | None:
        """Return a scale for a setting over its range; None if no tested value changes the estimate."""
        start = self.begin(setting)
        for whole in (False, True):
            axis = _Axis.around(setting, start, whole)
            # Most settings are valid in a part of their range only: try several points.
            for place in (0.37, 0.23, 0.51, 0.77, 0.09, 0.93):
                other = {**self.start, setting.name: axis.value(place)}
                try:
                    velocity = estimates(self.case, Variant(self.estimator.name, other))
                except ConfigError:
                    continue
                if not np.array_equal(velocity, self.reference):
                    return axis
        return None

    def settings_at(self, places: Floats) -> dict[str, float | str]:
        """Return the settings for `places`, the value of each tuned setting on a scale from 0 to 1."""
        found = dict(self.start)
        for axis, place in zip(self.axes, places, strict=True):
            value = axis.value(float(place))
            if axis.setting.name in self.start or value != self.begin(axis.setting):
                found[axis.setting.name] = value
        return found

    def descend(self) -> Floats:
        """Return the best value of each tuned setting (0 to 1), by a Sobol scan and a Nelder-Mead descent."""
        d = len(self.axes)
        start = np.array([axis.place(self.begin(axis.setting)) for axis in self.axes])
        # A scan before the descent, which finds only the nearest minimum. Sobol without scrambling, so that a tuning
        # repeats to the bit.
        points = [start, *stats.qmc.Sobol(d, scramble=False).random_base2(SCANNED_LOG2 + d)]
        values = [self.value(self.settings_at(point)) for point in points]
        best = np.array(points[int(np.argmin(values))])
        spread = 2.0 ** -(1.0 + SCANNED_LOG2 / d)
        corners = best + spread * np.eye(d) * np.where(best > 0.5, -1.0, 1.0)
        found = optimize.minimize(
            lambda point: self.value(self.settings_at(point)),
            best,
            # No derivative: values are rounded to `DIGITS`, and unrealisable ones are infinite.
            method="Nelder-Mead",
            bounds=[(0.0, 1.0)] * d,
            options={
                "initial_simplex": np.vstack([best, corners]),
                "xatol": 1e-4,
                "fatol": 1e-6 * min(values),
                "maxfev": MOST_EVALUATIONS * d,
            },
        )
        return np.asarray(found.x if found.fun <= min(values) else best, dtype=np.float64)

    def plain(self, best: Floats) -> Floats:
        """Return the best point `best` (0 to 1 per setting), with settings that hardly matter reset to their start."""
        limit = (1.0 + NEGLIGIBLE) * self.value(self.settings_at(best))
        for i, axis in enumerate(self.axes):
            start = axis.place(self.begin(axis.setting))
            # The optimum of a setting with little influence would only fit the noise of this motion.
            if self._along(i, best, start) <= limit:
                best = np.array(best)
                best[i] = start
        return best

    def range_of(self, i: int, best: Floats) -> SettingRange:
        """Return the range of the tuned setting number `i` in which the objective is at most a tenth worse."""
        axis, limit = self.axes[i], (1.0 + WITHIN) * self.value(self.settings_at(best))
        ends: list[float] = []
        opened: list[bool] = []
        for direction in (-1.0, 1.0):
            inside, outside = float(best[i]), None
            for k in range(1, LADDER + 1):
                place = float(best[i]) + direction * k / LADDER
                if not -1.0 / LADDER < place < 1.0 + 1.0 / LADDER:
                    break
                if self._along(i, best, place) > limit:
                    outside = place
                    break
                inside = place
            for _ in range(0 if outside is None else 8):
                middle = 0.5 * (inside + float(outside or 0.0))
                if self._along(i, best, middle) > limit:
                    outside = middle
                else:
                    inside = middle
            ends.append(axis.value(inside))
            opened.append(outside is None)
        (low, high), name, unit = ends, axis.setting.name, axis.setting.unit
        return SettingRange(name, unit, axis.value(float(best[i])), low, high, *opened)

    def _along(self, i: int, best: Floats, place: float) -> float:
        point = np.array(best)
        point[i] = place
        return self.value(self.settings_at(point))


def shown_range(found: SettingRange) -> str:
    """Return the range of a setting as a text, with its unit."""
    low, high, unit = f"{found.low:.4g}", f"{found.high:.4g}", "" if found.unit == "1" else f" {found.unit}"
    if found.open_below and found.open_above:
        return f"anything from {low} to {high}{unit}"
    return f"{low}{' or less' if found.open_below else ''} to {high}{' or more' if found.open_above else ''}{unit}"
