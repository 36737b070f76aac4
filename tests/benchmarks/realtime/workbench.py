"""Shared tools of the benchmarks in this directory: C programs, real-time priority, load, controllers, tables.

`RIG_BENCH_FULL=1` measures longer and more cases; otherwise everything here together takes about a minute.
"""

import contextlib
import ctypes
import json
import os
import shutil
import statistics
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.framing import encode_frame
from firmware_protocol.packing import pack, type_id_of
from rig.config import controller, presets
from rig.config._sections import Host
from rig.control.step import TRIAL, ControllerState
from rig.devices.descriptor import DescriptorLink
from rig.devices.device import DeviceUrl
from rig.devices.port import LoopPort
from rig.loop._run import LoopSettings, LoopThread
from rig.loop._signals import stop_on_signals
from rig.loop.layout import EndReason
from rig.realtime.clock import MonotonicClock
from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE, NativeFunction
from rig.realtime.ring import Ring
from rig.realtime.scheduling import obtained
from rig.realtime.stop_requests import address
from tests.conformance.started import started

HERE = Path(__file__).parent
FULL = os.environ.get("RIG_BENCH_FULL", "") not in ("", "0")
PRIORITY = 80
SESSION = 9
CPUS = sorted(os.sched_getaffinity(0))
LOOP_CPU = CPUS[-1]
CURRENT_QUANTUM_A = 0.001

_DEFINES = {
    "MAJOR": m.MAJOR, "COMMAND_TYPE": type_id_of(m.Command), "STATE_TYPE": type_id_of(m.State),
    "STATE_RUNNING": int(State.RUNNING),
}  # fmt: skip


def compile_c(directory: Path, name: str, *options: str) -> Path:
    """Compile ``name.c`` of this directory; skips the test without a compiler."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("gcc is not installed (package gcc)")
    program = directory / name
    defines = [f"-D{key}={value}" for key, value in _DEFINES.items()]
    options = ("-std=gnu99", "-O3", "-Wall", "-Wextra", "-Werror", "-pthread", *defines, *options)
    subprocess.run([compiler, *options, str(HERE / f"{name}.c"), "-o", str(program)], check=True)
    return program


# Privileges and load --------------------------------------------------------------------------------------


def may_be_realtime() -> bool:
    """Return True if SCHED_FIFO is granted; a thread of its own tries it and ends."""
    granted: list[bool] = []

    def ask() -> None:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            granted.append(True)

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    return bool(granted)


@contextlib.contextmanager
def inherited(priority: int, cpu: int | None = None) -> Iterator[None]:
    """Give threads started in the block a SCHED_FIFO priority (0: none) and a processor (None: any)."""
    policy, parameter, affinity = os.sched_getscheduler(0), os.sched_getparam(0), os.sched_getaffinity(0)
    try:
        if cpu is not None:
            os.sched_setaffinity(0, {cpu})
        if priority > 0:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        yield
    finally:
        os.sched_setscheduler(0, policy, parameter)
        os.sched_setaffinity(0, affinity)


@contextlib.contextmanager
def processor_hogs(count: int) -> Iterator[None]:
    """Run `count` processes that only compute; they end with the context."""
    with contextlib.ExitStack() as hogs:
        for _ in range(count):
            hogs.enter_context(started("sh", "-c", "while :; do :; done"))
        yield


@contextlib.contextmanager
def interpreter_hogs() -> Iterator[None]:
    """Run two threads in this interpreter: one rarely releases the GIL, one creates and collects garbage."""
    stopped = False

    def compute() -> None:
        number = 0
        while not stopped:
            number = (number * 1103515245 + 12345) & 0x7FFFFFFF

    def litter() -> None:
        import gc  # noqa: PLC0415

        while not stopped:
            rings = [[] for _ in range(2000)]  # type: list[list[object]]
            for ring in rings:
                ring.append(ring)
            del rings
            gc.collect()

    threads = [threading.Thread(target=target) for target in (compute, litter)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stopped = True
        for thread in threads:
            thread.join()


# What the loop runs ---------------------------------------------------------------------------------------


def pushing_for_ever(rate: int) -> ControllerState:
    """Return the compliant rig's wall in the middle of a trial without end and without limits."""
    experiment = presets.load("koul-compliant")
    made = controller.for_experiment(experiment, current_quantum_a=CURRENT_QUANTUM_A)
    limits = {"window_minimum": -np.inf, "window_maximum": np.inf, "speed_limit": np.inf}
    times = {"tick_s": 1.0 / rate, "trial_ticks": 1 << 40, "release_ticks": 1}
    for name, value in {**times, **limits}.items():
        made.control[name] = value
    made.memory["phase"] = TRIAL
    return made


def command_frame(sequence: int) -> bytes:
    command = m.Command(state_sequence=0, lifetime_us=5000, mode=m.Mode.STOP, flags=0, current=0)
    return encode_frame(pack(command, session=SESSION, sequence=sequence))


