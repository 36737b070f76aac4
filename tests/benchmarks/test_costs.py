"""Measure the cost of a tick by its parts, as ratios within one run; absolute times are printed."""

import time
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import Connection
from firmware_protocol.framing import encode_frame
from firmware_protocol.packing import pack
from rig import config
from rig.config import controller, presets
from rig.control.judging import recorded_signals
from rig.core.clock_fit import EXCHANGE, fit_clock
from rig.core.sample import ROW, Phase
from rig.realtime import codec
from rig.recording._timing_summary import summarise
from rig.recording.timing import ledger
from sim_backend.bare import trial
from sim_backend.mechanics.plant import DiscretePlant


def per_call(function: Any, calls: Any, repeats: int = 5) -> Any:
    """Return the shortest mean time of a call (s) over some batches."""
    best = np.inf
    for _ in range(repeats):
        started = time.perf_counter()
        for _ in range(calls):
            function()
        best = min(best, (time.perf_counter() - started) / calls)
    return best


def test_the_compiled_codec_is_far_quicker_than_the_readable_one() -> None:
    values = np.zeros(len(codec.STATE), np.int64)
    out, raw = np.zeros(codec.FRAME_BYTES, np.uint8), np.zeros(codec.RAW_BYTES, np.uint8)
    header = np.zeros(len(codec.HEAD), np.int64)

    def compiled() -> None:
        size = codec.encode_state(1, 2, values, out)
        length = codec.decode_frame(out, 0, size - 1, raw)
        codec.decode_state(raw, length, header, values)

    message = m.State(*[0] * len(codec.STATE))
    connection = Connection(m.Role.HOST)

    def readable() -> None:
        connection.receive_data(encode_frame(pack(message)))
        connection.next_event()

    fast, slow = per_call(compiled, 2000), per_call(readable, 2000)
    print(
        f"\nSTATE there and back: compiled, called from Python {1e6 * fast:.2f} µs, readable {1e6 * slow:.2f} µs"
    )
    assert fast < slow


def test_the_compiled_crc_keeps_up_with_zlib_within_a_factor_of_ten() -> None:
    data = np.random.default_rng(1).integers(0, 256, 1 << 20).astype(np.uint8)
    ours = per_call(lambda: codec.crc32(data, 0, len(data), 0), 3)
    zlibs = per_call(lambda: zlib.crc32(data), 3)
    print(f"\nCRC-32: ours {1e-9 * len(data) / ours:.2f} GB/s, zlib {1e-9 * len(data) / zlibs:.2f} GB/s")
    assert ours < 10.0 * zlibs


def test_a_trial_without_bytes_is_far_quicker_than_one_over_the_link() -> None:
    from rig.devices.device import DeviceUrl  # noqa: PLC0415
    from sim_backend.ends.link import open_link  # noqa: PLC0415

    experiment = presets.load("koul-compliant")
    model = config.rig_model(experiment)
    plant = DiscretePlant.build(model, 1.0 / experiment.controller.position_rate)

    def bare() -> Any:
        law = controller.for_experiment(experiment, current_quantum_a=0.001)
        return trial.run_trial(law, plant, 0.0, most_ticks=40_000)

    ticks = len(bare().counts)
    per_tick = per_call(bare, 1) / ticks
    link = open_link(DeviceUrl.parse("sim://"), model)
    device = link.device
    device_tick = per_call(device.tick, 5000)
    print(
        f"\none tick: {1e9 * per_tick:.0f} ns without bytes; the unarmed device alone {1e6 * device_tick:.1f} µs"
    )
    assert per_tick < device_tick


def test_the_signals_of_a_trial_cost_less_than_a_copy_of_its_rows() -> None:
    rows = np.zeros(20_000, ROW)
    rows["phase"] = Phase.TRIAL
    signals, copy = per_call(lambda: recorded_signals(rows, 5e-5, 1e-5), 10), per_call(rows.copy, 10)
    print(f"\n{len(rows)} rows: signals {1e3 * signals:.2f} ms, copy {1e3 * copy:.2f} ms")
    assert signals < copy


@pytest.mark.parametrize("what", ["clock fit", "latency ledger"])
def test_work_on_a_whole_session_grows_with_its_length_not_with_its_square(what: str) -> None:
    few, many = 2_000, 20_000

    def clock_work(count: int) -> Callable[[], object]:
        exchanges = np.zeros(count, EXCHANGE)
        waits = np.random.default_rng(1).integers(0, 20_000, (count, 2)).cumsum(axis=1)
        exchanges["host_sent"] = np.arange(count) * 100_000_000
        exchanges["device_received"] = exchanges["device_sent"] = (
            exchanges["host_sent"] + 40_000 + waits[:, 0]
        )
        exchanges["host_received"] = exchanges["host_sent"] + 100_000 + waits[:, 1]
        return lambda: fit_clock(exchanges)

    def row_work(count: int) -> Callable[[], object]:
        rows = np.zeros(50 * count, ROW)
        ticks = np.arange(len(rows))
        rows["sample_index"] = rows["tick"] = ticks
        rows["device_time"], rows["received_at"] = ticks * 100_000, ticks * 100_000 + 30_000
        rows["computed_at"], rows["sent_at"] = rows["received_at"] + 3_000, rows["received_at"] + 10_000
        rows["command_sequence"], rows["command_active"] = ticks % 65536, (ticks - 2) % 65536
        exchanges = np.zeros(2, EXCHANGE)
        for number, name in enumerate(EXCHANGE.names or ()):
            exchanges[name] = (number * 20_000, number * 20_000 + rows["device_time"][-1])
        clock = fit_clock(exchanges)
        return lambda: summarise(ledger(rows, clock, 100_000.0), None)

    made = clock_work if what == "clock fit" else row_work
    short, long = (per_call(made(count), 1) for count in (few, many))
    print(f"\n{what}: {1e3 * short:.1f} ms, ten times as long {1e3 * long:.1f} ms")
    assert long < 30.0 * short  # ten times; its square is a hundred
