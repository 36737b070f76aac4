"""Read the sessions of a study from disk, and check that they belong together and are complete.

A session is read from its log. Sessions that cannot be one study are refused (another criterion, a rehearsal among real
sessions, a participant twice), unless the difference is allowed by `across`. Other differences are messages for the
reader (an unfinished session, another version of the software, a missing recording).
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

from rig.core.errors import ConfigError, RecordingError
from rig.core.regular_file import open_regular
from rig.core.sample import unit_of
from rig.recording.files import plain_errors
from rig.session.finished import (
    Difference,
    Event,
    Protocol,
    RecordedTrial,
    SessionState,
    device_words,
    is_within,
    list_names,
    place_differences,
    protocol_differences,
    read,
    settings_of,
)

LOG = "session.log"
PROTOCOL = "protocol.toml"

Watch = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class StudySession:
    """One participant's session, read from its directory.

    Attributes
    ----------
    directory, events
        Directory of the session, and the events of its log.
    state
        State of the session after all events, which decides which trials count.
    began
        Content of the log's first event.
    recordings
        State of each trial's recording file, by trial number: "ok", "missing" (no file), "changed", or "not checked".
    amended
        Numbers of the trials whose verdict was amended.
    """

    directory: Path
    events: Sequence[Event]
    state: SessionState
    began: Mapping[str, Any]
    recordings: Mapping[int, str]
    amended: frozenset[int]

    @property
    def code(self) -> str:
        """Code of the session's participant."""
        return self.state.code

    @property
    def complete(self) -> bool:
        """True if the session was completed as planned."""
        return self.state.ended == "complete"

    @property
    def began_at(self) -> float:
        """Time at which the session began (s since 1970)."""
        return self.events[0].at

    def of_kind(self, kind: str) -> list[Event]:
        """Return the events of one kind, in the order of the log."""
        return [event for event in self.events if event.kind == kind]

    def devices(self) -> dict[int, Mapping[str, Any]]:
        """Return, by trial number, the content of the log's last event "opened" (a rig was opened) before the trial."""
        found: dict[int, Mapping[str, Any]] = {}
        opened: Mapping[str, Any] | None = None
        for event in self.events:
            if event.kind == "opened":
                opened = event.content
            elif event.kind == "trial" and opened is not None:
                found[event.content["trial"]] = opened
        return found


@dataclass(frozen=True, kw_only=True)
class Study:
    """Sessions under one protocol, sorted by row of the plan (order of conditions), with messages for the reader."""

    sessions: tuple[StudySession, ...]
    messages: tuple[str, ...] = field(default=())
    differences: tuple[Difference, ...] = ()  # of their protocols

    @property
    def protocol(self) -> Protocol:
        """Protocol of the first session; the other sessions' protocols deviate only by `differences`."""
        return self.sessions[0].state.protocol

    @property
    def motion(self) -> Any:
        """The rig's motion: "rotary" or "linear"."""
        return self.sessions[0].state.experiment["rig"]["motion"]

    @property
    def rehearsed(self) -> bool:
        """True if the participants were simulated."""
        return self.sessions[0].state.rehearsal is not None

    def unit(self, quantity: str) -> str:
        """Return the SI unit of a quantity, such as "stiffness", for the rig's motion."""
        return unit_of(quantity, self.motion)


def read_study(
    paths: str | Path | Iterable[str | Path],
    *,
    hashes: bool = True,
    across: Sequence[str] = (),
    watch: Watch | None = None,
) -> Study:
    """Read the sessions of a study, sorted by row of the plan (order of conditions).

    Parameters
    ----------
    paths
        Directories of sessions, of studies (whose sessions lie directly in them), or logs.
    hashes
        Compare the recordings with the hashes in the logs.
    across
        Keys of the protocol, or sections of keys, in which sessions may differ although the keys can affect a result.
    watch
        Called with the number of sessions read, and the total.

    Raises
    ------
    RecordingError
        A path contains no session, or a log is damaged.
    ConfigError
        The sessions are not of one study.
    """
    found = find_sessions(map(Path, [paths] if isinstance(paths, str | Path) else paths))
    sessions = []
    for number, directory in enumerate(found):
        if watch is not None:
            watch(number, len(found))
        sessions.append(read_session(directory, hashes=hashes))
    if watch is not None:
        watch(len(found), len(found))
    sessions, empty = _with_trials(sessions)
    _refuse(sessions)
    sessions.sort(key=lambda one: (one.state.row, one.code))
    differences = _protocol_differences(sessions, across)
    return Study(
        sessions=tuple(sessions),
        messages=(*empty, *_describe_differences(differences), *_messages(sessions)),
        differences=tuple(differences),
    )


