"""A simulated device in its own process, with a line that fails on command and a witness file that outlives it.

The device writes the witness, a small file that every process can read, at every tick: its current and its latched
fault. So a test can check what the device did when no frame can report it.

The result does not depend on the load of this machine: the device's time stops while its process or its host gets no
processor (`PatientClock`, `FaultyPort`), and the host has longer timeouts for samples and replies
(`patient_host`).
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol import transaction
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig.core.errors import RigError
from rig.core.model import RigModel
from rig.devices import open_device
from rig.devices.fault_script import Direction, FrameFault
from rig.devices.framed import FramedDevice
from rig.devices.port import LoopPort
from rig.experiments.trials import _trial as trial
from rig.realtime.callbacks import callback_plugs
from rig.realtime.plugs import NOW_SIGNATURE, WAIT_SIGNATURE, NativeFunction
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.hardware import World
from sim_backend.board.safety import AT
from sim_backend.ends import line, pty, real_time
from sim_backend.ends.board_time import BoardTime
from sim_backend.ends.channel import ScriptedLine
from sim_backend.ends.line import PseudoTerminal
from sim_backend.ends.real_time import DevicePort, RealTime, sleep_until
from tests.conformance.started import WAIT_S, die_with_parent
from tests.conformance.trials import trial_on

SLOWER = 100  # a host that died has lost its device after 2 s
PATIENCE_S = 5.0  # without a sample, after which a device is lost to its host
ANSWER_S = 0.1  # until a request is sent again
LONGEST_STEP_NS = 2_500_000  # of device time between two readings: slightly more than a tick at 500 Hz
OWED_NS = 8_000_000  # of device time in which a host sends something: less than any lifetime here

WITNESS = np.dtype(
    [
        ("ticks", "<i8"),
        ("running", "<i8"),  # ticks in RUNNING
        ("current", "<i8"),  # active (quanta)
        ("rises", "<i8"),  # ticks of a ramp in which the current rose
        ("state", "<i8"),
        ("fault", "<i8"),
        ("first_fault", "<i8"),  # the first one ever
        ("acted", "<i8"),  # faults of the line that have struck
    ]
)


@dataclass(frozen=True, slots=True)
class Script:
    """The faults of a run, from `after` ticks of RUNNING on; frames of a fault count from there in each direction."""

    after: int = 60
    frames: tuple[FrameFault, ...] = ()
    fault: Fault = Fault.NONE  # that the device finds


# ---------------------------------------------------------------------- in the process of the device


class PatientClock:
    """A device clock that counts only while this process runs: a pause of the process adds one step.

    It stands for the module `time` in `sim_backend`, and for the two clock functions of a `LoopPort`.
    """

    perf_counter_ns = staticmethod(time.perf_counter_ns)
    sleep = staticmethod(time.sleep)

    def __init__(self) -> None:
        self._seen_ns = self._now_ns = time.monotonic_ns()

    def monotonic_ns(self) -> int:
        real_ns = time.monotonic_ns()
        self._now_ns += min(real_ns - self._seen_ns, LONGEST_STEP_NS)
        self._seen_ns = real_ns
        return self._now_ns

    def stand_still(self) -> None:
        """Exclude the time since the last reading."""
        self._seen_ns = time.monotonic_ns()

    def loop_port(self, **plugs: Any) -> LoopPort:
        """Return a loop port with these byte functions and this clock, for compiled code."""

        def sleep_until_(handle: int, deadline_ns: int) -> int:
            sleep_until(deadline_ns)
            return 0

        return LoopPort(
            now=native(lambda handle: self.monotonic_ns(), NOW_SIGNATURE, 1),
            sleep=native(sleep_until_, WAIT_SIGNATURE, 2),
            clock_handle=0,
            **plugs,
        )


class Witness:
    """The record that a device writes about itself at each tick; it also injects the faults of the script."""

    def __init__(self, device: SimulatedDevice | FirmwareDevice, witness: np.ndarray, script: Script) -> None:
        self.device, self.witness, self.script = device, witness, script
        self._struck = False
        self.ticks = self.running = self.rises = 0
        self._first_fault = Fault.NONE

    def see_tick(self, state: State, fault: Fault) -> None:
        self.ticks += 1
        self.running += state is State.RUNNING
        self._first_fault = self._first_fault or fault
        script, device = self.script, self.device
        if self._struck or self.running <= script.after:
            return
        self._struck = True
        if script.fault is Fault.EMERGENCY_STOP:
            device.press_emergency_stop()
        elif script.fault:
            device.inject_fault(script.fault)

    def write(self, state: State, current: int, fault: Fault) -> None:
        w = self.witness[0]
        w["running"], w["rises"] = self.running, self.rises
        w["current"], w["state"], w["fault"], w["first_fault"] = current, state, fault, self._first_fault
        w["ticks"] = self.ticks


class WatchedDevice(SimulatedDevice):
    """A simulated device with a `Witness`."""

    def __init__(self, model: RigModel, witness: np.ndarray, script: Script, **options: Any) -> None:
        super().__init__(model, **options)
        self.witness = Witness(self, witness, script)

    def tick(self) -> bytes:
        before = abs(self.current)
        sent = super().tick()
        if self.board.rules[AT.ramping] and abs(self.current) > before:
            self.witness.rises += 1
        self.witness.see_tick(self.connection.state, self.fault)
        self.witness.write(self.connection.state, self.current, self.fault)
        return sent


class WatchedFirmware(FirmwareDevice):
    """The firmware with a `Witness`. (A falling ramp is not checked, because the law behind it continues.)"""

    def __init__(self, model: RigModel, witness: np.ndarray, script: Script, **options: Any) -> None:
        super().__init__(model, **options)
        self.witness = Witness(self, witness, script)

    def passed(self, world: World) -> None:
        before = self.time
        super().passed(world)
        if self.time != before:  # one tick, as asked
            self.witness.see_tick(self.state, self.fault)
            self.witness.write(self.state, self.current, self.fault)


class FaultyPort:
    """A port whose line follows a script; `unplug` is the port's own way to lose the plug."""

    def __init__(self, port: DevicePort, watched: Witness, unplug: Any, clock: PatientClock) -> None:
        self._port, self._watched, self._unplug, self._clock = port, watched, unplug, clock
        self._came_ns = clock.monotonic_ns()
        self._device = watched.device
        self._line = ScriptedLine()
        self._begun = self._gone = False

    def read(self, deadline_ns: int) -> bytes:
        if self._gone:
            sleep_until(deadline_ns)
            return b""
        data = self._port.read(deadline_ns) or self._wait_for_the_host()
        if data:
            self._came_ns = self._clock.monotonic_ns()
        self._begin()
        tick = self._device.sample_index
        self._line.send(Direction.TO_DEVICE, data, tick)
        self._record_tick()
        return self._line.receive(Direction.TO_DEVICE, tick)

    def _wait_for_the_host(self) -> bytes:
        """Slow device time by `SLOWER` while a command is due; never stop it, because a STATE may have been lost."""
        # A host that has hung up, as a killed one, owes nothing any more.
        owed = self._device.state in (State.ARMED, State.RUNNING) and not getattr(
            self._port, "_hung_up", False
        )
        if not owed or self._clock.monotonic_ns() - self._came_ns < OWED_NS:
            return b""
        data = self._port.read(self._clock.monotonic_ns() + SLOWER * 1_000_000_000 // self._device.rate)
        self._clock.stand_still()
        return data

    def write(self, frames: bytes) -> None:
        if not self._gone:
            self._port.write(self._passed(frames))

    def write_if_free(self, frame: bytes) -> None:
        if self._gone:
            return
        self._port.write_if_free(self._passed(frame))

    def _passed(self, frames: bytes) -> bytes:
        self._begin()
        tick = self._device.sample_index
        self._line.send(Direction.TO_HOST, frames, tick)
        self._record_tick()
        return self._line.receive(Direction.TO_HOST, tick)

    def _begin(self) -> None:
        script, begun = self._watched.script, self._line.frames
        if not self._begun and self._watched.running > script.after:
            self._begun = True
            self._line.add(replace(one, frame=one.frame + begun[one.direction]) for one in script.frames)

    def _record_tick(self) -> None:
        self._watched.witness[0]["acted"] = sum(self._line.acted.values())
        if self._line.unplugged and not self._gone:
            self._gone = True
            self._unplug()


class PluggedPort:
    def __init__(self, port: DevicePort, clock: PatientClock) -> None:
        self._port = port
        self._clock = clock
        self._received = b""

    def loop_port(self) -> LoopPort:
        plugs = callback_plugs(read=self._read, write=self._port.write, wait=self._wait)
        return self._clock.loop_port(**plugs._asdict())

    def _wait(self, deadline_ns: int) -> bool:
        self._received = self._received or self._port.read(deadline_ns)
        return bool(self._received)

    def _read(self, size: int) -> bytes:
        data, self._received = self._received[:size], self._received[size:]
        return data


class _FromPython(NativeFunction):
    """A plug function that Python can call, too."""

    def __call__(self, *words: int) -> int:
        return self.function(*words)

    function: Callable[..., int]


def native(function: Callable[..., int], signature: Any, words: int) -> NativeFunction:
    """Return a plug function that calls a Python function with `words` arguments."""
    callback = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * words)(function)
    address = ctypes.cast(callback, ctypes.c_void_p).value
    assert address is not None
    made = _FromPython(address, signature, keep=callback)
    made.function = function
    return made


