"""The two LSL outlets (network streams): samples as numbers with units, and markers as one JSON text each."""

import json
import platform
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.sample import COLUMNS, Motion, unit_of
from rig.extras.lsl.follow import Marker
from rig.extras.lsl.library import ClockOffset

CHANNELS = ("position", "velocity", "penetration", "effort_sent", "effort_applied", "phase")
_COLUMNS = {column.name: column for column in COLUMNS}
BUFFERED_S = 60  # what a receiver that reads slowly may fall behind (s)


class SampleStream:
    """LSL outlet of the samples, named ``NAME samples``.

    `name` is also part of the source id, by which receivers find the stream again; `motion` decides the units of the
    channels; `rate` and `position_rate` are samples and rows a second (Hz); `offset` is from the host's clock to LSL's.
    """

    def __init__(
        self, pylsl: Any, name: str, motion: Motion, rate: float, position_rate: float, offset: ClockOffset
    ) -> None:
        info = pylsl.StreamInfo(
            f"{name} samples", "Haptics", len(CHANNELS), rate, pylsl.cf_double64, _source(name, "samples")
        )
        description = info.desc()
        channels = description.append_child("channels")
        for channel in CHANNELS:
            column = _COLUMNS[channel]
            element = channels.append_child("channel")
            element.append_child_value("label", channel)
            element.append_child_value("unit", unit_of(column.unit, motion))
            element.append_child_value("type", column.unit)
            element.append_child_value("description", column.description)
        sampling = description.append_child("sampling")
        sampling.append_child_value("rate", repr(rate))
        sampling.append_child_value("position_rate", repr(position_rate))
        sampling.append_child_value("decimation", "every n-th row, unfiltered")
        _describe_clock(description, offset)
        self.rate = rate
        self.motion = motion
        self._offset_s = offset.offset_s
        self._last_s = 0.0
        self._outlet = pylsl.StreamOutlet(info, max_buffered=BUFFERED_S)

    def begin(self) -> None:
        """Accept earlier times again, because another loop begins."""
        self._last_s = 0.0

    def push(self, rows: NDArray[np.void], times_ns: NDArray[np.int64]) -> None:
        """Send rows, each with its host time (ns); a time before the last sent one is replaced by the last sent one."""
        if not len(rows):
            return
        stamps = np.maximum.accumulate(np.maximum(times_ns * 1e-9 + self._offset_s, self._last_s))
        self._last_s = float(stamps[-1])
        values = np.stack([rows[name].astype(np.float64) for name in CHANNELS], axis=1)
        self._outlet.push_chunk(values, stamps.tolist())


class MarkerStream:
    """LSL outlet of the markers, named ``NAME markers``: one text for each marker, at irregular times."""

    def __init__(self, pylsl: Any, name: str, offset: ClockOffset) -> None:
        info = pylsl.StreamInfo(
            f"{name} markers", "Markers", 1, 0.0, pylsl.cf_string, _source(name, "markers")
        )
        _describe_clock(info.desc(), offset)
        self._offset_s = offset.offset_s
        self._outlet = pylsl.StreamOutlet(info, max_buffered=BUFFERED_S)

    def push(self, markers: Sequence[Marker]) -> None:
        """Send markers, each with its own host time."""
        for marker in markers:
            text = json.dumps(marker.content, ensure_ascii=False)
            self._outlet.push_sample([text], marker.time_ns * 1e-9 + self._offset_s)


def _source(name: str, kind: str) -> str:
    return f"haptic-rig/{platform.node()}/{name}/{kind}"


def _describe_clock(description: Any, offset: ClockOffset) -> None:
    clock = description.append_child("clock")
    clock.append_child_value("source", "sample time on the host's CLOCK_MONOTONIC, by the clock fit")
    clock.append_child_value("offset_s", repr(offset.offset_s))
    clock.append_child_value("offset_uncertainty_s", repr(offset.uncertainty_s))
