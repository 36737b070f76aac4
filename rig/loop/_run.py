"""Thread that runs the compiled loop: start, supervise and stop it, and report its end.

Trials and motions start it. To stop the loop, any process or thread writes one control word of the ring, which the loop
reads within a tick, whichever thread has the GIL. The main thread must stay free for Ctrl-C. This file must not send
or receive on the link while the loop runs.
"""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import Fault, Input
from rig.control import current
from rig.control.step import ControllerState
from rig.core.current_sensor import CurrentSensor
from rig.devices.device import Link
from rig.loop import _host as host
from rig.loop._contradictions import Contradiction
from rig.loop.layout import EXCHANGES_KEPT, SETTINGS, Buffers, EndReason, SharedRing
from rig.realtime import control_words, stop_requests
from rig.realtime.atomics import read_word
from rig.realtime.codec import STATE
from rig.realtime.handlers import take_no_signals
from rig.realtime.kernel import prepare
from rig.realtime.mailbox import SET_FLOATS
from rig.realtime.ring import Ring
from rig.realtime.scheduling import Realtime

POLL_S = 0.02
JOIN_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSettings:
    """Settings of the loop besides the controller: timing, session, limit switch, stop requests, law on the device."""

    period_ns: int
    session: int
    lifetime_us: int
    lost_after_ns: int
    device_tick_ps: int
    current_quantum_a: float
    wait_for_room: bool
    host_paced: bool = False
    stop_when_late: bool = False
    spin_ns: int = 0
    limit_switch: int = 0
    stop_requests: int = 0
    stop_requests_before: int = 0
    exchange_every_ns: int = 0
    supervise_every_ns: int = 0
    batch_samples: int = 1
    agreement_quanta: int = 0

    def as_array(self) -> NDArray[np.void]:
        """Return the settings as an array of length 1 with named fields, which the compiled loop reads."""
        array = np.zeros(1, SETTINGS)
        for name in SETTINGS.names or ():
            array[name] = getattr(self, name)
        return array


@dataclass(frozen=True, slots=True)
class LoopEnd:
    """End of a loop: the reason, an exception of a law or of the simulation, and the counters of loop and link.

    `contradiction` describes an inconsistency in the device's reports, "" without one. `stopper` is the signal or
    process that stopped the loop, "" if the loop's owner did. `watched` contains energy given to the handle and its
    limit (J), consecutive effort oscillations at the end, and the longest time between two of them (s).
    """

    reason: EndReason
    error: BaseException | None
    counters: dict[str, int]
    contradiction: str = ""
    stopper: str = ""
    watched: dict[str, float] = field(
        default_factory=lambda: dict.fromkeys(
            ("energy", "energy_limit", "oscillations", "oscillation_s"), 0.0
        )
    )


COUNTERS = {
    "ticks": control_words.TICKS,
    "rows_dropped": control_words.DROPPED,
    "frames": control_words.FRAMES,
    "bad_frames": control_words.BAD_FRAMES,
    "other_frames": control_words.OTHER_FRAMES,
    "duplicated": control_words.DUPLICATED,
    "reordered": control_words.REORDERED,
    "lost": control_words.LOST,
    "commands": control_words.COMMANDS,
    "unsent": control_words.UNSENT,
    "late": control_words.LATE,
    "skipped": control_words.SKIPPED,
    "stale": control_words.STALE,
    "overruns": control_words.OVERRUNS,
    "exchanges": control_words.EXCHANGES,
    "parameter_set": control_words.PARAMETER_SET,
    "errno": control_words.END_ERRNO,
}


def fault_of(state: NDArray[np.int64]) -> int:
    """Return the fault code in a STATE, 0 without a fault; a pressed emergency stop counts even if not latched."""
    pressed = int(state[STATE.inputs]) & Input.EMERGENCY_STOP
    return int(state[STATE.fault]) or (Fault.EMERGENCY_STOP if pressed else Fault.NONE)


