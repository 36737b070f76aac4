"""The same map on a device: hit after hit, with homing, a person who agrees, and a motor that may cool in between.

A hit is an ordinary one of `rig.experiments.hit`, with its checks, its recording and its verdict; a map is what their
recordings say. A real device stays open all along, so that position zero stays where it was when the session began; a
simulated one is a fresh one for each hit. A hit that says nothing is repeated; when it still does, or when the rig
itself gives up, the session ends. Climbs that were finished stay in the journal, and the same command goes on after
them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig import config, devices
from rig.config import Experiment
from rig.control.verdict import Kind, Measured, decide
from rig.core.errors import DeviceFaultError, GuardError, PlanError, RigError, StoppedError
from rig.core.sample import Phase
from rig.devices.framed import FramedDevice
from rig.devices.local import opened
from rig.experiments import sweep
from rig.experiments.hit import HitRequest, Recorded, hit, left_by
from rig.experiments.judgement import THREW_OUT, THROWN_OUT
from rig.experiments.ladder import Outcomes, Search
from rig.experiments.plan import device_checks, link_checks, plan_of
from rig.experiments.planned import Outcome
from rig.experiments.trial import prepared_on
from rig.experiments.zwidth import TRUE, MapPlan, ZWidth, hit_all, outcomes_of, row_of
from rig.recording.data import Recording

ATTEMPTS = 3  # at a hit that says nothing
CALM_S = 0.5  # pause between hits, whatever the motor's heat


@dataclass(frozen=True, slots=True)
class Next:
    """The hit that a person is asked to agree to."""

    scheme: str
    stiffness: float
    damping: float
    number: int  # of this climb's hits, from 1
    climb: int  # from 1
    climbs: int
    attempt: int = 1  # more when the last one said nothing
    thrown_out: bool = False  # whether the last hit left the handle out of its window


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What a map on a device needs beside its plan.

    Attributes
    ----------
    url, realtime, verified
        As in `rig.experiments.hit.HitRequest`; a real handle is at position zero when the session begins.
    recordings
        Directory for the recordings of all hits.
    agrees
        Asked before every hit; False ends the session.
    tells
        Told after every hit what came of it.
    pause
        Waits between two hits for a number of seconds, longer when the motor has to cool.
    """

    url: str
    recordings: Path
    agrees: Callable[[Next], bool]
    realtime: bool = False
    verified: bool = False
    tells: Callable[[Next, Measured], None] = field(default=lambda asked, done: None)
    pause: Callable[[float], None] = field(default=time.sleep)


def zwidth_on_rig(plan: MapPlan, session: Session, *, journal: Path | None = None) -> ZWidth:
    """Map a device.

    Raises
    ------
    PlanError
        A plan for a simulation: judged by truth, or with several encoder offsets, which a device does not have; or a
        scheme or a wall that this device or its link must not or cannot run. Nothing has moved then.
    StoppedError
        The person did not agree, or Ctrl-C; finished climbs stay in the journal.
    RigError
        Whatever ended a hit early, but for a wall that throws the handle out; or a hit that says nothing every time.
    """
    _check(plan)
    climbs, tasks = plan.climbs(), plan.tasks()
    numbers = {task.key: number for number, task in enumerate(tasks)}

    with _opened(plan, session) as device:
        _check_hits(plan, device)
        simulated = session.url.startswith("sim:")
        zero = device.count() if session.verified and not simulated else 0
        bench = _Bench(session, None if simulated else device, zero)

        def perform(task: sweep.Task) -> list[dict[str, Any]]:
            climb = climbs[numbers[task.key]]
            first = Next(
                scheme=plan.schemes[climb.scheme].label(plan.experiment),
                stiffness=plan.search.lowest,
                damping=climb.damping,
                number=1,
                climb=numbers[task.key] + 1,
                climbs=len(tasks),
            )
            try:
                return _climb(bench, plan.experiment_of(climb), Search(**task.payload["search"]), first)
            except (KeyboardInterrupt, StoppedError) as stop:
                raise _stopped(stop, first, journal) from stop

        work = work_of(session.url, session.realtime)
        climbs_done = sweep.run_here(work, perform, tasks, journal=journal)
        return ZWidth.of(plan, climbs_done, on_device=True)


def work_of(url: str, realtime: bool) -> str:
    """What a journal calls the work on a device: hits of one are no hits of another."""
    return f"{url} in real time" if realtime else url


@dataclass(slots=True)
class _Bench:
    """An open device, where its position zero is, and whether its handle is where the last hit should have left it."""

    session: Session
    device: FramedDevice | None  # None: a fresh simulated one for each hit
    reference_count: int
    thrown_out: bool = False


def _opened(plan: MapPlan, session: Session) -> AbstractContextManager[FramedDevice]:
    """Open the device of a session."""
    experiment = plan.experiment
    return opened(
        devices.url_for(session.url, experiment.controller.loop),
        config.rig_model(experiment),
        in_real_time=session.realtime,
        seed=experiment.trial.seed,
        realtime=experiment.host.realtime,
    )


def _climb(bench: _Bench, experiment: Experiment, search: Search, first: Next) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []

    def one(stiffness: float) -> Outcomes:
        asked = replace(first, stiffness=stiffness, number=len(rows) + 1)
        rows.append(_row(bench, experiment, asked))
        return outcomes_of(rows[-1], "recorded")

    hit_all(search, one)
    return rows


