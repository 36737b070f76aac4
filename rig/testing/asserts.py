"""Asserts about recordings, and about hits: runs in which the handle hits a virtual wall. Messages name tick and unit.

Each assert accepts the result of a hit (`rig.testing.Hit`, `rig.experiments.hits.hit.HitResult`) or a recording. Tests
of a lab call them. An assert must not change its recording.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.config import Experiment, experiment_from_mapping
from rig.core.present import duration, written
from rig.core.sample import Phase, phase_name
from rig.experiments.trials.judgement import Judgement, judge
from rig.recording.data import Recording

# Age of the newest command if no command has arrived (PROTOCOL.md, STATE).
NEVER = 0xFFFF
Subject = Any  # a Hit, a HitResult, a Recorded, or a Recording


def assert_stable(subject: Subject) -> None:
    """Assert that the contact with the wall was stable; a failure's message has all judged numbers and thresholds."""
    __tracebackhide__ = True
    recording = recording_of(subject)
    experiment = _experiment_of(recording)
    found = _judgement_of(subject) or judge(recording, experiment)
    if found.verdict.kind != "stable":
        rows = found.rows(experiment)
        width = max(len(row.label) for row in rows)
        lines = "\n".join(f"  {row.label:<{width}}  {row.text}" for row in rows)
        raise AssertionError(f"the hit is {found.verdict.kind}, not stable\n{lines}\n{_path_line(recording)}")


def assert_safe(subject: Subject, *, within_ms: float) -> None:
    """Assert that the effort is zero at most `within_ms` (ms) after any end of a run, and that the end has a reason.

    In the recording the effort must be zero `within_ms` after the device latched a fault, and when the newest command
    is older than `within_ms`. For the hit of a test, the device must also reach zero within that time after the host's
    last frame, and disarm; on a real rig, its State messages show this. `within_ms` includes the lifetime of a command
    (five ticks, at least 3 ms, at most 20 ms) and the following ramp (at most 10 ms, PROTOCOL.md): together 13 ms at 20
    kHz and 15 ms at 1 kHz. So 20 ms suffice at both rates; the largest possible time is 30 ms.
    """
    __tracebackhide__ = True
    if getattr(subject, "recorded", subject) is not None:
        recording = recording_of(subject)
        if not recording.complete or recording.trailer is None:
            raise AssertionError(
                f"not safe: the recording is incomplete and gives no reason for its end\n{_path_line(recording)}"
            )
        _check_rows(recording, within_ms)
    if not hasattr(subject, "rest"):
        return
    rest = subject.rest
    if rest is None:
        raise AssertionError("not safe: the device sends no more data, so its effort is unknown")
    if rest.zero_after_s is None or rest.zero_after_s * 1e3 > within_ms:
        after = (
            "was never zero" if rest.zero_after_s is None else f"was zero {rest.zero_after_s * 1e3:.4g} ms"
        )
        raise AssertionError(
            f"not safe: the effort {after} after the host's last command; it must be zero within {within_ms:g} ms"
        )
    if rest.armed:
        raise AssertionError("not safe: the device stayed armed without a host; it must disarm")
    if subject.error is not None and not subject.error.remedy:
        raise AssertionError(
            f"the run ended with an error that does not say what to do (its remedy is empty): {subject.error}"
        )


def assert_limit(subject: Subject, **most: float) -> None:
    """Assert that recorded values stay within limits: ``assert_limit(hit, velocity=2.0, effort_sent=0.1)``.

    Each argument is the name of a recorded column, with the largest allowed magnitude in the column's unit. Without
    arguments, effort and speed must stay within the experiment's ``[rig.limits]``.
    """
    __tracebackhide__ = True
    recording = recording_of(subject)
    if not most:
        limits = _experiment_of(recording).rig.limits
        most = {"effort_applied": limits.effort, "velocity": limits.speed}
    problems = [text for name, bound in most.items() if (text := _describe_excess(recording, name, bound))]
    if problems:
        raise AssertionError("\n".join([*problems, _path_line(recording)]))


def assert_passive(subject: Subject) -> None:
    """Assert that the wall gave the handle no energy, by a passivity observer after Hannaford and Ryu 2002.

    The energy of a contact is the sum of the wall's active effort times the travel during it; energy that one contact
    dissipated does not count for the next (`rig.control._watch`). Each position is known to half a count, so the sum is
    known to half a count times the total variation of the effort; only energy beyond that fails the assert.
    """
    __tracebackhide__ = True
    recording = recording_of(subject)
    rows = recording.rows[np.isin(recording.rows["phase"], (Phase.TRIAL, Phase.RELEASE))]
    if len(rows) < 2:
        raise AssertionError(
            f"passivity cannot be observed: the recording has no rows of a trial\n{_path_line(recording)}"
        )
    excess = _energy_given(rows, _experiment_of(recording), recording.header["identity"]["current_quantum_a"])
    worst = int(excess.argmax())
    if excess[worst] > 0.0:
        raise AssertionError(
            f"the wall gave {written(float(excess[worst]))} J more than reading errors explain, "
            f"{_describe_row(recording, rows, worst)}\n{_path_line(recording)}"
        )


