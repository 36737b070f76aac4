"""Measure how many ticks of a law on the device this computer can follow; 20 and 50 kHz must arrive without a gap.

A process sends prepared frames: over a socket pair as fast as they are read, which shows the limit of the loop, and
over a pseudo-terminal at the device's rate, like a driver with a small buffer. Figures are printed; only what does not
depend on the load is asserted.
"""

import multiprocessing
import os
import socket
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.framing import encode_frame
from firmware_protocol.packing import pack, pack_batch_samples
from rig.config import presets
from rig.config._sections import Host
from rig.config.controller import for_experiment
from rig.loop._run import LoopSettings
from rig.loop._supervised import SupervisedThread
from rig.realtime.ring import Ring
from tests.benchmarks.realtime.workbench import CURRENT_QUANTUM_A, FULL, SESSION, descriptor_link, obtained

SAMPLES = 45  # in a frame
STATES_A_SECOND = 200
RATES = (20_000, 50_000)
SECONDS = 10 if FULL else 2
BURST = 400_000  # samples as fast as they are taken
WAIT_S = 120.0


def stream(rate: int, samples: int) -> list[bytes]:
    """Return the frames of this many samples of a moving handle, with STATEs at the rate of a device."""
    counts = np.rint(20.0 * np.sin(np.arange(samples) / 300.0)).astype(int)
    moved = np.diff(counts, prepend=counts[0]).tolist()
    every = max(1, rate // STATES_A_SECOND // SAMPLES)
    frames = []
    for number, first in enumerate(range(0, samples, SAMPLES)):
        time_units = first * 16_000_000 // rate % 2**32
        packed = pack_batch_samples(0, [(step, 0, 0) for step in moved[first : first + SAMPLES]])
        base = int(counts[first]) - moved[first]
        batch = m.Batch(first, time_units, base, 0, packed)
        frame = encode_frame(pack(batch, session=SESSION, sequence=number % 65536))
        if number % every == 0:
            state = m.State(0, 0, first, time_units, 0, 0, 0, 0, 0, 0, 0, 0, int(State.RUNNING), 0, 3, 0)
            frame += encode_frame(pack(state, session=SESSION, sequence=number // every % 65536))
        frames.append(frame)
    return frames


def play(descriptor: int, frames: list[bytes], period_s: float, pipe: Any) -> None:
    """Write one frame per period (0: as fast as they are read); a frame that finds no space is dropped."""
    os.set_blocking(descriptor, period_s == 0.0)
    dropped = 0
    started = time.monotonic()
    for number, frame in enumerate(frames):
        due = started + number * period_s
        while (left := due - time.monotonic()) > 0.0:
            time.sleep(left)
        rest = memoryview(frame)
        try:
            while rest:
                rest = rest[os.write(descriptor, rest) :]
        except BlockingIOError:  # torn frames are lost too
            dropped += 1
    pipe.send(dropped)
    pipe.recv()  # hold the line open until everything was taken


@contextmanager
def socket_pair() -> Iterator[tuple[int, int]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield ours.fileno(), theirs.fileno()


@contextmanager
def terminal() -> Iterator[tuple[int, int]]:
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        tty.setraw(master)
        yield slave, master
    finally:
        os.close(master)
        os.close(slave)


def followed(link: Any, frames: list[bytes], samples: int, rate: int, period_s: float) -> dict[str, Any]:
    """Follow a stream to its end; return the loop's counters, seconds, processor time and dropped frames."""
    law = for_experiment(presets.load("koul-rigid"), current_quantum_a=CURRENT_QUANTUM_A)
    for name, value in {"home_target": 0.0, "settle_ticks": 0, "trial_ticks": 1 << 40}.items():
        law.control[name] = value
    settings = LoopSettings(
        period_ns=10**9 // rate, session=SESSION, lifetime_us=20_000, lost_after_ns=500_000_000,
        device_tick_ps=62_500, current_quantum_a=CURRENT_QUANTUM_A, wait_for_room=False,
        supervise_every_ns=5_000_000, batch_samples=SAMPLES, agreement_quanta=1,
    )  # fmt: skip
    memory = Ring.allocate(samples + 1)
    with link() as (ours, theirs):
        pipe, far = multiprocessing.get_context("fork").Pipe()
        player = multiprocessing.get_context("fork").Process(
            target=play, args=(theirs, frames, period_s, far), daemon=True
        )
        player.start()  # before there is a second thread here
        os.set_blocking(ours, False)
        with obtained(Host(), virtual=False) as realtime:
            thread = SupervisedThread(descriptor_link(ours), law, settings, memory, realtime=realtime)
            before = time.process_time()
            thread.start()
            thread.wait()
            used = time.process_time() - before
        dropped = pipe.recv() if pipe.poll(1.0) else None
        pipe.send("enough")
        player.join(WAIT_S)
    end = thread.end()
    rows = memory.rows[: end.counters["ticks"]]
    took = (int(rows["received_at"][-1]) - int(rows["received_at"][0])) * 1e-9
    assert (np.diff(rows["sample_index"]) == rows["elapsed_ticks"][1:]).all()
    return {**end.counters, "took_s": took, "used_s": used, "dropped": dropped}


def test_as_fast_as_frames_are_taken() -> None:
    found = followed(socket_pair, stream(50_000, BURST), BURST, 50_000, 0.0)
    rows = found["ticks"]
    print(
        f"\n{rows} rows in {found['took_s']:.2f} s: {rows / found['took_s']:.3g} rows/s; "
        f"{1e9 * found['used_s'] / rows:.0f} ns of processor time each"
    )
    assert (rows, found["lost"], found["bad_frames"]) == (BURST, 0, 0)
    assert found["took_s"] < BURST / 50_000, "faster than a device that ticks at 50 kHz"


@pytest.mark.parametrize("rate", RATES)
def test_on_the_devices_grid_over_a_pseudo_terminal(rate: int) -> None:
    samples = SECONDS * rate
    found = followed(terminal, stream(rate, samples), samples, rate, SAMPLES / rate)
    share = found["used_s"] / found["took_s"]
    print(
        f"\n{rate} Hz for {found['took_s']:.2f} s: {found['ticks']} rows, {found['lost']} samples lost, "
        f"{found['dropped']} frames found no room, {100 * share:.0f} % of a processor"
    )
    assert found["ticks"] + found["lost"] <= samples
    if found["dropped"] == 0:
        assert (found["ticks"], found["lost"]) == (samples, 0)
