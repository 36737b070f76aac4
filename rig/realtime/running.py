"""Find and stop the loops that run on this computer, from any terminal.

`rig stop`, `rig set`, `rig recording recover`, the console, LSL and sessions use it. It must not load compiled code,
because a command that stops a rig must not take a second. It must not end a process: it writes the stop word and waits
for the loop.
"""

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from rig.core.errors import ConfigError, RigError, RunEndedError
from rig.core.sample import phase_name
from rig.realtime import memories
from rig.realtime.control_words import CREATED, LAYOUT_VERSION, LOOP_DONE, PHASE, STOP, TICKS, VERSION
from rig.realtime.memories import place
from rig.realtime.ring import Ring

PATIENCE_S = 3.0  # how long a stopped loop may take to report its end: it needs a tick
POLL_S = 0.002


@dataclass(frozen=True, slots=True)
class RunningLoop:
    """A loop that runs in real time on this computer, as its shared memory described it when the loop was found.

    Attributes
    ----------
    pid
        Number of the loop's process.
    since
        Time at which the loop's memory was created (s since 1970, like `time.time`).
    ticks, phase
        Steps of the law so far, and name of the phase (`rig.core.sample.phase_name`).
    stopping
        True if a stop was requested.
    done
        True if the loop has returned; its process may still write or complete the recording.
    version
        Layout version of the loop's memory; for another version only `pid`, `stopping` and `done` are known.
    info
        Description of the run: url, recording, experiment.
    path
        Path by which the loop's memory can be opened.
    """

    pid: int
    since: float
    ticks: int
    phase: str
    stopping: bool
    done: bool
    version: int
    info: dict[str, Any] = field(repr=False)
    path: str

    def as_mapping(self) -> dict[str, Any]:
        """Return the facts about this loop as JSON types; from `info` only url and recording are included."""
        return {
            "pid": self.pid,
            "since": self.since,
            "url": self.info.get("url"),
            "recording": self.info.get("recording"),
            "ticks": self.ticks,
            "phase": self.phase,
            "stopping": self.stopping,
            "version": self.version,
        }


@dataclass(frozen=True, slots=True)
class StoppedLoop:
    """A loop that was requested to stop; `ended` is True if the loop has ended within the time that `stop` waited."""

    loop: RunningLoop
    ended: bool

    def as_mapping(self) -> dict[str, Any]:
        """Return the facts about the loop and the flag `ended` as JSON types."""
        return {**self.loop.as_mapping(), "ended": self.ended}


def running(*, done: bool = False) -> list[RunningLoop]:
    """Return this user's running loops, oldest first; with `done` also ended ones whose recording is still written."""
    loops = []
    for memory in memories.memories():
        with memory, suppress(OSError, RigError), Ring.attach(memory.held) as ring:
            loops.append(_describe_loop(memory, ring))
    return sorted((loop for loop in loops if done or not loop.done), key=lambda loop: loop.since)


def stop(
    pid: int | None = None, *, asked: list[memories.LoopMemory] | None = None, patience_s: float = PATIENCE_S
) -> list[StoppedLoop]:
    """Stop the running loops of a process, or all running loops of this user, and wait until they have ended.

    Each loop sets its effort to zero within one tick. Return the loops that were running. Raise `ConfigError` if the
    process `pid` runs no loop, or belongs to another user.

    Parameters
    ----------
    pid
        Number of the process; None for all.
    asked
        Loops that were requested to stop before, by `rig.realtime.memories.ask_to_stop`; `stop` closes their memories.
    patience_s
        Longest wait for the loops to end (s).
    """
    with ExitStack() as stack:
        found: list[tuple[RunningLoop, Ring]] = []
        # Before anything that takes time: a tick lasts 50 µs at 20 kHz.
        for memory in memories.ask_to_stop(pid) if asked is None else asked:
            stack.enter_context(memory)
            if memory.ran:  # it may have ended in the meantime
                with suppress(OSError, RigError):
                    ring = stack.enter_context(Ring.attach(memory.held))
                    found.append((_describe_loop(memory, ring), ring))
        if pid is not None and not found:
            raise _no_loop_error(pid)
        _wait_until_ended([ring for _, ring in found], patience_s)
        return [
            StoppedLoop(loop, bool(ring.peek(LOOP_DONE)) or not place.is_memory(loop.path))
            for loop, ring in found
        ]


