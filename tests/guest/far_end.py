"""The simulated rig as a process behind any port; it reports its state at its end.

The process is forked, since in an emulated machine a new interpreter takes half a minute; it must be started before
this process has threads.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from firmware_protocol.connection import State
from rig.core.model import RigModel
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.real_time import DevicePort, RealTime

RATE = 500  # Hz; an emulated machine keeps little more, and homing needs as much
RATE_MAXIMUM = 4_000
WAIT_S = 20.0


@dataclass(frozen=True, slots=True)
class Left:
    """The state of the device at its end: last and largest current (quanta), protocol state, missed ticks."""

    current: int
    strongest: int
    state: State
    missed_ticks: int


class FarEnd:
    def __init__(self, pipe: Any) -> None:
        self._pipe = pipe
        self._left: Left | None = None

    def left(self) -> Left:
        if self._left is None:
            self._pipe.send(None)
            if not self._pipe.poll(WAIT_S):
                raise TimeoutError("the device does not stop")
            self._left = self._pipe.recv()
        return self._left


class _Watched(SimulatedDevice):
    strongest = 0

    def tick(self) -> bytes:
        state = super().tick()
        self.strongest = max(self.strongest, abs(self.current))
        return state


@contextlib.contextmanager
def far_end(model: RigModel, make_port: Callable[[], DevicePort]) -> Iterator[FarEnd]:
    """Run a simulated rig in another process behind the port that `make_port` opens there; it outlives its host.

    The device is built here, so that its imports and kernels are loaded for the next one and for the host too.
    """
    device = _Watched(model, position_rate_default=RATE, position_rate_maximum=RATE_MAXIMUM, keep_truth=False)
    device.hardware.prepare()
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_run, args=(device, make_port, there), daemon=True)
    process.start()
    there.close()
    try:
        if not here.poll(WAIT_S):
            raise TimeoutError("the device does not start")
        here.recv()
        yield FarEnd(here)
    finally:
        process.terminate()
        process.join(WAIT_S)
        here.close()


def _run(device: _Watched, make_port: Callable[[], DevicePort], pipe: Any) -> None:
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipe.send(None)
    stop = threading.Event()

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError):
            pipe.recv()
        stop.set()

    threading.Thread(target=listen, daemon=True).start()
    RealTime(device, make_port(), stop).run(None)
    pipe.send(Left(device.current, device.strongest, device.connection.state, device.missed_ticks))
