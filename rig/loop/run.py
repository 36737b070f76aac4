"""The thread around the compiled loop: start it, watch it, stop it, and say how it ended.

The loop runs off the main thread with all signals blocked, so that Ctrl-C reaches Python and never
interrupts a tick; stopping is one store into the ring, seen within a tick whoever holds the GIL. The thread
is a daemon: if Python dies, it dies too, and the device's watchdog takes the effort to zero.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.codec import STATE
from rig import ring as words
from rig.devices.device import Link
from rig.loop.host import SETTINGS, Buffers, EndReason, run
from rig.ring import Ring
from rig.step import Controller

POLL_S = 0.02
JOIN_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSettings:
    """What the loop needs besides the controller; times in the link's clock."""

    period_ns: int
    session: int
    lifetime_us: int
    lost_after_ns: int
    device_tick_ps: int
    current_quantum_a: float
    wait_for_room: bool

    def as_array(self) -> NDArray[np.void]:
        """Return the length-1 array that the compiled loop reads."""
        array = np.zeros(1, SETTINGS)
        for name in SETTINGS.names or ():
            array[name] = getattr(self, name)
        return array


@dataclass(frozen=True, slots=True)
class LoopEnd:
    """How a loop ended: the reason, an exception of a law or of the simulation, the link's counters."""

    reason: EndReason
    error: BaseException | None
    counters: dict[str, int]


COUNTERS = {
    "ticks": words.TICKS,
    "rows_dropped": words.DROPPED,
    "frames": words.FRAMES,
    "bad_frames": words.BAD_FRAMES,
    "other_frames": words.OTHER_FRAMES,
    "duplicated": words.DUPLICATED,
    "reordered": words.REORDERED,
    "lost": words.LOST,
    "commands": words.COMMANDS,
    "unsent": words.UNSENT,
    "late": words.LATE,
    "errno": words.END_ERRNO,
}


class LoopThread:
    """One run of the loop: `start`, `wait`, `finish`, `end`; `stop` from anywhere, any number of times."""

    def __init__(self, link: Link, controller: Controller, settings: LoopSettings, ring: Ring) -> None:
        self.ring = ring
        self._link = link
        self._controller = controller
        self._settings = settings
        self._error: BaseException | None = None
        self._buffers = Buffers.allocate()
        # Not Thread.join: interrupted by Ctrl-C, it forgets in Python 3.11 that the thread is still running.
        self._started = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._body, name="rig-loop", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._started = True
        self._thread.start()

    def stop(self) -> None:
        """Set the stop word: zero effort within one tick."""
        self.ring.put(words.STOP, 1)

    def wait(self, progress: Callable[[int, int], None] | None = None) -> None:
        """Block until the loop has ended; call `progress(ticks, phase)` a few times a second meanwhile.

        Whatever interrupts this, Ctrl-C or an exception of `progress`, the caller goes on with `finish`.
        """
        while not self._ended.wait(POLL_S):
            if progress is not None:
                progress(self.ring.get(words.TICKS), self.ring.get(words.PHASE))

    def finish(self) -> None:
        """Stop the loop if it still runs, and wait until it has ended. Cannot raise; Ctrl-C again changes nothing."""
        patience = time.monotonic() + JOIN_S
        while self._started and not self._ended.is_set() and time.monotonic() < patience:
            with suppress(KeyboardInterrupt):
                self.stop()
                self._ended.wait(POLL_S)

    def end(self) -> LoopEnd:
        """How the loop ended, once it has."""
        reason = EndReason(self.ring.get(words.END_REASON))
        failure = self._error or self._link.failure()
        counters = {name: self.ring.get(word) for name, word in COUNTERS.items()}
        return LoopEnd(reason, failure, counters)

    def handover(self) -> dict[str, int] | None:
        """Where the streams stand after the loop: arguments of `rig.devices.framed.FramedDevice.take_back`.

        None when it never saw a sample, and so never touched them.
        """
        progress = self._buffers.progress[0]
        if not progress["started"]:
            return None
        return {
            "next_command": int(progress["sequence"]),
            "newest_state": int(progress["answers"]),
            "state": int(self._buffers.state[STATE.state]),
        }

    def _body(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            run(*self._arguments())
        except Exception as error:
            # A law or an estimator of a user raised: the compiled loop is gone without its stop path. The
            # caller sends STOP next; this thread only says what happened.
            self._error = error
            self.ring.put(words.END_REASON, EndReason.LAW_RAISED)
        finally:
            self.ring.put(words.LOOP_DONE, 1)
            self._ended.set()

    def _arguments(self) -> tuple[Any, ...]:
        port = self._link.port()
        buffers = self._buffers
        estimator, law = self._controller.estimator.estimator.update, self._controller.law.law.function
        return (
            *(port.read, port.write, port.wait, port.now, estimator, law, port.handle, port.clock_handle),
            *(self._settings.as_array(), *self._controller.arguments()),
            *(self.ring.words.ctypes.data, self.ring.rows),
            *(
                buffers.received,
                buffers.raw,
                buffers.transmit,
                buffers.header,
                buffers.candidate,
                buffers.state,
            ),
            *(buffers.command, buffers.progress),
        )