def descriptor_link(descriptor: int) -> DescriptorLink:
    return DescriptorLink(DeviceUrl.of("unix", "/bench"), descriptor)


class NearLink:
    """A link whose far end costs nothing (`near.c`): each read of the loop returns one new STATE."""

    clock = MonotonicClock()

    def __init__(self, library: Path, rate: int) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.near_prepare()
        self._memory = np.array([SESSION, 1_000_000_000 // rate, 0, 0], np.int64)

    def port(self) -> LoopPort:
        """Return the loop's port, as `rig.devices.device.Link.port` does."""

        def plug(name: str, signature: Any) -> NativeFunction:
            address = ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value
            assert address is not None
            return NativeFunction(address, signature, keep=self._library)

        return LoopPort.on(
            self.clock,
            read=plug("near_read", TRANSFER_SIGNATURE),
            write=plug("near_write", TRANSFER_SIGNATURE),
            wait=plug("near_wait", WAIT_SIGNATURE),
            handle=int(self._memory.ctypes.data),
        )

    def failure(self) -> None:
        """Implement `rig.devices.device.Link.failure`: this link never fails."""


@contextlib.contextmanager
def running_loop(
    link: Any, rate: int, ring: Ring, *, cpu: int | None = LOOP_CPU, **settings: Any
) -> Iterator[LoopThread]:
    """Run the shipped loop until the context ends, as `trials.trial` does, scheduled as far as is granted.

    It must have run without an error then, and stopped on request.
    """
    with obtained(Host(realtime="try", priority=PRIORITY, cpu=cpu)) as realtime, stop_on_signals() as signals:
        given = LoopSettings(
            period_ns=1_000_000_000 // rate, session=SESSION, lifetime_us=5000, lost_after_ns=2_000_000_000,
            device_tick_ps=62_500, current_quantum_a=CURRENT_QUANTUM_A, wait_for_room=False,
            stop_requests=address(), stop_requests_before=signals.series.since, **settings,
        )  # fmt: skip
        loop = LoopThread(link, pushing_for_ever(rate), given, ring, realtime=realtime)
        loop.start()
        try:
            yield loop
        finally:
            loop.finish()
    end = loop.end()
    assert (end.reason, end.error) == (EndReason.STOPPED, None)


def find_cyclictest() -> str | None:
    """Return the path of cyclictest, which may be outside of an ordinary user's PATH; None if missing."""
    return shutil.which("cyclictest") or shutil.which("cyclictest", path="/usr/sbin:/usr/bin")


def cyclictest_latency(program: str, rate: int, seconds: float, directory: Path) -> np.ndarray:
    """Return the latency of each wake-up of cyclictest (ns) with the loop's interval, priority and processor."""
    results = directory / "cyclictest.json"
    command = [program, "-m", "-q", "-t1", f"-p{PRIORITY}", f"-a{LOOP_CPU}", f"-i{1_000_000 // rate}"]
    command += [f"-l{round(seconds * rate)}", "-h", "20000", f"--json={results}"]
    subprocess.run(command, check=True, capture_output=True, timeout=60 + 10 * seconds)
    thread = json.loads(results.read_text())["thread"]["0"]
    latencies = [np.full(count, int(us)) for us, count in thread["histogram"].items()]
    beyond = max(0, int(thread["cycles"]) - sum(map(len, latencies)))
    return np.concatenate([*latencies, np.full(beyond, int(thread["max"]))]) * 1000


def python_lateness(rate: int, seconds: float) -> np.ndarray:
    """Return the lateness of each turn of a plain Python loop (ns), without real-time priority."""
    period = 1_000_000_000 // rate
    late: list[int] = []

    def turns() -> None:
        now = time.monotonic_ns()
        end, due = now + round(seconds * 1e9), now + period
        while due < end:
            time.sleep(max(0, due - now) * 1e-9)
            now = time.monotonic_ns()
            late.append(now - due)
            due += period * (1 + (now - due) // period)

    thread = threading.Thread(target=turns)
    thread.start()
    thread.join()
    return np.array(late)


# Numbers and tables ---------------------------------------------------------------------------------------


def quantiles(values: np.ndarray) -> tuple[float, float, float, float]:
    p50, p99, p999 = np.quantile(values, (0.5, 0.99, 0.999), method="higher")
    return float(p50), float(p99), float(p999), float(np.max(values))


def medians(rounds: Sequence[Sequence[float]]) -> list[float]:
    return [statistics.median(column) for column in zip(*rounds, strict=True)]


def print_table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print aligned columns, of which the first is text."""
    cells = [list(map(str, head)), *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    # Only ratios inside one table are comparable.
    print(f"\n{title} (load average {os.getloadavg()[0]:.1f}, {len(CPUS)} processors)")
    for row in cells:
        first, rest = row[0].ljust(widths[0]), zip(row[1:], widths[1:], strict=True)
        print("  " + "  ".join([first, *(cell.rjust(width) for cell, width in rest)]))
