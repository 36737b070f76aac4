"""Convert one recording to BIDS-motion: channels, rows, metadata and events.

Types follow the BIDS specification, version 1.10, "Motion". The handle of a rotary rig has one angle: an orientation
(ORNT, rad) about its axis, which is called z here. It is not a joint angle (JNTANG), which is measured between two
parts of a body in degrees. Its angular velocity has the type GYRO, the only one for that quantity in the standard (VEL
is linear); the description states that no gyrometer measured it. A linear handle has POS and VEL along its axis, called
x. Efforts, currents and the penetration into a virtual wall are MISC, because they are not motions of a body. LATENCY
contains the device's time, so that lost samples are visible.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from rig.core.deferred import csv, pyarrow
from rig.core.errors import RecordingError
from rig.core.sample import COLUMNS, Motion, Phase, RowFlag, unit_of
from rig.recording.data import Recording
from rig.recording.marks import OUTPUTS, marks

TASK = "wallhit"
TRACKSYS = "rig"
FRAME = "rig"
MISSING = "n/a"
TYPES = ("LATENCY", "ORNT", "GYRO", "POS", "VEL", "MISC")
_UNITS = {"N·m": "N.m"}  # as CMIXF-12 writes them
_SPANS: Mapping[int, str] = {
    Phase.HOMING: "homing",
    Phase.SETTLE: "settle",
    Phase.FREE: "baseline",
    Phase.TRIAL: "hit",
    Phase.RELEASE: "release",
}
_PINS = ("sync", *OUTPUTS)
_EXPORTED = ("position", "velocity", "penetration", "effort_sent", "effort_applied", "current_measured")
EVENTS: Mapping[str, str] = {
    "homing": "the motor brings the handle to the start, slowly",
    "settle": "the handle comes to rest at the start",
    "baseline": "free space before the hit: no effort, and the participant waits for the cue",
    "hit": "from the cue on: the handle may hit the wall",
    "release": "the effort of the wall fades to zero after the hit",
    "contact": "first contact with the wall, until it was first interrupted",
    "sync": "rising edge at the device's sync input",
    "trial_out": "rising edge of the device's sync output for trials: its tick began then",
    "inside_out": "rising edge of the device's sync output for contact: its tick began then",
    "verdict": "given after the recording, whose end is used as onset; response_time is counted from the question",
}


@dataclass(frozen=True, slots=True)
class Channel:
    """One column of a motion file: its row in the channels file, and its source, a column of the recording."""

    name: str
    column: str
    type: str
    component: str
    unit: str
    description: str

    def as_row(self) -> dict[str, str]:
        """Return the row of the channels file that describes this channel, in the column order of the standard."""
        return {
            "name": self.name,
            "component": self.component,
            "type": self.type,
            "tracked_point": "handle",
            "units": self.unit,
            "placement": "held in the hand",
            "reference_frame": FRAME if self.component != MISSING else MISSING,
            "description": self.description,
        }


def channels(motion: Motion, estimator: str) -> tuple[Channel, ...]:
    """Return the columns of a motion file for a rotary or linear rig; `estimator` computed the velocity."""
    rotary = motion == "rotary"
    axis = "z" if rotary else "x"
    moving = {
        "position": ("angle", "ORNT") if rotary else ("position", "POS"),
        "velocity": ("angular_velocity", "GYRO") if rotary else ("velocity", "VEL"),
    }
    more = {"velocity": f", by {estimator}{'; no gyrometer' if rotary else ''}"}
    latency = "time of the sample on the device's clock, from the first one"
    found = [Channel("latency", "", "LATENCY", MISSING, "s", latency)]
    for column in (one for one in COLUMNS if one.name in _EXPORTED):
        name, kind = moving.get(column.name, (column.name, "MISC"))
        component = axis if column.name in moving else MISSING
        text = column.description + more.get(column.name, "")
        found.append(Channel(name, column.name, kind, component, unit(unit_of(column.unit, motion)), text))
    return tuple(found)


def write_motion(file: BinaryIO, recording: Recording, columns: Sequence[Channel], every: int = 1) -> None:
    """Write a recording as a motion file: rows separated by tabs, without a header, `columns` in this order.

    Numbers have the shortest digits that read back equal. Only every n-th row is written (`every`); nothing is
    filtered.
    """
    table = {
        channel.name: _cells(
            np.char.mod("%.6f", recording.time_s[::every])
            if channel.type == "LATENCY"
            else recording.column(channel.column)[::every]
        )
        for channel in columns
    }
    options = csv.WriteOptions(include_header=False, delimiter="\t", quoting_style="none")
    csv.write_csv(pyarrow.table(table), file, options)


def sidecar(
    recording: Recording, columns: Sequence[Channel], every: int, extra: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the metadata (JSON) of a motion file, from the recording alone, with `extra` added.

    Raises `RecordingError` if the recording has no rows.
    """
    if not len(recording):
        raise RecordingError(
            f"{recording.path}: the recording has no rows", remedy="exclude this trial from the export"
        )
    experiment, identity, versions = (
        recording.experiment,
        recording.header.get("identity", {}),
        recording.header.get("versions", {}),
    )
    time = recording.time_s[::every]
    duration = float(recording.time_s[-1])
    rate = float(experiment["controller"]["position_rate"])
    counts = {name: sum(channel.type == name for channel in columns) for name in TYPES}
    channel_counts = {f"{name}ChannelCount": count for name, count in counts.items()}
    wall, motion = experiment["wall"], recording.header["motion"]
    return {
        "TaskName": TASK,
        "SamplingFrequency": rate / every,
        "SamplingFrequencyEffective": (len(time) - 1) / float(time[-1]) if time[-1] > 0.0 else MISSING,
        "RecordingDuration": duration,
        "TrackingSystemName": f"encoder of {recording.header['rig']}",
        "ManufacturersModelName": recording.header["rig"],
        "SoftwareVersions": f"haptic-rig {versions.get('haptic-rig', '?')}, firmware {identity.get('firmware', '?')}",
        "TrackedPointsCount": 1,
        "MotionChannelCount": len(columns),
        **channel_counts,
        "ACCELChannelCount": 0,
        "ANGACCELChannelCount": 0,
        "JNTANGChannelCount": 0,
        "MAGNChannelCount": 0,
        "MissingValues": MISSING,
        "SubjectArtefactDescription": MISSING,
        "Simulated": bool(identity.get("simulated", False)),
        "RecordingComplete": recording.complete and not recording.lost,
        "Decimation": every,
        "Wall": {
            **{name: wall[name] for name in ("stiffness", "damping", "position", "side")},
            "Units": {name: unit_of(name, motion) for name in ("stiffness", "damping", "position")},
        },
        "Controller": {
            name: experiment["controller"][name] for name in ("position_rate", "velocity_rate", "estimator")
        },
        **extra,
    }


