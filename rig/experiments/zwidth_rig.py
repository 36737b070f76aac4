"""The same map on a device: hit after hit, with homing, a person who agrees, and a motor that may cool in between.

A hit is an ordinary one of `rig.experiments.hit`, with its checks, its recording and its verdict; a map is what their
recordings say. A hit that says nothing is repeated; when it still does, or when the rig itself gives up, the session
ends. Climbs that were finished stay in the journal, and the same command goes on after them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment
from rig.errors import PlanError, RigError, StoppedError
from rig.experiments import sweep
from rig.experiments.hit import HitRequest, hit
from rig.experiments.judgement import ended_early, experiment_of
from rig.experiments.ladder import Outcomes, Search
from rig.experiments.zwidth import TRUE, MapPlan, ZWidth, hit_all, row_of
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.sample import Phase
from rig.verdict import CRITERIA, Kind, Measured, measured, recorded_signals, true_signals

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What a map on a device needs beside its plan.

    Attributes
    ----------
    url, verified
        As in `rig.experiments.hit.HitRequest`.
    recordings
        Directory for the recordings of all hits.
    agrees
        Asked before every hit; False ends the session.
    pause
        Waits for a number of seconds, longer when the motor has to cool.
    """

    url: str
    recordings: Path
    agrees: Callable[[Next], bool]
    verified: bool = False
    pause: Callable[[float], None] = field(default=time.sleep)


def zwidth_on_rig(plan: MapPlan, session: Session, *, journal: Path | None = None) -> ZWidth:
    """Map a device.

    Raises
    ------
    PlanError
        A plan for a simulation: judged by truth, or with several encoder offsets, which a device does not have.
    StoppedError
        The person did not agree, or Ctrl-C; finished climbs stay in the journal.
    RigError
        Whatever ended a hit early, but for a wall that throws the handle out.
    """
    _check(plan)
    climbs = plan.climbs()
    tasks = plan.tasks()
    numbers = {task.key: number for number, task in enumerate(tasks)}

    def perform(task: sweep.Task) -> list[dict[str, Any]]:
        climb = climbs[numbers[task.key]]
        experiment = plan.experiment_of(climb)
        rows: list[dict[str, Any]] = []

        def one(stiffness: float) -> Outcomes:
            asked = Next(
                scheme=plan.schemes[climb.scheme].label(plan.experiment),
                stiffness=stiffness,
                damping=climb.damping,
                number=len(rows) + 1,
                climb=numbers[task.key] + 1,
                climbs=len(tasks),
            )
            done = _measured_hit(experiment, stiffness, asked, session, rows)
            return {criterion: done.passes(criterion) for criterion in CRITERIA}

        hit_all(Search(**task.payload["search"]), one)
        return rows

    return ZWidth.of(plan, sweep.run_here(session.url, perform, tasks, journal=journal))


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


def _measured_hit(
    experiment: Experiment, stiffness: float, asked: Next, session: Session, rows: list[dict[str, Any]]
) -> Measured:
    """Hit one wall until it says something, and keep a row for each attempt that did."""
    for _ in range(ATTEMPTS):
        if not session.agrees(asked):
            raise StoppedError("the session was ended between two hits; the effort is zero")
        recording = _recorded_hit(experiment, stiffness, session)
        session.pause(CALM_S + _cooling_of(recording, experiment))
        recorded, true = _measured(recording)
        if recorded.passes("any") is None:
            continue
        row = {"stiffness": stiffness} | row_of(recorded, "")
        rows.append(row if true is None else row | row_of(true, TRUE))
        return recorded
    raise StoppedError(
        f"{ATTEMPTS} hits at K = {stiffness:.4g} said nothing about the wall ({recorded.kind}); the effort is zero",
        remedy="rig show the last recording; then the same command goes on",
    )


def _recorded_hit(experiment: Experiment, stiffness: float, session: Session) -> Recording:
    request = HitRequest(
        experiment=experiment,
        url=session.url,
        changes=_changes(experiment, stiffness),
        verified=session.verified,
        output=session.recordings,
    )
    try:
        (result,) = hit(request)
    except RigError as error:
        if error.recording is None:
            raise
        recording = open_recording(error.recording)
        if (ended_early(recording) or (Kind.INVALID,))[0] is not Kind.UNSTABLE:
            raise
        return recording
    return open_recording(result.recording)


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


def _measured(recording: Recording) -> tuple[Measured, Measured | None]:
    """Measure a recording, and its truth if it has one."""
    experiment = experiment_of(recording)
    limits, wall = config.verdict_limits(experiment), experiment.wall
    tick_s, thrown_out = 1.0 / experiment.controller.position_rate, ended_early(recording) is not None
    signals = recorded_signals(recording.rows, tick_s, experiment.rig.encoder.resolution)
    recorded = measured(signals, limits, thrown_out=thrown_out)
    if not recording.has_truth:
        return recorded, None
    true = true_signals(recording.rows, tick_s, wall.position, wall.side)
    return recorded, measured(true, limits, thrown_out=thrown_out)


def _cooling_of(recording: Recording, experiment: Experiment) -> float:
    pushing = recording.rows[recording.rows["phase"] == Phase.TRIAL]
    if not len(pushing):
        return 0.0
    rms = float(np.sqrt(np.mean(np.square(pushing["effort_sent"]))))
    duration_s = len(pushing) / experiment.controller.position_rate
    return cooling_s(rms, experiment.rig.limits.nominal_effort, duration_s)
