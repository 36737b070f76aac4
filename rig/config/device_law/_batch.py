"""Compute layout and size of BATCH frames, in which a device that runs the law sends the samples of several ticks."""

import math
import struct

from firmware_protocol import messages
from firmware_protocol.framing import RAW_LIMIT
from firmware_protocol.messages import BATCH_LAYOUTS
from firmware_protocol.packing import encoded_bytes
from rig.config._sections import Experiment
from rig.control.on_device import refusal

# Time between two State messages of a device that runs the law (s).
STATE_EVERY_S = 0.005
# A sample waits in the device for at most this time until its frame is full (s).
LONGEST_FRAME_S = 0.005
# In a single tick the handle may pass more counts than its mean speed at the limit would give.
MARGIN = 2.0

FULL, WITHOUT_MEASURED, WIDE = 0, 1, 2  # layouts: what each holds stands in BATCH_LAYOUTS
_I8_GREATEST, _I16_GREATEST = 127, 32_767
_FORMATS = {"i8": "b", "i16": "h"}


def counts_in_a_tick(experiment: Experiment) -> float:
    """Return how many encoder counts the handle passes in one tick at the speed limit `rig.limits.speed`."""
    return experiment.rig.limits.speed / (
        experiment.rig.encoder.resolution * experiment.controller.position_rate
    )


def batch_layout(experiment: Experiment) -> int:
    """Return the number of the layout of BATCH frames, an index of `BATCH_LAYOUTS`.

    Count differences between two samples take one byte if the speed limit allows it, else two. Raise `PlanError` if two
    bytes are not enough either.
    """
    counts = MARGIN * counts_in_a_tick(experiment) + 1.0
    if counts > _I16_GREATEST:
        raise refusal(
            "rig.limits.speed",
            experiment.rig.limits.speed,
            f"the handle may move by {counts:.0f} counts in a tick, more than a BATCH frame can contain",
            "lower rig.limits.speed, or raise controller.position_rate",
        )
    if counts > _I8_GREATEST:
        return WIDE
    return FULL if experiment.controller.measured_current else WITHOUT_MEASURED


def sample_bytes(layout: int) -> int:
    """Return the size (bytes) of one sample in a BATCH frame with this layout, an index of `BATCH_LAYOUTS`."""
    return struct.calcsize("<" + "".join(_FORMATS[kind] for kind in BATCH_LAYOUTS[layout] if kind))


def batch_samples(experiment: Experiment) -> int:
    """Return the number of samples in one BATCH frame: as many as fit, but no more than the device takes in 5 ms."""
    room = RAW_LIMIT - _overhead()
    fitting = room // sample_bytes(batch_layout(experiment))
    in_time = math.floor(LONGEST_FRAME_S * experiment.controller.position_rate)
    return max(1, min(fitting, in_time))


def bytes_per_second(experiment: Experiment) -> float:
    """Return the bytes per second that a device sends while it runs the law: frames of samples, and its state."""
    samples, rate = batch_samples(experiment), experiment.controller.position_rate
    raw = _overhead() + samples * sample_bytes(batch_layout(experiment))
    # COBS adds one byte to a frame below 254 bytes, and the delimiter is another byte.
    stuffed = raw + 2
    return rate / samples * stuffed + encoded_bytes(messages.State) / STATE_EVERY_S


def _overhead() -> int:
    """Return the size (bytes) of a BATCH frame without samples, before byte stuffing."""
    return encoded_bytes(messages.Batch) - 2