@contextmanager
def _pty_port() -> Iterator[tuple[str, DevicePort, Callable[[], None]]]:
    with PseudoTerminal() as port:

        def hang_up() -> None:
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, port.descriptor)  # the last descriptor of the master goes: the other end hangs up
            os.close(null)

        yield f"serial://{port.place}", port, hang_up


def _serve(model: RigModel, script: Script, witness_path: Path, rate: int, firmware: bool, pipe: Any) -> None:
    die_with_parent()
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    witness = np.memmap(witness_path, WITNESS, mode="r+", shape=1)
    options: dict[str, Any] = {"position_rate_default": rate, "keep_truth": False}
    clock = PatientClock()
    real_time.time = line.time = clock  # type: ignore[assignment]
    with _pty_port() as (url, port, unplug):
        running: BoardTime | RealTime
        if firmware:
            made = WatchedFirmware(
                model, witness, script, position_rate_maximum=pty.FIRMWARE_RATE_MAXIMUM, **options
            )
            faulty = PluggedPort(FaultyPort(port, made.witness, unplug, clock), clock)
            running = BoardTime(made, faulty.loop_port(), stop, most=1)
        else:
            device = WatchedDevice(model, witness, script, position_rate_maximum=4_000, **options)
            running = RealTime(device, FaultyPort(port, device.witness, unplug, clock), stop)
        pipe.send(url)  # only after compiling, so that no host waits for the compiler
        running.run(None)