def _with_trials(sessions: list[StudySession]) -> tuple[list[StudySession], list[str]]:
    """Return the sessions with trials, and a message about sessions without trials; all sessions if none has any."""
    empty = [session for session in sessions if not session.state.trials]
    if not empty or len(empty) == len(sessions):
        return sessions, []
    message = f"ignored sessions without a trial: {list_names([str(session.directory) for session in empty])}"
    return [session for session in sessions if session.state.trials], [message]


def find_sessions(paths: Iterable[Path]) -> list[Path]:
    """Return the directories of the sessions in or at `paths`, each once; raise `RecordingError` if a path has none."""
    found: dict[Path, Path] = {}
    for path in paths:
        with plain_errors("read", path):
            here = [path.parent] if path.name == LOG and path.is_file() else []
            if path.is_dir():
                here = (
                    [path] if (path / LOG).is_file() else sorted(log.parent for log in path.glob(f"*/{LOG}"))
                )
        if not here:
            raise RecordingError(
                f"no session found in {path}",
                remedy=f"give the directory of a study or of a participant, which contains {LOG}",
            )
        found |= {one.resolve(): one for one in here}
    return list(found.values())


def read_session(directory: Path, *, hashes: bool = True) -> StudySession:
    """Read the directory of one session; raise `RigError` if it contains no session or a damaged log."""
    path = directory / LOG
    events = read(path)
    try:
        state = SessionState.of(events)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(
            f"{path}: an event of the log lacks data that this version needs ({type(error).__name__}: {error})",
            remedy="analyse it with the version of haptic-rig that wrote it; the log's first event contains it",
        ) from error
    except RecordingError as error:
        raise RecordingError(f"cannot read the log {path}: {error.message}", remedy=error.remedy) from error
    return StudySession(
        directory=directory,
        events=events,
        state=state,
        began=events[0].content,
        recordings={
            trial.trial: _recording(directory, trial, hashes) for trial in state.trials if trial.recording
        },
        amended=_find_amended(events),
    )


def _recording(directory: Path, trial: RecordedTrial, hashes: bool) -> str:
    path = directory / trial.recording
    if not path.is_file():
        return "missing"
    if not hashes or not trial.sha256:
        return "not checked"
    with plain_errors("read", path), open_regular(path) as file:
        return "ok" if hashlib.file_digest(file, "sha256").hexdigest() == trial.sha256 else "changed"


def _find_amended(events: Sequence[Event]) -> frozenset[int]:
    numbers = {event.content["number"] for event in events if event.kind == "amended"}
    return frozenset(
        event.content["trial"] for event in events if event.kind == "judged" and event.number in numbers
    )


def _refuse(sessions: Sequence[StudySession]) -> None:
    by_code: dict[str, StudySession] = {}
    for session in sessions:
        other = by_code.setdefault(session.code, session)
        if other is not session:
            raise ConfigError(
                f"participant {session.code} has two sessions: {other.directory} and {session.directory}",
                remedy="give only one of these directories",
            )
    rehearsed = [session.code for session in sessions if session.state.rehearsal is not None]
    if 0 < len(rehearsed) < len(sessions):
        raise ConfigError(
            f"{list_names(rehearsed)}: rehearsals with a simulated person cannot be analysed together with people",
            remedy="analyse rehearsals separately",
        )


def _protocol_differences(sessions: Sequence[StudySession], across: Sequence[str]) -> list[Difference]:
    differ = protocol_differences(
        {one.code: settings_of(one.state.protocol, one.state.experiment) for one in sessions}
    )
    cells = [one for one in differ if _decides_cells(one)]
    if cells:
        raise ConfigError(
            f"the sessions compare different things: they differ in {'; '.join(one.sentence for one in cells)}",
            remedy="analyse them as separate studies",
        )
    unstated = [one for one in differ if not one.is_neutral and not is_within(one.key, across)]
    if unstated:
        keys = " ".join(f"`across` {one.key}" for one in unstated)
        raise ConfigError(
            f"the protocols of the sessions differ: {'; '.join(one.sentence for one in unstated)}",
            remedy=f"analyse them as separate studies, or allow these differences: {keys}",
        )
    return differ


