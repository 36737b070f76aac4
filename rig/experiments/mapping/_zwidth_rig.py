"""Map walls by hits on a device: home, ask a person for permission, hit, and let the motor cool, again and again.

`_maps` calls this module for `rig zwidth --url`. The map is computed from the recordings of its hits. An invalid hit is
repeated and not used. Results of finished stiffness searches (series) stay in the journal (file of results), and the
same command resumes after them.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment
from rig.control.verdict import CRITERIA, Kind, Measured, decide
from rig.core.check import Check, refuse, refused
from rig.core.errors import PlanError, RigError, StoppedError
from rig.core.sample import Phase
from rig.devices.framed import FramedDevice
from rig.experiments import sweep
from rig.experiments.hits._on_device import Ended, OnDevice, Trials, examined
from rig.experiments.hits.admission import admission_checks
from rig.experiments.hits.hit import Recorded
from rig.experiments.mapping._searches import Outcomes, StiffnessSearch, drive
from rig.experiments.mapping.zwidth import TRUE, MapPlan, ZWidth, outcomes_of, row_of
from rig.experiments.trials.judgement import out_of_time, thrown_out
from rig.experiments.trials.preparation import prepared_on
from rig.recording.data import Recording

ATTEMPTS = 3  # hits of a wall while they are invalid
RECORDING = "recording"  # column with the name of the hit's file, in the map of a device
CALM_S = 0.5  # shortest pause between hits (s)


@dataclass(frozen=True, slots=True)
class Next:
    """The next hit, which a person must permit: scheme, stiffness, damping, and its number in the map."""

    scheme: str
    stiffness: float
    damping: float
    number: int  # number of the hit in its series, from 1
    series: int  # number of the series, from 1
    total: int  # number of all series
    attempt: int = 1  # above 1 if the last hit of this wall was invalid
    thrown_out: bool = False  # True if the handle is outside of its window since the last hit


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceMap:
    """A device whose stable walls are searched by hits, and functions for the dialogue with a person.

    Attributes
    ----------
    where
        Device to map. Walls are armed even if the link makes them dangerous, because the map of stable walls must find
        unstable walls; a person permits each hit instead.
    agrees
        Called with the next hit before each hit; the session ends if it returns False.
    report
        Called after each hit with the hit, its measured numbers, and True if the hit is valid.
    pause
        Called between two hits with the time to wait (s), which is longer if the motor must cool.
    """

    where: OnDevice
    agrees: Callable[[Next], bool]
    report: Callable[[Next, Measured, bool], None] = field(default=lambda asked, done, valid: None)
    pause: Callable[[float], None] = field(default=time.sleep)


def zwidth_on_rig(plan: MapPlan, session: DeviceMap, *, journal: Path | None = None) -> ZWidth:
    """Find the stable walls of a device by hits; store each finished stiffness search in the file `journal`.

    Searches whose results are in this file already are not run again.

    Raises
    ------
    PlanError
        The plan needs a simulation (judged by true signals, or several encoder offsets), or the device or its link
        cannot run a sampling scheme or a wall. Nothing has moved.
    StoppedError
        The person did not agree, or Ctrl-C was pressed; results of finished searches stay in the journal.
    RigError
        A hit ended early for another reason than an unstable wall, or was invalid in three attempts.
    """
    _check(plan)
    series, tasks = plan.series(), plan.tasks
    numbers = {task.key: number for number, task in enumerate(tasks)}
    # A map must find the walls that fail, which the arming gate would refuse. Instead a person permits each hit.
    where = replace(session.where, arm_anyway=True)

    with examined(where, plan.experiment) as (device, trials):
        _check_hits(plan, device)
        hits = _Hits(session, trials)

        def perform(task: sweep.Task) -> list[dict[str, Any]]:
            one = series[numbers[task.key]]
            first = Next(
                scheme=plan.schemes[one.scheme].label(plan.experiment),
                stiffness=plan.search.lowest,
                damping=one.damping,
                number=1,
                series=numbers[task.key] + 1,
                total=len(tasks),
            )
            try:
                return hits.series(plan.experiment_of(one), StiffnessSearch(**task.payload["search"]), first)
            except (KeyboardInterrupt, StoppedError) as stop:
                raise _make_stop_error(stop, first, journal) from stop

        done = sweep.run_here(work_of(where.url, where.realtime), perform, tasks, journal=journal)
        return ZWidth.of(plan, done, on_device=True)


def work_of(url: str, realtime: bool) -> str:
    """Return the name of a device for the file of results, so that the hits of two devices are not mixed."""
    return f"{url} in real time" if realtime else url


def cooling_s(rms_effort: float, nominal_effort: float, duration_s: float) -> float:
    """Return how long to pause (s) after a push so that the motor's mean heat is that of its nominal effort."""
    return max(0.0, duration_s * ((rms_effort / nominal_effort) ** 2 - 1.0))


