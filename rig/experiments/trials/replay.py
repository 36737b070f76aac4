"""Replay a recording: run its law, or another law, with the recorded inputs, and compare the commands.

`rig recording replay`, `rig.experiments.lab`, cuts, the console and plots call this module. It opens no device and must
not change the recording. A replay is open loop: the recorded motion does not change if another law commands another
effort. With the recorded settings a replay is bit-exact, also over gaps, because rows and header contain every input of
`rig.control.step`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.connection import State
from rig import config
from rig.config import controller
from rig.control.laws import Law
from rig.control.step import DONE, ControllerState
from rig.core.errors import LawError, RecordingError
from rig.core.present import Item, Row, reported
from rig.core.sample import COLUMNS, ROW, unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments.trials.judgement import experiment_of
from rig.loop.replay import NO_SETS, replay_rows
from rig.recording.data import Recording
from rig.recording.origin import cut_facts, refuse_counts

# Columns that `rig.control.step` computes, and that a replay computes again; all other columns are copied.
COMPUTED = (
    "phase",
    "position",
    "velocity",
    "estimator_window",
    "penetration",
    "effort_wall",
    "effort_wanted",
    "effort_sent",
    "current_sent",
)


@dataclass(frozen=True, slots=True, repr=False)
class ReplayResult(Shown, Drawn):
    """Result of a replay: recorded and computed samples of the same ticks, and their differences.

    Attributes
    ----------
    of
        Recording that was replayed.
    recorded, rows
        Recorded and replayed samples, one for each tick (`rig.core.sample.ROW`).
    exact
        True if every computed column is equal to the last bit.
    velocity_difference, effort_difference
        Rms difference of velocity (rad/s or m/s) and effort (N·m or N) over all samples.
    """

    of: Recording = field(repr=False)
    recorded: NDArray[np.void] = field(repr=False)
    rows: NDArray[np.void] = field(repr=False)
    estimator: str
    law: str
    exact: bool
    velocity_difference: float
    effort_difference: float

    @reported
    def ticks(self) -> int:
        """Return the number of replayed ticks."""
        return len(self.rows)

    def brief(self) -> list[Item]:
        """Return the lines of a short report: estimator, law, and the differences between replay and recording."""
        velocity, effort = (unit_of(name, self.of.header["motion"]) for name in ("velocity", "effort"))
        return [
            f"{self.of.path or self.of.header['rig']}: {self.ticks} ticks through {self.estimator} and {self.law}",
            Row("equal to the last bit", self.exact),
            Row("velocity differs by", self.velocity_difference, velocity, "rms"),
            Row("effort differs by", self.effort_difference, effort, "rms"),
        ]


def replay(
    recording: Recording, changes: Mapping[str, Any] | None = None, *, law: Law | None = None
) -> ReplayResult:
    """Run recorded counts through the recorded law and estimator, or through changed ones, and compare the outputs.

    Parameters
    ----------
    recording
        Recording with its first row; the recording may be incomplete at the end.
    changes
        Changes of the experiment by dotted key, like ``{"controller.estimator": "fdm"}``. None: the recorded settings.
        If a key of the wall is changed, the wall's changes that were made during the run are ignored.
    law
        Control law to run instead of the law that the recording names.

    Raises
    ------
    RecordingError
        The recording lacks its beginning or ticks in the middle; or the recording is a cut from the middle of a trial,
        and a change or law is given.
    ConfigError
        The changes are invalid, or the law of the recording is not installed here.
    LawError
        The law or the estimator raised an exception.
    """
    recorded = _rows(recording)
    replayed = recorded.copy()
    bundle = _controller(recording, changes, law)
    _run(bundle, recorded, replayed, _parameter_sets(recording, changes, law))
    if len(recorded):
        _clear_last_effort(recorded, replayed)
    return ReplayResult(
        recording,
        recorded,
        replayed,
        bundle.estimator.estimator.name,
        bundle.law.law.name,
        exact=all(replayed[name].tobytes() == recorded[name].tobytes() for name in (*COMPUTED, "flags")),
        velocity_difference=_rms(replayed["velocity"], recorded["velocity"]),
        effort_difference=_rms(replayed["effort_sent"], recorded["effort_sent"]),
    )


def state_before(recording: Recording, row: int) -> dict[str, Any]:
    """Return the controller's state before sample number `row`, computed by a replay of all earlier samples.

    The result has the form of `ControllerState.as_mapping`. Raise `RecordingError` if earlier samples are missing,
    `ConfigError` if the recorded law is not installed, and `LawError` if it raises an exception.
    """
    recorded, bundle = _rows(recording)[:row], _controller(recording, None, None)
    _run(bundle, recorded, recorded.copy(), _parameter_sets(recording, None, None))
    return bundle.as_mapping()


def _run(
    bundle: ControllerState, recorded: NDArray[np.void], replayed: NDArray[np.void], sets: NDArray[np.float64]
) -> None:
    try:
        replay_rows(bundle.arguments(), recorded, replayed, sets)
    except Exception as error:
        raise LawError(
            f"the law or the estimator raised {error!r}",
            remedy="correct the law or the estimator: it must not raise an exception",
        ) from error


def _rows(recording: Recording) -> NDArray[np.void]:
    began = int((cut_facts(recording) or {"first_tick": 0})["first_tick"])
    if len(recording.rows) and recording.rows["tick"][0] != began:
        raise RecordingError(
            f"the recording begins at tick {recording.rows['tick'][0]} instead of {began}: its first block is lost, so "
            "it cannot be replayed",
            remedy="replay another recording of this trial, or record the trial again",
        )
    if not np.array_equal(recording.rows["tick"], began + np.arange(len(recording.rows))):
        raise RecordingError(
            "ticks are missing in the middle of the recording, so it cannot be replayed exactly",
            remedy="replay another recording of this trial, or record the trial again",
        )
    rows = np.zeros(len(recording.rows), dtype=ROW)
    for column in COLUMNS:
        rows[column.name] = recording.rows[column.name]
    return rows


def _parameter_sets(
    recording: Recording, changes: Mapping[str, Any] | None, law: Law | None
) -> NDArray[np.float64]:
    """Return the wall changes during the run, one row each: tick, wall position (rad or m), law parameters.

    Return no row if the replay has another wall or law.
    """
    sets = recording.trailer.get("parameter_sets") or [] if recording.trailer else []
    if law is not None or any(key.startswith("wall.") for key in changes or ()):
        sets = []
    rows = [[one["tick"], one["wall_position"], *one["parameters"]] for one in sets]
    return np.array(rows, dtype=np.float64) if rows else NO_SETS


def _controller(recording: Recording, changes: Mapping[str, Any] | None, law: Law | None) -> ControllerState:
    refuse_counts(recording)
    initial, facts = recording.header["initial_state"], cut_facts(recording)
    if facts is not None and (not initial or (facts["first_tick"] and (changes or law))):
        raise RecordingError(
            "the recording is a cut that begins in the middle of a trial: another law or estimator "
            "would start without the state at this time"
            if initial
            else "the recording is a cut from a recording that cannot be replayed up to that place",
            remedy=f"replay the recording that it was cut from: {facts['recording']}",
        )
    if not changes:
        return ControllerState.from_mapping(initial, law=law)
    experiment = config.override(experiment_of(recording), changes, "replay")
    quantum = recording.header["identity"].get("current_quantum_a")
    reference = initial.get("control", {}).get("reference_count")
    if quantum is None or reference is None:
        raise RecordingError(
            "the recording's header lacks the current quantum or the reference count",
            remedy="record the trial again",
        )
    return controller.for_experiment(
        experiment, current_quantum_a=quantum, reference_count=reference, law=law
    )


def _clear_last_effort(recorded: NDArray[np.void], replayed: NDArray[np.void]) -> None:
    """Set the last replayed effort and current to zero if the loop ended there or the device was faulty."""
    last = recorded[-1]
    faulty = last["fault"] != 0 or last["device_state"] == State.FAULT
    if faulty or replayed["phase"][-1] == DONE:
        replayed["effort_sent"][-1] = 0.0
        replayed["current_sent"][-1] = 0


def _rms(replayed: NDArray[np.float64], recorded: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(replayed - recorded)))) if len(recorded) else 0.0