class EventSpan(NamedTuple):
    """Kind, onset and duration (s; onset since the first row) of an event of a recording."""

    kind: str
    onset_s: float
    duration_s: float


def spans(recording: Recording) -> list[EventSpan]:
    """Return each phase, contact and sync edge of a recording as a span, sorted by onset."""
    time, phases = recording.time_s, recording.column("phase")
    found: list[EventSpan] = []
    if not len(time):
        return found
    period = 1.0 / float(recording.experiment["controller"]["position_rate"])
    begins = np.concatenate(([0], np.flatnonzero(np.diff(phases)) + 1))
    ends = np.append(begins[1:], len(phases))
    for first, end in zip(begins, ends, strict=True):
        name = _SPANS.get(int(phases[first]))
        if name is None:
            continue
        at, length = float(time[first]), float(time[end - 1] - time[first]) + period
        found.append(EventSpan(name, at, length))
    inside = (phases == Phase.TRIAL) & ((recording.column("flags") & int(RowFlag.INSIDE)) != 0)
    if inside.any():
        first = int(np.argmax(inside))
        outside = np.flatnonzero(~inside[first:])
        end = first + int(outside[0]) if len(outside) else len(inside)
        found.append(EventSpan("contact", float(time[first]), float(time[end - 1] - time[first]) + period))
    return sorted([*found, *_find_pin_edges(recording)], key=lambda span: span.onset_s)


def _find_pin_edges(recording: Recording) -> list[EventSpan]:
    """Return a span of duration 0 for each edge at the device's sync pins."""
    origin = int(recording.rows["device_time"][0])
    return [
        EventSpan(mark.name, (mark.device_time - origin) * 1e-9, 0.0)
        for mark in marks(recording)
        if mark.name in _PINS and mark.device_time >= origin
    ]


def frame(motion: Motion) -> dict[str, Any]:
    """Return the description of the reference frame of a rotary or linear rig, for the JSON of a channels file."""
    what = (
        "The handle turns about one axis, called z; the angle is zero at the rig's reference"
        if motion == "rotary"
        else "The handle slides along one axis, called x; the position is zero at the rig's reference"
    )
    return {
        "reference_frame": {
            "Description": "the channel's frame of reference",
            "Levels": {
                FRAME: {
                    "Description": f"{what}, and grows in the direction of a positive effort. The orientation of the "
                    "axis relative to the participant's body depends on the set-up and is not recorded. The wall "
                    "begins at Wall.position of the motion file's JSON and extends to greater values if Wall.side is 1."
                }
            },
        }
    }


def unit(text: str) -> str:
    """Convert the spelling of a unit to that of BIDS, such as N·m to N.m."""
    return _UNITS.get(text, text.replace("·", ".").replace("²", "^2"))


def _cells(values: Any) -> Any:
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        return [repr(value) if np.isfinite(value) else MISSING for value in values.tolist()]
    return values