def _make_stop_error(stop: BaseException, where: Next, journal: Path | None) -> StoppedError:
    """Return the error for a stopped map, whose message has the number of finished stiffness searches."""
    reason = stop.message if isinstance(stop, StoppedError) else "stopped; the effort is zero"
    kept = f"{where.series - 1} of {where.total} series are done" + (
        f" and stored in {journal}" if journal else ""
    )
    remedy = "run the same command again: it resumes from there" if journal else ""
    error = StoppedError(f"{reason}; {kept}", remedy=remedy)
    error.recording = getattr(stop, "recording", None)
    return error


def _check(plan: MapPlan) -> None:
    if plan.judged != "recorded":
        raise PlanError(
            "`judge` = true needs the true signals of a simulation; a device records only measured signals",
            remedy="set `judge` to recorded",
        )
    if len(plan.offsets) != 1:
        raise PlanError(
            f"{len(plan.offsets)} encoder offsets (positions of the wall within a count) are given; only a "
            "simulation can vary them",
            remedy="give a single offset (any value; a device ignores it), and raise the number of repeats instead",
        )


def _check_hits(plan: MapPlan, device: FramedDevice) -> None:
    """Raise `PlanError` before anything moves if a scheme's softest or stiffest wall may not be hit."""
    rungs = plan.search.rungs
    for number, scheme in enumerate(plan.schemes):
        under = plan.experiment_of(next(one for one in plan.series() if one.scheme == number))
        checks: list[Check] = []
        for stiffness in (rungs[0], rungs[-1]):
            run = prepared_on(device, config.override(under, {"wall.stiffness": stiffness}, "the map"))
            checks += admission_checks(run, device)
        try:
            refuse({check.name: check for check in refused(checks)}.values())
        except PlanError as error:
            scheme_and_range = f"scheme {scheme.text}, K from {rungs[0]:.4g} to {rungs[-1]:.4g}"
            raise PlanError(f"{scheme_and_range}: {error.message}", remedy=error.remedy) from None


@dataclass(slots=True)
class _Hits:
    """Runs hits on an open device; `thrown_out` is True if the last wall drove the handle out of its window."""

    session: DeviceMap
    trials: Trials
    thrown_out: bool = False

    def series(self, experiment: Experiment, search: StiffnessSearch, first: Next) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []

        def one(stiffness: float) -> Outcomes:
            rows.append(self._row(experiment, replace(first, stiffness=stiffness, number=len(rows) + 1)))
            return outcomes_of(rows[-1], "recorded")

        drive(search.walk(CRITERIA), one)
        return rows

    def _row(self, experiment: Experiment, asked: Next) -> dict[str, Any]:
        """Hit one wall until a hit is valid; return its numbers. Raise `RigError` after three invalid hits."""
        for attempt in range(1, ATTEMPTS + 1):
            moved = self.thrown_out and self.trials.device is not None
            asked = replace(asked, attempt=attempt, thrown_out=moved)
            if not self.session.agrees(asked):
                raise StoppedError("ended between two hits by the operator; the effort is zero")
            left = self._hit(experiment, asked.stiffness)
            recorded, true = left.judgement.measured, left.judgement.measured_true
            early = left.judgement.early
            valid = recorded.passes("any") is not None and (early is None or early[0] is Kind.UNSTABLE)
            self.session.report(asked, recorded, valid)
            self.session.pause(CALM_S + _cooling_of(left.recording, experiment))
            if valid:
                row = {"stiffness": asked.stiffness, RECORDING: left.path.name} | row_of(recorded, "")
                return row if true is None else row | row_of(true, TRUE)
        _, reasons = decide(recorded.numbers, recorded.thresholds)
        reasons = reasons if early is None else (*reasons, early[1])
        error = RigError(
            f"{ATTEMPTS} hits at K = {asked.stiffness:.4g}, B = {asked.damping:.4g} were invalid: "
            f"{'; '.join(reasons) or recorded.kind}; the effort is zero",
            remedy="remove the cause; then run the same command again: it resumes after the last complete series",
        )
        error.recording = left.path
        raise error

    def _hit(self, experiment: Experiment, stiffness: float) -> Recorded:
        """Run one hit; return its recording, also if an unstable wall or lost time ended it; raise any other error."""
        self.thrown_out = False
        done = self.trials.run(experiment, {"wall.stiffness": stiffness})
        if isinstance(done, Recorded):
            return done
        self.thrown_out = _is_thrown_out(done)
        # An unstable wall is a result; a lack of processor or link time makes the hit invalid, and the hit is repeated.
        # Any other end is a defect of the rig.
        if not self.thrown_out and not out_of_time(done.recorded.recording):
            raise done.error
        return done.recorded


def _is_thrown_out(ended: Ended) -> bool:
    """Return True if an unstable wall drove the handle out of its window during the push or the release."""
    early = ended.recorded.judgement.early
    return early[0] is Kind.UNSTABLE if early is not None else thrown_out(ended.recorded.recording) != ""


def _cooling_of(recording: Recording, experiment: Experiment) -> float:
    pushing = recording.rows[recording.rows["phase"] == Phase.TRIAL]
    if not len(pushing):
        return 0.0
    rms = float(np.sqrt(np.mean(np.square(pushing["effort_sent"]))))
    duration_s = len(pushing) / experiment.controller.position_rate
    return cooling_s(rms, experiment.rig.limits.nominal_effort, duration_s)