def _stopped(stop: BaseException, where: Next, journal: Path | None) -> StoppedError:
    """Say how far a session came; climbs are done in their order."""
    said = stop.message if isinstance(stop, StoppedError) else "stopped; the effort is zero"
    kept = f"{where.climb - 1} of {where.climbs} climbs are done" + (
        f" and kept in {journal}" if journal else ""
    )
    error = StoppedError(f"{said}; {kept}", remedy="the same command goes on from there" if journal else "")
    error.recording = getattr(stop, "recording", None)
    return error


def cooling_s(rms_effort: float, nominal_effort: float, duration_s: float) -> float:
    """How long a motor must rest after a push so that its mean heat over both is that of its nominal effort (s)."""
    return max(0.0, duration_s * ((rms_effort / nominal_effort) ** 2 - 1.0))


def _check(plan: MapPlan) -> None:
    if plan.judged != "recorded":
        raise PlanError("a device records what it records, not the truth", remedy="say --judge recorded")
    if len(plan.offsets) != 1:
        raise PlanError(
            f"{len(plan.offsets)} encoder offsets: on a device zero lies where it lies",
            remedy="give one offset; repeats take their place",
        )


def _check_hits(plan: MapPlan, device: FramedDevice) -> None:
    """Refuse what could not be hit, before anybody waits hours for it: the ends of the search under every scheme."""
    rungs = plan.search.rungs
    for number, scheme in enumerate(plan.schemes):
        climb = next(climb for climb in plan.climbs() if climb.scheme == number)
        under = plan.experiment_of(climb)
        checks = link_checks(under, device.dictionary.position_rate_maximum, device.link.bytes_per_second)
        for stiffness in (rungs[0], rungs[-1]):
            run = prepared_on(device, config.override(under, _changes(under, stiffness), "the map"))
            checks += [*device_checks(run, device.dictionary), *plan_of(run).checks]
        refused = {check.name: check for check in checks if check.outcome is Outcome.REFUSED}.values()
        if refused:
            raise PlanError(
                f"scheme {scheme.text}, K from {rungs[0]:.4g} to {rungs[-1]:.4g}: "
                + "; ".join(f"{check.name}: {check.text}" for check in refused),
                remedy="; ".join(check.remedy for check in refused),
            )


def _row(bench: _Bench, experiment: Experiment, asked: Next) -> dict[str, Any]:
    """Hit one wall until it says something, and return what it said."""
    session = bench.session
    for attempt in range(1, ATTEMPTS + 1):
        asked = replace(asked, attempt=attempt, thrown_out=bench.thrown_out and bench.device is not None)
        if not session.agrees(asked):
            raise StoppedError("ended between two hits; the effort is zero")
        left = _recorded_hit(bench, experiment, asked.stiffness)
        recorded, true = left.judgement.measured, left.judgement.measured_true
        session.tells(asked, recorded)
        session.pause(CALM_S + _cooling_of(left.recording, experiment))
        if recorded.passes("any") is not None:
            row = {"stiffness": asked.stiffness} | row_of(recorded, "")
            return row if true is None else row | row_of(true, TRUE)
    _, reasons = decide(recorded.numbers, recorded.thresholds)
    error = RigError(
        f"{ATTEMPTS} hits at K = {asked.stiffness:.4g}, B = {asked.damping:.4g} said nothing about the wall: "
        f"{'; '.join(reasons) or recorded.kind}; the effort is zero",
        remedy="mend that; the same command goes on after the last whole climb",
    )
    error.recording = left.path
    raise error


def _recorded_hit(bench: _Bench, experiment: Experiment, stiffness: float) -> Recorded:
    """Run one hit. One that the wall ended by throwing the handle out is a hit like others; other ends raise."""
    request = HitRequest(
        experiment=experiment,
        url=bench.session.url,
        realtime=bench.session.realtime,
        device=bench.device,
        reference_count=bench.reference_count,
        changes=_changes(experiment, stiffness),
        verified=bench.session.verified,
        output=bench.session.recordings,
        arm_anyway=True,  # a map looks for the walls that do not hold, and a person agrees to each hit
    )
    bench.thrown_out = False
    try:
        (result,) = hit(request)
    except (GuardError, DeviceFaultError) as error:
        left = left_by(error)
        if left is None or not _thrown_out(left):
            raise
        bench.thrown_out = True
        return left
    return result.recorded


def _thrown_out(left: Recorded) -> bool:
    """Whether the wall threw the handle out: in the push, or in the release, which leaves the verdict of the push."""
    early = left.judgement.early
    if early is not None:
        return early[0] is Kind.UNSTABLE
    trailer = left.recording.trailer or {}
    fault = (trailer.get("fault") or {}).get("name")
    return trailer.get("reason") in THREW_OUT or fault in THROWN_OUT


def _changes(experiment: Experiment, stiffness: float) -> Mapping[str, Any]:
    """What the map says wins over what the experiment has for real time."""
    controller = experiment.controller
    return {
        "controller.position_rate": controller.position_rate,
        "controller.velocity_rate": controller.velocity_rate,
        "wall.stiffness": stiffness,
        "wall.damping": experiment.wall.damping,
        "trial.repeats": 1,
    }


def _cooling_of(recording: Recording, experiment: Experiment) -> float:
    pushing = recording.rows[recording.rows["phase"] == Phase.TRIAL]
    if not len(pushing):
        return 0.0
    rms = float(np.sqrt(np.mean(np.square(pushing["effort_sent"]))))
    duration_s = len(pushing) / experiment.controller.position_rate
    return cooling_s(rms, experiment.rig.limits.nominal_effort, duration_s)