class LoopThread:
    """A thread that runs the loop once: call `start`, `wait`, `finish` and `end` in this order; `stop` at any time.

    Parameters
    ----------
    link, controller, settings, ring
        Link to the device, law, settings, and the memory that recorder and supervisor share with the loop.
    realtime
        Real-time scheduling of the thread; None for an ordinary thread.
    heartbeat_s
        The loop ends when `wait` has not run for this time (s); 0: never, as in virtual time.
    nonce
        Number of the last transaction with the device, from which the loop continues to count.
    sensor, encoder_sign
        Parameters of the expected measured current, and the sign of the encoder; without `sensor` (None) the measured
        current is not checked.
    """

    compiled: ClassVar[tuple[Any, ...]] = (host.run,)  # compiled functions that thread and supervisor call

    @classmethod
    def prepare(cls, link: Link, controller: ControllerState) -> None:
        """Compile or load all code of a run. Call it before the device is armed, since a loop must not compile."""
        prepare(*cls.compiled, *link.port(), *controller.arguments())

    def __init__(
        self,
        link: Link,
        controller: ControllerState,
        settings: LoopSettings,
        ring: Ring,
        *,
        realtime: Realtime | None = None,
        heartbeat_s: float = 0.0,
        nonce: int = 0,
        sensor: CurrentSensor | None = None,
        encoder_sign: int = 1,
    ) -> None:
        self.prepare(link, controller)
        self.ring = ring
        self._link = link
        self._controller = controller
        self._settings = settings
        self._realtime = realtime
        self._heartbeat_ns = 0 if link.clock.virtual else round(heartbeat_s * 1e9)
        self._error: BaseException | None = None
        # The thread writes into this memory: a reference here keeps it alive after the ring is closed.
        self._memory: NDArray[np.uint8] | None = ring.buffer
        self._buffers = Buffers.allocate()
        self._buffers.progress["nonce"] = nonce
        if sensor is not None:
            rate = round(1e9 / settings.period_ns)
            current.configure(self._buffers.currents, sensor, rate, encoder_sign)
        if realtime is not None:
            for array in (ring.buffer, *self._arrays()):
                realtime.prefault(array)
        # Not Thread.join: interrupted by Ctrl-C, it forgets in Python 3.11 that the thread is still running.
        self._started = False
        self._ended = threading.Event()
        # A daemon: if the interpreter dies, the thread dies too, and the device's watchdog takes the effort to zero.
        self._thread = threading.Thread(target=self._body, name="rig-loop", daemon=True)

    def start(self) -> None:
        """Set the first heartbeat, and start the thread."""
        self._started = True
        self._set_heartbeat()
        self._thread.start()

    def stop(self) -> None:
        """Request the end of the loop: it sends zero effort within a tick. Call it from any thread, also repeatedly."""
        self.ring.put(control_words.STOP, 1)

    def wait(self, progress: Callable[[int, int], None] | None = None) -> None:
        """Block until the loop has ended; call `progress(ticks, phase)` a few times a second meanwhile.

        After a stop, wait at most `JOIN_S` (5 s), because a law that never returns must not keep Ctrl-C from ending the
        program. After Ctrl-C or an exception of `progress`, the caller must call `finish`.
        """
        requested_at: float | None = None
        while not self._ended.wait(POLL_S):
            stop_requests.renew()
            if self._is_requested_to_stop():
                # The loop reads the request too; a law that never returns does not, and the patience below begins here.
                self.stop()
            if self.ring.get(control_words.STOP) != 0:
                requested_at = time.monotonic() if requested_at is None else requested_at
                if time.monotonic() - requested_at > JOIN_S:
                    return
            self._set_heartbeat()
            self._attend()
            if progress is not None:
                progress(self.ring.get(control_words.TICKS), self.ring.get(control_words.PHASE))

    def _is_requested_to_stop(self) -> bool:
        counter = self._settings.stop_requests
        return counter != 0 and read_word(counter) != self._settings.stop_requests_before

    def _stopper(self) -> str:
        if self._is_requested_to_stop():
            return f" by {stop_requests.requester()}"
        process = -self.ring.get(control_words.STOP)
        return f" by process {process} (`rig stop`, or STOP of a console)" if process > 0 else ""

    def _set_heartbeat(self) -> None:
        if self._heartbeat_ns:
            self.ring.put(control_words.HEARTBEAT, self._link.clock.now_ns() + self._heartbeat_ns)

    def _attend(self) -> None:
        """Do periodic work in Python while the loop runs; subclasses override it."""

    def finish(self) -> None:
        """Stop the loop if it still runs; wait at most `JOIN_S` (5 s) for its end. Never raise, even after Ctrl-C."""
        patience = time.monotonic() + JOIN_S
        while self._started and not self._ended.is_set() and time.monotonic() < patience:
            with suppress(KeyboardInterrupt):
                self.stop()
                self._ended.wait(POLL_S)
        if self._started and not self._ended.is_set():
            self.ring.put(control_words.STOP, control_words.ABANDONED)

    def end(self) -> LoopEnd:
        """Return how the loop ended; the reason is `EndReason.STUCK` if it still runs although `finish` stopped it."""
        stuck = self._started and not self._ended.is_set()
        # END_REASON of a loop that is stuck is not written yet.
        reason = EndReason.STUCK if stuck else EndReason(self.ring.get(control_words.END_REASON))
        failure = self._error or self._link.failure()
        counters = {name: self.ring.get(word) for name, word in COUNTERS.items()}
        control, memory = self._controller.control[0], self._controller.memory[0]
        watched = {
            "energy": float(memory["energy"]),
            "energy_limit": float(control["energy_limit"]),
            "oscillations": float(memory["oscillations"]),
            "oscillation_s": float(control["oscillation_ticks"] * control["tick_s"]),
        }
        found = Contradiction(int(self._buffers.progress[0]["contradiction"]))
        return LoopEnd(reason, failure, counters, found.text, self._stopper(), watched)

    @property
    def fault(self) -> int:
        """Return the fault code in the newest STATE, 0 without a fault."""
        return fault_of(self._buffers.state)

    def messages(self) -> list[str]:
        """Return warnings about the run for the user, in addition to the reason of its end."""
        return []

    def findings(self) -> dict[str, Any]:
        """Return further results of this kind of loop for the recording, by name; none in this class."""
        return {}

    def exchanges(self) -> NDArray[np.int64]:
        """Return the clock exchanges of the run, oldest first: rows of 4 times (ns), as in `clock_fit.EXCHANGE`."""
        done = self.ring.get(control_words.EXCHANGES)
        kept = np.arange(max(0, done - EXCHANGES_KEPT), done) % EXCHANGES_KEPT
        return self._buffers.exchanges[kept]

    def parameter_sets(self) -> list[dict[str, Any]]:
        """Return each parameter set that was active: number, first tick, wall position (rad or m), law parameters."""
        count = len(self._controller.law.parameters)
        return [
            {
                "number": int(row[0]),
                "tick": int(row[1]),
                "wall_position": float(row[2]),
                "parameters": row[3 : 3 + count].tolist(),
            }
            for row in self._buffers.sets[: int(self._buffers.progress[0]["sets"])]
        ]

    def handover(self) -> dict[str, int] | None:
        """Return the numbers from which `FramedDevice.take_back` continues the protocol after this loop.

        Return None if the loop received no sample: then it has sent nothing either.
        """
        progress = self._buffers.progress[0]
        if not progress["started"]:
            return None
        return {
            "next_command": int(progress["sequence"]),
            "newest_state": int(progress["answers"]),
            "state": int(self._buffers.state[STATE.state]),
            "nonce": int(progress["nonce"]),
        }

    def _body(self) -> None:
        # Ctrl-C must reach Python's main thread and must not interrupt a wait of this one.
        take_no_signals()
        try:
            if self._realtime is not None:
                self._realtime.enter_thread()
            self._run()
        except Exception as error:
            # A user's law or estimator raised: the compiled loop ended without its stop path. The caller sends STOP
            # next; this thread only reports. Without its traceback the error does not keep this thread's frames, and
            # the memory that they refer to, until the next garbage collection.
            self._error = error.with_traceback(None)
            self.ring.put(control_words.END_REASON, EndReason.LAW_RAISED)
        finally:
            self.ring.put(control_words.LOOP_DONE, 1)
            self._ended.set()

    def _run(self) -> None:
        host.run(
            self._link.port(),
            self._controller.arguments(),
            self._shared(),
            self._settings.as_array(),
            self._buffers,
        )

    def _shared(self) -> SharedRing:
        return SharedRing(words=self.ring.words.ctypes.data, mailbox=self._mailbox(), rows=self.ring.rows)

    def _mailbox(self) -> int:
        """Return the address of the ring's mailbox for parameter sets; 0 if the law has too many parameters."""
        return self.ring.mailbox if len(self._controller.law.parameters) < SET_FLOATS else 0

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays that must be loaded into memory before the run, so that the loop never waits for a page."""
        return tuple(self._buffers)
