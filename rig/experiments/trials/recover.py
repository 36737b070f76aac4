"""After a crash, find captures (files that a run writes) that were not sealed, and seal (compress, check) them.

`rig recording recover` calls this module. A capture that another process has locked, or to which a running loop writes,
is not changed. This module must not remove a capture: `rig.recording.seal` does so after a comparison with the sealed
file.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from rig.core import locks
from rig.core.errors import ConfigError, RecordingError, RigError
from rig.realtime import running
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.recording.recorder import AT_RISK_S
from rig.recording.seal import SEALED_SUFFIX, SUFFIX, seal

SEALING_S = 5.0  # a run that ended normally seals its recording within this time (s)

Progress = Callable[[int, int, Path], None]  # number of finished captures, number of captures, next capture


class CaptureState(StrEnum):
    """A state of a capture (file that a run writes) after recovery."""

    SEALED = "sealed"
    IN_USE = "in use"  # another process writes or seals it
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Recovered:
    """Result of the recovery of one capture (file that a run writes), with the number of samples lost in the crash.

    Attributes
    ----------
    capture
        Path of the capture.
    outcome
        State of the capture after recovery.
    recording
        Path of the sealed (compressed, checked) file; None if the capture was not sealed.
    rows
        Number of samples that were read.
    rows_lost
        Number of samples that are lost because the middle of the file is damaged.
    duration_s
        Duration of the samples that were read (s).
    lost_at_most_s
        Upper bound of the run's time that is missing from the recording (s); None if unknown, as in virtual time, where
        the simulation can be run again.
    complete
        True if the file was written to its end, so that no sample is missing at the end.
    reason
        Reason why the capture was not sealed, with a remedy; empty if the capture was sealed.
    """

    capture: Path
    outcome: CaptureState
    recording: Path | None = None
    rows: int = 0
    rows_lost: int = 0
    duration_s: float = 0.0
    lost_at_most_s: float | None = 0.0
    complete: bool = False
    reason: str = ""


def unsealed(paths: Iterable[str | Path]) -> list[Path]:
    """Return the captures (files that a run writes) that are not sealed (compressed and checked) yet.

    A path of a file is returned unchanged; a directory is searched, with all directories below, for captures without a
    sealed file beside them.

    Raises
    ------
    ConfigError
        A path does not exist.
    """
    found: dict[Path, None] = {}
    for path in map(Path, paths):
        if path.is_dir():
            inside = sorted(path.rglob(f"*{SUFFIX}"))
            found |= dict.fromkeys(p for p in inside if not p.with_suffix(SEALED_SUFFIX).exists())
        elif path.exists():
            found[path] = None
        else:
            raise ConfigError(
                f"{path} does not exist",
                remedy="give the path of a capture or of a directory with recordings",
            )
    return list(found)


def recover(paths: Iterable[str | Path], *, progress: Progress | None = None) -> list[Recovered]:
    """Seal (compress and check) the captures (files that a run writes) at `paths`; return one result for each capture.

    `paths` are files, or directories to search. `progress` is called before each capture with the number of finished
    captures, the number of all captures, and the path. A capture that cannot be sealed is not changed.

    Raises
    ------
    ConfigError
        A path does not exist.
    """
    captures = unsealed(paths)
    results = []
    for done, capture in enumerate(captures):
        if progress is not None:
            progress(done, len(captures), capture)
        results.append(_recover(capture))
    return results


def _recover(capture: Path) -> Recovered:
    try:
        with _lock(capture) as alone:
            user = None if alone else "another process is writing it"
            user = user or _name_user(capture)
            if user is not None:
                return Recovered(
                    capture, CaptureState.IN_USE, reason=f"{user}; recover it when that process has ended"
                )
            recording = open_recording(capture)
            fresh = recording.complete and time.time() - capture.stat().st_mtime < SEALING_S
            if fresh:
                reason = (
                    "the recording has just ended and its run may still be sealing it; try again in "
                    f"{SEALING_S:g} s"
                )
                return Recovered(capture, CaptureState.IN_USE, reason=reason)
            sealed = seal(recording).path or capture
            _remove_drafts(sealed)
            return _make_result(capture, sealed, recording)
    except OSError as error:
        return Recovered(capture, CaptureState.FAILED, reason=f"cannot read it: {error.strerror}")
    except RigError as error:
        return Recovered(capture, CaptureState.FAILED, reason=str(error))


def _remove_drafts(sealed: Path) -> None:
    """Remove the temporary files (`rig.recording.files.whole_file`) of a sealing process that was killed."""
    for path in sealed.parent.iterdir():
        if path.name.startswith(f".{sealed.name}.") and path.name.endswith(".draft"):
            path.unlink(missing_ok=True)


def _make_result(capture: Path, sealed: Path, recording: Recording) -> Recovered:
    """Return the result of recovering `capture` as the file `sealed`, with the time that may be lost.

    Both are the same path if the capture could only be read, because pyarrow is missing.
    """
    tick_s = _tick_s(recording)
    missing = sum(loss.rows or 0 for loss in recording.lost)
    at_risk_s: float | None = missing * tick_s
    if not recording.complete:
        virtual = (recording.header.get("clocks") or {}).get("kind") == "virtual"
        at_risk_s = None if virtual else missing * tick_s + AT_RISK_S
    done = sealed != capture
    return Recovered(
        capture=capture,
        outcome=CaptureState.SEALED if done else CaptureState.FAILED,
        recording=sealed if done else None,
        rows=len(recording),
        rows_lost=missing,
        duration_s=len(recording) * tick_s,
        lost_at_most_s=at_risk_s,
        complete=recording.complete,
        reason="" if done else "sealing needs pyarrow; the capture can be read as it is",
    )


def _tick_s(recording: Recording) -> float:
    """Return the period of the loop (s); 0 if the recording's header contains no rate."""
    rate = ((recording.experiment.get("controller") or {}).get("position_rate")) or 0
    return 1.0 / rate if rate > 0 else 0.0


@contextmanager
def _lock(capture: Path) -> Iterator[bool]:
    """Lock the file of a run; yield False if another process has the lock. Raise `OSError` if the file is missing."""
    descriptor = os.open(capture, os.O_RDONLY)
    try:
        ours = True
        with suppress(OSError):  # without locks in the file system only the check of running loops protects
            ours = locks.lock(descriptor)
        yield ours
    finally:
        os.close(descriptor)


def _name_user(capture: Path) -> str | None:
    """Return a sentence on the process that still writes this recording; None without one."""
    for loop in running.running(done=True):
        named = loop.info.get("recording")
        if not isinstance(named, str):
            continue
        with suppress(OSError):
            if Path(named).samefile(capture):
                return f"process {loop.pid} is writing it"
    return None


def failed(results: Iterable[Recovered]) -> RecordingError | None:
    """Return an error that lists recordings that could not be recovered; None if all were recovered or in use."""
    broken = [result for result in results if result.outcome == CaptureState.FAILED]
    if not broken:
        return None
    names = ", ".join(str(result.capture) for result in broken)
    return RecordingError(
        f"some captures were not recovered: {names}",
        remedy="see the reasons above; the captures are unchanged",
    )