# ---------------------------------------------------------------------- in the process of the test


@contextmanager
def patient_host() -> Iterator[None]:
    """Give a host in this process longer timeouts for samples and replies, for a busy machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trial, "LOST_AFTER_S", PATIENCE_S)
        patch.setattr(transaction, "_FIRST_NS", round(ANSWER_S * 1e9))
        yield


def processes() -> Any:
    """Return a forkserver context whose children start at once, because its server has imported everything."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["tests.conformance.forked_from", "rig.experiments.trials._trial", "rig.devices.serial"]
    )
    return context


class FarEnd:
    """A device process with its URL and its witness."""

    _numbers = itertools.count()

    def __init__(
        self, directory: Path, model: RigModel, script: Script, rate: int, *, firmware: bool = False
    ) -> None:
        path = directory / f"witness-{next(self._numbers)}"
        np.zeros(1, WITNESS).tofile(path)
        self._witness = np.memmap(path, WITNESS, mode="r", shape=1)
        context = processes()
        receiver, sender = context.Pipe(duplex=False)
        self.process = context.Process(
            target=_serve, args=(model, script, path, rate, firmware, sender), name="far-end", daemon=True
        )
        self.process.start()
        sender.close()
        with receiver:
            if not receiver.poll(WAIT_S):
                self.close()
                raise AssertionError("the device process does not start")
            self.url: str = receiver.recv()

    def __getitem__(self, name: str) -> int:
        """Return a value that the device recorded at its last tick."""
        return int(self._witness[0][name])

    @contextmanager
    def open(self) -> Iterator[FramedDevice]:
        with patient_host(), open_device(self.url) as device:
            yield device

    def kill(self) -> None:
        self.process.kill()
        self.process.join(WAIT_S)

    def wait_for(self, what: Callable[[FarEnd], bool], text: str) -> None:
        deadline = time.monotonic() + WAIT_S
        while not what(self):
            assert time.monotonic() < deadline, f"{text}: {self._witness[0]}"
            time.sleep(0.005)

    def wait_for_rest(self) -> None:
        """Wait until no current flows and the device is disarmed, and for 20 ticks more."""
        self.wait_for(
            lambda w: w["current"] == 0 and w["state"] not in (State.ARMED, State.RUNNING), "no rest"
        )
        ticks = self["ticks"]
        self.wait_for(lambda w: w["ticks"] >= ticks + 20, "the device stands still")
        assert self["current"] == 0
        assert self["rises"] == 0, "a ramp only falls"

    def close(self) -> None:
        if self.process.is_alive():
            self.process.terminate()
            self.process.join(WAIT_S)
        if self.process.is_alive():
            self.kill()
        self.process.close()
        self._witness = self._witness.copy()  # the file goes, its content stays


class HostProcess:
    """A host that runs one trial in its own process, which a test can kill, stop and interrupt."""

    def __init__(self, url: str, experiment: Any, recording: Path) -> None:
        context = processes()
        self._receiver, sender = context.Pipe(duplex=False)
        self.process = context.Process(
            target=_run_host, args=(url, experiment, recording, sender), name="host", daemon=True
        )
        self.process.start()
        sender.close()

    def send(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process.pid, number)

    def ended(self) -> str:
        """Wait for the end; return the error's class name, "" without an error, "killed" without a report."""
        self.process.join(WAIT_S)
        assert not self.process.is_alive(), "the host does not end"
        try:
            return str(self._receiver.recv())
        except EOFError:
            return "killed"

    def close(self) -> None:
        if self.process.is_alive():
            self.process.kill()
            self.process.join(WAIT_S)
        self._receiver.close()
        self.process.close()


def _run_host(url: str, experiment: Any, recording: Path, pipe: Any) -> None:
    die_with_parent()
    name = ""
    try:
        with patient_host(), open_device(url) as device:
            trial_on(device, experiment=experiment, recording=recording, verified=True, seed=0, sealed=False)
    except RigError as error:
        name = type(error).__name__
    pipe.send(name)
