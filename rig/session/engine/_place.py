"""Read from a session's log on which device it takes place, and compare it with the device of a resumed session.

A session must stay on its device: limits found on two devices, or on a rig and its simulation, cannot be combined. The
engine, its commands and the analysis use it. It must not open a device.
"""

import platform
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from firmware_protocol.messages import MAJOR, MINOR
from rig.realtime.source_files import code_version
from rig.recording.header import checkout, versions
from rig.session.engine._log import Event

# Keys of an ``opened`` event that distinguish devices; a key that one of two events lacks distinguishes nothing.
_DISTINGUISHING = {"simulated": "", "device": "device", "serial_number": "serial number"}


@dataclass(frozen=True, slots=True)
class Place:
    """The device on which a session runs: its `url` (None to simulate), and if it is simulated or in real time."""

    url: str | None = None
    realtime: bool = False
    simulated: bool = True


def last_place(events: Sequence[Event]) -> Place:
    """Return the device on which a session was opened last, from the events of its log."""
    opened = last_opened(events)
    place = opened.get("place")
    if place is None:
        return Place()
    return Place(place["url"], place["realtime"], bool(opened.get("simulated", True)))


def last_opened(events: Sequence[Event]) -> Mapping[str, Any]:
    """Return what the log contains about the device that the session opened last; {} before the first one."""
    return next((event.content for event in reversed(events) if event.kind == "opened"), {})


def resume_command(directory: Path, events: Sequence[Event]) -> str:
    """Return the command line that resumes a session on the same device, with the same options that accept risks."""
    place = last_place(events)
    words = ["rig", "session", "resume", str(directory)]
    if place.url is not None:
        words += ["--url", place.url]
    if not place.simulated:
        words.append("--verified")
    if last_opened(events).get("armed_anyway"):
        words.append("--arm-anyway")
    if (last_opened(events).get("pace") or {}).get("hopeless"):
        words.append("--lossy-anyway")
    return shlex.join(words)


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Return the properties in which two opened devices differ, e.g. "serial number"; [] if they do not differ."""
    return [
        name or ("the one is simulated" if one[key] else "the other is simulated")
        for key, name in _DISTINGUISHING.items()
        if one.get(key) is not None and other.get(key) is not None and one[key] != other[key]
    ]


def device_words(opened: Mapping[str, Any]) -> str:
    """Return name, kind (simulated or real) and serial number of the device that a log describes, as text."""
    kind = "simulated" if opened.get("simulated") else "real"
    number = opened.get("serial_number")
    return f"{opened.get('device', 'unknown')} ({kind}{f', serial number {number}' if number else ''})"


def list_lost_samples(opened: Mapping[str, Any]) -> list[str]:
    """Return a list with one sentence about the samples that were lost when the device was opened; [] for none."""
    pace = opened.get("pace") or {}
    if not pace.get("said"):
        return []
    anyway = "; nearly every trial will be invalid, which the operator accepted" if pace["hopeless"] else ""
    return [pace["said"] + anyway]


@cache
def software() -> dict[str, str]:
    """Return the versions of software and operating system, by name, for the log."""
    return {
        **versions(f"{MAJOR}.{MINOR}"),
        "sources": code_version().partition("+")[2],
        "platform": platform.platform(),
        **checkout(),
    }
