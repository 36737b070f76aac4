"""Compare round trips per second of the loop, a C client and plain pyserial, on the same link to the same far end.

The far end (`far_end.c`) checks each COMMAND and replies with a STATE at once. The shipped loop (`rig.loop`) does all
work of a real run: stuffing, CRC, estimator, wall, guard, time stamps and a row in the ring. The client (`client.c`)
does the same, written for one estimator and one law. Plain pyserial (sockets where it does not apply) writes one
prepared frame and reads the bytes of a STATE without checks or computation.

They run in turn; the median of the ratios counts, and a link that misses the limit is measured again, because another
program can spoil a second. SCHED_FIFO is used at both ends where permitted. On a loaded machine a kernel thread of
ordinary priority transfers the bytes of a terminal for every reader: that ratio is only printed.

Loop and client both wait at most `SHORTEST_WAIT_NS` (a stop must take effect within a tick). On a virtual machine
such a short timer costs several µs per trip, which plain Python, with a timeout of a second, does not pay.
"""

import contextlib
import json
import os
import pty
import select
import socket
import statistics
import subprocess
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import serial

from firmware_protocol import messages as m
from firmware_protocol.framing import FrameSplitter
from firmware_protocol.packing import encoded_bytes, unpack
from rig.devices import open_link
from rig.devices.port import LoopPort
from rig.loop._host import SHORTEST_WAIT_NS
from rig.realtime import control_words
from rig.realtime.clock import MonotonicClock
from rig.realtime.ring import Ring
from tests.benchmarks.realtime import workbench
from tests.conformance.started import LEASH

RATE = 20_000  # a period shorter than SHORTEST_WAIT_NS, so that both wait for that
ROUNDS, SECONDS = (15, 0.5) if workbench.FULL else (5, 0.12)
TRIES = 3
RING_ROWS = round(SECONDS * 200_000)
STATE_FRAME_BYTES = encoded_bytes(m.State)
WAIT_S = 10.0
LEAST_OF_C = 0.7  # 0.9 to 2.8 on the processors seen

pytestmark = pytest.mark.timeout(900)


@dataclass
class Wire:
    """One open link, with the interfaces that the loop, Python and a C program need."""

    descriptor: int
    port: Callable[[], LoopPort]
    write: Callable[[bytes], object]
    read_exactly: Callable[[int], bytes]

    clock = MonotonicClock()

    def failure(self) -> None:
        """Implement `rig.devices.device.Link.failure`: this link never fails."""


