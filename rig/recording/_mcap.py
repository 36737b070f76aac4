"""Export of a recording as MCAP, the log format of robotics that Foxglove, PlotJuggler and rosbag2 read.

The topic ``/rig/rows`` has one JSON message per row with all columns by name; ``/rig/marks`` has one per event (see
`rig.recording.marks`). The JSON schema of each topic contains units and meanings; the metadata ``recording`` contains
header and trailer.

The time of a message is the creation time of the recording plus the time since its first row on the device's clock, or
on the host's clock if the device's was not recorded. NaN and infinities are null, because JSON lacks them.

`rig.recording.export` calls it.

Source: MCAP format specification (mcap.dev/spec) through the package ``mcap``; "well-known" encodings json, jsonschema.
"""

import json
import math
from datetime import datetime
from typing import Any, BinaryIO

import numpy as np

from rig.core.deferred import mcap
from rig.core.errors import RigError
from rig.recording.canonical import canonical_json
from rig.recording.data import Recording
from rig.recording.marks import marks

ROWS, MARKS = "/rig/rows", "/rig/marks"
_MARK_SCHEMA = {
    "name": {"type": "string", "description": "what happened"},
    "tick": {"type": "integer", "description": "number of the step of the law"},
    "host_time": {"type": ["integer", "null"], "description": "host's clock", "unit": "ns"},
}


def write_mcap(file: BinaryIO, recording: Recording) -> None:
    """Write a recording to `file` as MCAP; raise `RigError` if the package ``mcap`` is not installed."""
    try:
        writer = mcap.Writer(file)
    except ImportError as error:
        raise RigError(
            "mcap is not installed", remedy="install it: pip install 'haptic-rig[mcap]'"
        ) from error
    writer.start(library="haptic-rig")
    facts = {"header": recording.header, "trailer": recording.trailer, "complete": recording.complete}
    writer.add_metadata("recording", {name: canonical_json(part).decode() for name, part in facts.items()})
    began_ns = int(datetime.fromisoformat(recording.header["created"]).timestamp() * 1e9)
    rows, happened = _channel(writer, ROWS, _columns(recording)), _channel(writer, MARKS, _MARK_SCHEMA)
    times = np.maximum(np.rint(recording.time_s * 1e9).astype(np.int64) + began_ns, 0)
    for number, (time_ns, values) in enumerate(zip(times.tolist(), recording.rows.tolist(), strict=True)):
        message = dict(zip(recording.names, map(_number, values), strict=True))
        writer.add_message(rows, time_ns, _json(message), time_ns, number)
    for mark in marks(recording) if len(recording) else ():
        time_ns = max(0, began_ns + mark.device_time - int(recording.rows["device_time"][0]))
        content = {"name": mark.name, "tick": mark.tick, "host_time": mark.host_time}
        writer.add_message(happened, time_ns, _json(content), time_ns)
    writer.finish()


def _channel(writer: Any, topic: str, properties: dict[str, Any]) -> int:
    """Register a topic whose messages are JSON objects with these properties; return the number of its channel."""
    schema = {"type": "object", "properties": properties}
    number = writer.register_schema(topic.removeprefix("/").replace("/", "."), "jsonschema", _json(schema))
    return int(writer.register_channel(topic, "json", number))


def _columns(recording: Recording) -> dict[str, Any]:
    return {
        name: {
            "type": "integer" if recording.rows.dtype[name].kind in "iu" else ["number", "null"],
            "description": recording.descriptions[name],
            "unit": recording.units[name],
        }
        for name in recording.names
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _json(content: Any) -> bytes:
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode()