def memory_of(pid: int) -> Ring | None:
    """Return the memory of the newest running loop of a process, read-only; None if the process runs no loop.

    The caller must close the memory. The description of the run (experiment, recording) is not read, because a caller
    that may show the progress may not always show the description.
    """
    newest: Ring | None = None
    for memory in memories.memories(pid):
        with memory, suppress(OSError, RigError):
            ring = Ring.attach(memory.held, writable=False)
            if ring.peek(VERSION) != LAYOUT_VERSION or ring.peek(LOOP_DONE):
                ring.close()
            elif newest is None or newest.peek(CREATED) < ring.peek(CREATED):
                if newest is not None:
                    newest.close()
                newest = ring
            else:
                ring.close()
    return newest


def ask_to_stop(pid: int) -> int:
    """Request the running loops of a process to stop, without waiting; return the number of these loops."""
    asked = 0
    for memory in memories.ask_to_stop(pid):
        with memory:
            asked += memory.ran
    return asked


def hidden() -> list[int]:
    """Return the numbers of ``rig`` processes of other users whose open files are not readable: they may run a loop."""
    return sorted(pid for pid, words in place.command_lines() if _is_rig(words))


def _is_rig(words: list[bytes]) -> bool:
    """Return True if the words of a command line begin with ``rig``, ``python …/rig`` or contain ``-m rig``."""
    started = [os.path.basename(word) for word in words[:2]]
    return b"rig" in started or any(pair == (b"-m", b"rig") for pair in pairwise(words))


def the_loop(pid: int | None = None) -> RunningLoop:
    """Return the only running loop (of process `pid`, if given); raise `ConfigError` if none or several run."""
    loops = [loop for loop in running() if pid is None or loop.pid == pid]
    if len(loops) == 1:
        return loops[0]
    if loops:
        names = ", ".join(str(loop.pid) for loop in loops)
        raise ConfigError(
            f"{len(loops)} loops run on this computer, in the processes {names}",
            remedy="choose one by its process number (`pid`)",
        )
    if pid is not None:
        raise _no_loop_error(pid)
    raise ConfigError("no loop runs in real time on this computer", remedy="start a loop: rig hit --realtime")


@contextmanager
def open_loop(loop: RunningLoop) -> Iterator[Ring]:
    """Open the shared memory of a running loop within this context.

    Raise `RunEndedError` if the loop has ended since it was found, and `RigError` if the loop was started by a version
    of this package with another memory layout.
    """
    if loop.version != LAYOUT_VERSION:
        raise RigError(
            f"process {loop.pid} was started by another version of haptic-rig: its shared memory has layout "
            f"{loop.version}, this version needs {LAYOUT_VERSION}",
            remedy="use the version that started the process; only `rig stop` works with all versions",
        )
    try:
        ring = Ring.attach(loop.path)
    except (OSError, RigError) as error:
        raise RunEndedError(
            f"the loop of process {loop.pid} has ended", remedy="start another run"
        ) from error
    with ring:
        yield ring


def _describe_loop(memory: memories.LoopMemory, ring: Ring) -> RunningLoop:
    version = ring.peek(VERSION)
    # In other layouts only STOP and LOOP_DONE have the same index.
    layout_known = version == LAYOUT_VERSION
    phase = ring.peek(PHASE) if layout_known else -1
    return RunningLoop(
        pid=memory.pid,
        since=ring.peek(CREATED) * 1e-9 if layout_known else 0.0,
        ticks=ring.peek(TICKS) if layout_known else 0,
        phase=phase_name(phase),
        stopping=ring.peek(STOP) != 0,
        done=ring.peek(LOOP_DONE) != 0,
        version=version,
        info=ring.info,
        path=memory.path,
    )


def _wait_until_ended(rings: list[Ring], patience_s: float) -> None:
    deadline = time.monotonic() + patience_s
    while not all(ring.peek(LOOP_DONE) for ring in rings) and time.monotonic() < deadline:
        time.sleep(POLL_S)


def _no_loop_error(pid: int) -> ConfigError:
    try:
        if not place.may_look(pid):
            return ConfigError(
                f"process {pid} belongs to another user",
                remedy=f"run the command as its owner, or: sudo rig stop {pid}",
            )
    except ProcessLookupError:
        return ConfigError(f"there is no process {pid}", remedy="list the running loops by rig stop --list")
    return ConfigError(
        f"process {pid} runs no loop in real time", remedy="list the running loops by rig stop --list"
    )