@contextlib.contextmanager
def open_pty() -> Iterator[tuple[Wire, int]]:
    """Yield a pseudo-terminal, opened by rig and by plain pyserial."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    with serial.Serial(name, timeout=1.0) as plain:
        link = open_link(f"serial://{name}")
        os.close(slave)
        try:
            yield Wire(link.port().handle, link.port, plain.write, plain.read), master
        finally:
            link.close()
            os.close(master)


@contextlib.contextmanager
def open_socket_pair() -> Iterator[tuple[Wire, int]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.settimeout(1.0)
        port = workbench.descriptor_link(ours.fileno()).port
        yield Wire(ours.fileno(), port, ours.send, ours.recv), theirs.fileno()


LINKS = {"pty": open_pty, "socket pair": open_socket_pair}


class Contest:
    def __init__(self, wire: Wire, client: str, priority: int) -> None:
        self.wire, self.client, self.priority = wire, client, priority
        self._marker = 0

    def settle(self) -> None:
        """Discard what is still in transit, up to the reply to a marked COMMAND."""
        self._marker = self._marker % 1000 + 1
        os.write(self.wire.descriptor, workbench.command_frame(self._marker))
        splitter, deadline = FrameSplitter(), time.monotonic() + WAIT_S
        while time.monotonic() < deadline:
            select.select([self.wire.descriptor], [], [], 0.1)
            with contextlib.suppress(BlockingIOError):
                for raw in splitter.feed(os.read(self.wire.descriptor, 4096)):
                    _, state = unpack(raw)
                    if isinstance(state, m.State) and state.command_sequence == self._marker:
                        return
        raise AssertionError("the far end does not answer")

    def kick(self) -> None:
        """Send one COMMAND; its reply is the first STATE that a contestant receives."""
        os.write(self.wire.descriptor, workbench.command_frame(2000))

    def ours(self) -> np.ndarray:
        """Return the receive times of the shipped loop (ns)."""
        self.settle()
        ring = Ring.allocate(RING_ROWS)
        with workbench.running_loop(self.wire, RATE, ring, cpu=None) as loop:
            self.kick()
            time.sleep(SECONDS)
        counters = loop.end().counters
        assert counters["bad_frames"] == counters["unsent"] == 0
        return ring.rows["received_at"][: ring.get(control_words.HEAD)].copy()

    def c(self) -> np.ndarray:
        """Return the receive times of the client in C (ns)."""
        self.settle()
        self.kick()
        arguments = [self.wire.descriptor, self.priority, SECONDS, workbench.SESSION, SHORTEST_WAIT_NS]
        done = subprocess.run(
            [self.client, *map(str, arguments)],
            check=True, stdout=subprocess.PIPE, pass_fds=[self.wire.descriptor], timeout=60,
        )  # fmt: skip
        return np.frombuffer(done.stdout, np.int64)

    def python(self) -> np.ndarray:
        """Return the receive times of plain writes and reads in a Python thread of the same priority (ns)."""
        self.settle()
        command, write, read = workbench.command_frame(0), self.wire.write, self.wire.read_exactly
        times: list[int] = []

        def trips() -> None:
            end = time.monotonic_ns() + round(SECONDS * 1e9)
            now = 0
            while now < end:
                write(command)
                if len(read(STATE_FRAME_BYTES)) != STATE_FRAME_BYTES:
                    return
                now = time.monotonic_ns()
                times.append(now)

        thread = threading.Thread(target=trips)
        with workbench.inherited(self.priority):
            thread.start()
        thread.join()
        assert times
        return np.array(times)


@contextlib.contextmanager
def contest(link: str, programs: dict[str, str], priority: int) -> Iterator[Contest]:
    with LINKS[link]() as (wire, far):
        command = [*LEASH, programs["far_end"], str(far), str(priority), str(-RATE)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, pass_fds=[far], text=True) as process:
            assert process.stdout is not None
            try:
                assert process.stdout.readline() == "ready\n"
                yield Contest(wire, programs["client"], priority)
            finally:
                process.terminate()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(WAIT_S)
                process.kill()
                counts = json.loads(process.stdout.readline())
        assert counts["good"] > 0
        assert counts["bad"] == counts["untaken"] == 0


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    directory = tmp_path_factory.mktemp("c")
    return {name: str(workbench.compile_c(directory, name)) for name in ("far_end", "client")}


def measure_link(link: str, programs: dict[str, str], priority: int) -> dict[str, list[list[float]]]:
    """Return for each contestant and round the trips per second, then p50, p99, p99.9 and maximum (µs)."""
    names = ("ours", "c", "python")
    found: dict[str, list[list[float]]] = {name: [] for name in names}
    with contest(link, programs, priority) as here:
        here.ours()  # once for nothing: compiled, mapped, warm
        for number in range(ROUNDS):
            for k in range(len(names)):
                name = names[(number + k) % len(names)]
                trips = np.diff(getattr(here, name)()) * 1e-3
                if len(trips) == 0:  # the machine stood still
                    trips = np.array([SECONDS * 1e6])
                found[name].append([1e6 * len(trips) / trips.sum(), *workbench.quantiles(trips)])
    return found


def ratio_of(found: dict[str, list[list[float]]], other: str) -> float:
    """Return the loop's round trips per second over those of another contestant: the median over the rounds."""
    return statistics.median(a[0] / b[0] for a, b in zip(found["ours"], found[other], strict=True))


@pytest.mark.parametrize("load", ["idle", "loaded"])
def test_round_trips_a_second_beside_c_and_pyserial(programs: dict[str, str], load: str) -> None:
    priority = workbench.PRIORITY if workbench.may_be_realtime() else 0
    if load == "loaded" and not priority:
        pytest.skip("under load only SCHED_FIFO says something, and it is not granted here (CAP_SYS_NICE)")
    rows, ratios = [], {}
    with workbench.processor_hogs(len(workbench.CPUS) if load == "loaded" else 0):
        for link in LINKS:
            tries = TRIES if link != "pty" or load == "idle" else 1
            for _ in range(tries):
                found = measure_link(link, programs, priority)
                ratio = ratio_of(found, "c")
                if ratio > LEAST_OF_C:
                    break
            if tries > 1:
                ratios[link] = ratio
            python = "pyserial" if link == "pty" else "socket"
            shown = {"ours": f"{link}: rig", "c": f"{link}: C client", "python": f"{link}: plain {python}"}
            for name, label in shown.items():
                rate, *trips = workbench.medians(found[name])
                over = "" if name == "ours" else f"{ratio_of(found, name):.2f}"
                rows.append([label, f"{rate / 1e3:.1f}", *(f"{trip:.0f}" for trip in trips), over])
    kind = f"SCHED_FIFO {priority} at both ends" if priority else "SCHED_OTHER"
    head = ["link", "thousand/s", "p50 µs", "p99", "p99.9", "max", "rig / it"]
    workbench.print_table(f"round trips, {load}, {kind}, medians of {ROUNDS} × {SECONDS} s", head, rows)
    assert all(ratio > LEAST_OF_C for ratio in ratios.values()), f"rig / C client: {ratios}"
