"""What a tick costs where, as ratios measured side by side in one run; absolute times are printed."""

import time
import zlib
from typing import Any

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.connection import Connection
from firmware_protocol.framing import encode_frame
from firmware_protocol.packing import pack
from rig import config
from rig.config import controller, presets
from rig.realtime import codec
from sim_backend import trial
from sim_backend.plant import DiscretePlant


def per_call(function: Any, calls: Any, repeats: int = 5) -> Any:
    """Shortest time of a call (s) over some batches."""
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
    from sim_backend.link import open_link  # noqa: PLC0415

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