def _energy_given(rows: NDArray[np.void], x: Experiment, current_quantum_a: float) -> NDArray[np.float64]:
    """Return for each row a lower bound of the energy (J) that the wall has given to the handle (< 0: dissipated)."""
    count, quantum = x.rig.encoder.resolution, current_quantum_a * x.rig.amplifier.effort_per_ampere
    push = rows["effort_wanted"] + x.wall.side * rows["effort_wall"]
    reaction, free = np.zeros(len(rows)), np.ones(len(rows), bool)
    reaction[1:] = rows["effort_applied"][1:] - push[:-1]
    free[1:] = rows["penetration"][:-1] <= 0.0
    # In free space only the rounding of the push to whole quanta remains, which is not a reaction of the wall.
    reaction[free & (np.abs(reaction) <= quantum)] = 0.0
    travel = np.diff(rows["position"], prepend=rows["position"][0])
    unknown = 0.5 * count * np.abs(np.diff(reaction, prepend=0.0))
    excess, given, known = np.zeros(len(rows)), 0.0, 0.0
    for row, (force, way, error) in enumerate(
        zip(reaction.tolist(), travel.tolist(), unknown.tolist(), strict=True)
    ):
        given, known = given + force * way, known + error
        excess[row] = given - known - 0.5 * count * abs(force)
        if free[row] and given < 0.0:
            given = known = 0.0
    return excess


def recording_of(subject: Subject) -> Recording:
    """Return the recording of a run on a wall (result of `rig_hit`); if the argument is a recording, return it."""
    recorded = getattr(subject, "recorded", subject)
    recording = getattr(recorded, "recording", recorded)
    if not isinstance(recording, Recording):
        raise TypeError(
            f"{subject!r} is neither a hit nor a recording; give the result of rig_hit, or a Recording"
        )
    return recording


def _judgement_of(subject: Subject) -> Judgement | None:
    found: Judgement | None = getattr(getattr(subject, "recorded", subject), "judgement", None)
    return found


def _experiment_of(recording: Recording) -> Experiment:
    return experiment_from_mapping(recording.experiment, "the recording")


def _check_rows(recording: Recording, within_ms: float) -> None:
    rows = recording.rows
    faulty = rows["fault"] != 0
    if faulty.any():
        since_ns = rows["device_time"] - rows["device_time"][faulty.argmax()]
        _check_zero_effort(recording, since_ns, "the device latched a fault", within_ms)
    period_ns = round(1e9 / _experiment_of(recording).controller.position_rate)
    age_ns = np.where(rows["command_age"] == NEVER, 0, rows["command_age"] * period_ns)
    _check_zero_effort(recording, age_ns, "the newest command", within_ms)


def _check_zero_effort(
    recording: Recording, since_ns: NDArray[np.int64], what: str, within_ms: float
) -> None:
    """Raise `AssertionError` if an effort is active more than `within_ms` (ms) after an event.

    `since_ns` is the time since the event in each row (ns), and `what` names the event in the message.
    """
    wrong = (recording.rows["effort_applied"] != 0.0) & (since_ns > within_ms * 1e6)
    if wrong.any():
        row = int(wrong.argmax())
        raise AssertionError(
            f"not safe: effort_applied was {_value(recording, 'effort_applied', row)} {duration(int(since_ns[row]))} "
            f"after {what}, {_describe_row(recording, recording.rows, row)}; zero is due within {within_ms:g} ms\n"
            f"{_path_line(recording)}"
        )


def _describe_excess(recording: Recording, name: str, bound: float) -> str:
    values = np.abs(recording.column(name))
    # Not `values > bound`: NaN exceeds every bound, too.
    wrong = ~(values <= bound)
    if not wrong.any():
        return ""
    first, worst = int(wrong.argmax()), int(np.nan_to_num(values, nan=np.inf).argmax())
    return (
        f"{name} exceeds {bound:g} {recording.units[name]} in {np.count_nonzero(wrong)} of {len(values)} rows: first "
        f"{_value(recording, name, first)}, {_describe_row(recording, recording.rows, first)}; "
        f"most {_value(recording, name, worst)}, {_describe_row(recording, recording.rows, worst)}"
    )


def _value(recording: Recording, name: str, row: int) -> str:
    return f"{written(recording.rows[name][row].item(), 6)} {recording.units[name]}"


def _describe_row(recording: Recording, rows: NDArray[np.void], row: int) -> str:
    passed_ns = int(rows["device_time"][row] - recording.rows["device_time"][0])
    return f"in tick {rows['tick'][row]} ({duration(passed_ns)}, {phase_name(int(rows['phase'][row]))})"


def _path_line(recording: Recording) -> str:
    return f"recording: {recording.path}"
