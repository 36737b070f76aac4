"""Batches of samples of a law on the device: layout by speed and rate, frames in time, and their bytes."""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.framing import RAW_LIMIT, encode_frame
from firmware_protocol.law_parameters import LAW_PARAMETERS
from firmware_protocol.packing import pack
from rig import config
from rig.config import presets
from rig.config.device_law import _batch as batch
from rig.core.errors import PlanError

RIGID = config.override(presets.load("koul-rigid"), {"controller.loop": "device"})
SAMPLES = next(parameter for parameter in LAW_PARAMETERS if parameter.name == "batch_samples")


def at(rate: int, **changes: object) -> config.Experiment:
    rates = {"controller.position_rate": rate, "controller.velocity_rate": rate}
    return config.override(RIGID, rates | changes)


def frame_bytes(x: config.Experiment, samples: int) -> int:
    kinds = {"i8": "b", "i16": "h"}
    one = struct.calcsize("<" + "".join(kinds[kind] for kind in m.BATCH_LAYOUTS[batch.batch_layout(x)]))
    raw = pack(m.Batch(0, 0, 0, batch.batch_layout(x), bytes(samples * one)))
    return len(encode_frame(raw))


@pytest.mark.parametrize(
    ("rate", "layout", "samples"), [(1_000, batch.WIDE, 5), (5_000, batch.FULL, 25), (20_000, batch.FULL, 45)]
)
def test_layout_and_samples_follow_rate_and_speed(rate: int, layout: Any, samples: int) -> None:
    """At 10 rad/s and 1.57e-4 rad per count, 63,662 counts pass in a second."""
    assert batch.batch_layout(at(rate)) == layout
    assert batch.batch_samples(at(rate)) == samples


@given(st.integers(1000, 50_000), st.booleans(), st.floats(0.5, 500.0))
def test_no_frame_is_late_too_long_or_out_of_range(rate: int, measured: bool, speed: float) -> None:
    x = at(rate, **{"controller.measured_current": measured, "rig.limits.speed": speed})
    samples = batch.batch_samples(x)
    assert SAMPLES.accepts(samples)
    assert samples / rate <= max(batch.LONGEST_FRAME_S, 1.0 / rate)
    stuffed = frame_bytes(x, samples)
    assert stuffed <= RAW_LIMIT + 2
    states = 200 * 51
    assert batch.bytes_per_second(x) == pytest.approx(stuffed * rate / samples + states)
    if batch.batch_layout(x) != batch.WIDE:
        assert batch.MARGIN * batch.counts_in_a_tick(x) < 127


def test_a_handle_too_fast_for_any_layout_is_refused() -> None:
    with pytest.raises(PlanError, match=r"rig.limits.speed = 500.*may move by 127325 counts") as refused:
        batch.batch_layout(at(50, **{"rig.limits.speed": 500.0}))
    assert "position_rate" in refused.value.remedy


def test_twenty_kilohertz_fit_three_megabaud_and_fifty_full_speed_usb() -> None:
    assert batch.bytes_per_second(at(20_000)) < 0.7 * 300_000
    assert batch.bytes_per_second(at(50_000)) > 0.7 * 300_000
    assert batch.bytes_per_second(at(50_000, **{"controller.measured_current": False})) < 0.7 * 300_000
    assert batch.bytes_per_second(at(50_000)) < 1_000_000