def _decides_cells(one: Difference) -> bool:
    """Return True if sessions with this difference cannot be compared: other conditions, dampings or motion."""
    if one.key == "condition":
        # The order of the conditions does not matter.
        return len({frozenset(names) for names in one.values.values()}) > 1
    if one.key.startswith("condition.") and ".changes." not in one.key:
        return one.key.endswith(".damping")
    return one.key == "experiment.rig.motion"


def _describe_differences(differ: Sequence[Difference]) -> list[str]:
    stated = [
        f"analysed together despite a difference in {one.sentence}" for one in differ if not one.is_neutral
    ]
    neutral = [one.key for one in differ if one.is_neutral]
    if neutral:
        stated.append(f"sessions differ in settings that do not affect results: {list_names(neutral)}")
    return stated


def _messages(sessions: Sequence[StudySession]) -> list[str]:
    messages: list[str] = []
    for session in sessions:
        messages += _describe_session(session)
    for one, other in combinations(sessions, 2):
        if one.state.row == other.state.row:
            messages.append(
                f"{one.code} and {other.code} both have row {one.state.row} of the plan, so the order of conditions is "
                "not balanced"
            )
    for what, values in _collect_facts(sessions).items():
        if len(set(values.values())) > 1:
            each = "; ".join(
                f"{value}: {list_names([code for code, theirs in values.items() if theirs == value])}"
                for value in dict.fromkeys(values.values())
            )
            messages.append(f"sessions differ in {what} ({each})")
    return messages


def _describe_session(session: StudySession) -> list[str]:
    messages = []
    code, state = session.code, session.state
    if state.ended is None:
        messages.append(f"{code}: the session is not complete")
    elif not session.complete:
        messages.append(f"{code}: the session was ended early: {state.ended}")
    for fault in ("missing", "changed"):
        trials = [trial for trial, found in session.recordings.items() if found == fault]
        if trials:
            which = _trials([str(trial) for trial in trials])
            count = "1 recording is" if len(trials) == 1 else f"{len(trials)} recordings are"
            messages.append(f"{code}: {count} {fault} ({which}); the verdicts in the log are used")
    messages += [f"{code}: {text}" for text in _changed_between(session)]
    path, digest = session.directory / PROTOCOL, session.began.get("protocol_sha256")
    if digest and path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        messages.append(
            f"{code}: {PROTOCOL} has changed since the session began; the protocol in the log is used"
        )
    return messages


def _changed_between(session: StudySession) -> Iterator[str]:
    used: list[tuple[Mapping[str, Any], list[str]]] = []
    for trial, opened in session.devices().items():
        if not used or used[-1][0] is not opened:
            used.append((opened, []))
        used[-1][1].append(str(trial))
    if not used:
        return
    simulated = [trial for one, trials in used if one.get("simulated") for trial in trials]
    if simulated and any(one.get("simulated") is False for one, _ in used):
        yield f"the session mixes a real rig with a simulated one ({_trials(simulated)}): its limits hold for neither"
    elif any(place_differences(used[0][0], one) for one, _ in used[1:]):
        devices = dict.fromkeys(device_words(one) for one, _ in used)
        yield f"the session took place on more than one device: {' and '.join(devices)}"
    for (one, _), (other, trials) in pairwise(used):
        changed = [
            name for name in ("firmware", "dictionary") if _has_changed(one.get(name), other.get(name))
        ]
        before, after = one.get("versions") or {}, other.get("versions") or {}
        changed += [name for name in before if _has_changed(before[name], after.get(name))]
        if changed:
            yield f"from trial {trials[0]} on, {' and '.join(changed)} changed"


def _has_changed(one: Any, other: Any) -> bool:
    return one is not None and other is not None and one != other


def _trials(numbers: Sequence[str]) -> str:
    return f"trial{'s' if len(numbers) > 1 else ''} {list_names(numbers)}"


def _collect_facts(sessions: Sequence[StudySession]) -> dict[str, dict[str, str]]:
    """Return facts that should be equal in all sessions: text of the fact, then its value by participant."""

    def version(session: StudySession, name: str) -> str:
        return str((session.began.get("versions") or {}).get(name, "unknown"))

    def devices(session: StudySession) -> str:
        opened = [event.content for event in session.of_kind("opened")]
        return " and ".join(dict.fromkeys(str(one.get("device", "unknown")) for one in opened)) or "unknown"

    return {
        "the version of haptic-rig": {one.code: version(one, "haptic-rig") for one in sessions},
        "its sources": {one.code: version(one, "sources") for one in sessions},
        "the seed of the order": {one.code: str(one.state.seed) for one in sessions},
        "the device": {one.code: devices(one) for one in sessions},
    }
