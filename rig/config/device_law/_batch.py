"""Frames in which a device that runs the law sends its samples: layout, samples per frame, bytes per second."""

from __future__ import annotations

import math
import struct

from firmware_protocol import messages
from firmware_protocol.framing import RAW_LIMIT
from firmware_protocol.messages import BATCH_LAYOUTS
from firmware_protocol.packing import encoded_bytes
from rig.config._sections import Experiment
from rig.control.on_device import refusal

STATE_EVERY_S = 0.005  # between two STATEs of a device that is supervised
LONGEST_FRAME_S = 0.005  # what a frame may hold back
MARGIN = 2.0  # a handle may pass more counts in one tick than its mean speed limit says

FULL, WITHOUT_MEASURED, WIDE = 0, 1, 2  # layouts: what each holds stands in BATCH_LAYOUTS
_I8_GREATEST, _I16_GREATEST = 127, 32_767
_FORMATS = {"i8": "b", "i16": "h"}


def counts_in_a_tick(experiment: Experiment) -> float:
    """Return the number of counts that the handle passes in a tick at the speed limit of the guard."""
    return experiment.rig.limits.speed / (
        experiment.rig.encoder.resolution * experiment.controller.position_rate
    )


def batch_layout(experiment: Experiment) -> int:
    """Return the layout of a BATCH: count differences in one byte if the speed limit allows it, else in two bytes.

    Raise `PlanError` if two bytes are not enough either.
    """
    counts = MARGIN * counts_in_a_tick(experiment) + 1.0
    if counts > _I16_GREATEST:
        raise refusal(
            "rig.limits.speed",
            experiment.rig.limits.speed,
            f"the handle may move by {counts:.0f} counts in a tick, more than a BATCH can carry",
            "lower rig.limits.speed, or raise controller.position_rate",
        )
    if counts > _I8_GREATEST:
        return WIDE
    return FULL if experiment.controller.measured_current else WITHOUT_MEASURED


def sample_bytes(layout: int) -> int:
    """Return the size of one sample in a layout (bytes)."""
    return struct.calcsize("<" + "".join(_FORMATS[kind] for kind in BATCH_LAYOUTS[layout] if kind))


def batch_samples(experiment: Experiment) -> int:
    """Return the samples per frame: as many as fit, of at most `LONGEST_FRAME_S` in total, but at least one."""
    room = RAW_LIMIT - _overhead()
    fitting = room // sample_bytes(batch_layout(experiment))
    in_time = math.floor(LONGEST_FRAME_S * experiment.controller.position_rate)
    return max(1, min(fitting, in_time))


def bytes_per_second(experiment: Experiment) -> float:
    """Return the data rate of a device that runs the law (bytes/s): BATCH frames with every tick, and STATEs."""
    samples, rate = batch_samples(experiment), experiment.controller.position_rate
    raw = _overhead() + samples * sample_bytes(batch_layout(experiment))
    stuffed = raw + 2  # one byte of COBS for a frame below 254 bytes, and the delimiter
    return rate / samples * stuffed + encoded_bytes(messages.State) / STATE_EVERY_S


def _overhead() -> int:
    """Return the size of a raw BATCH without samples (bytes)."""
    return encoded_bytes(messages.Batch) - 2
