"""A script of faults: what happens to frame n of a direction of a link, and to the device at tick n.

A simulation plays it (`rig.devices.open_watched`). A test that runs it for every n of a short run has seen every place
where a link can break.

It has what happens on USB and serial lines: noise (corrupt), full buffers (drop, truncate), retries of a hub
(duplicate, delay), a dead cable (silence), a pulled plug.

`rig.testing` writes such scripts. Nothing here breaks a link itself, and a real device has no script.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from firmware_protocol.faults import Fault


class Direction(Enum):
    """Which way the bytes go."""

    TO_DEVICE = "to device"
    TO_HOST = "to host"

    # Enum's own hash is written in Python, and a simulated line looks up six members for each frame.
    __hash__ = object.__hash__


class FaultKind(Enum):
    """What can happen to a frame."""

    DROP = "drop"
    CORRUPT = "corrupt"  # bit `bit` of byte `byte` flips; a 0x00 may appear or vanish
    DUPLICATE = "duplicate"
    REORDER = "reorder"  # it comes after the next frame of its direction
    # only its first `byte` bytes come, without a delimiter: it runs into the next frame
    TRUNCATE = "truncate"
    DELAY = "delay"  # it, and all behind it, wait for `ticks` ticks
    SILENCE = "silence"  # it and all that follow are lost
    UNPLUG = "unplug"  # the line is gone in both directions, and both ends are notified


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFault:
    """What happens to a frame of a direction: number `frame` (from 0), or the first that is sent from `tick` on.

    Ticks are those of the device since the link was opened; `byte` is taken modulo the frame's length.
    """

    kind: FaultKind
    direction: Direction
    frame: int | None = None
    tick: int | None = None
    byte: int = 0
    bit: int = 0
    ticks: int = 1
    both: bool = False  # SILENCE: in the other direction as well


@dataclass(frozen=True, slots=True)
class DeviceFault:
    """A fault that the device finds when `tick` ticks have passed; EMERGENCY_STOP means that it is pressed."""

    tick: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class Happening:
    """What the world does to a device when `tick` ticks have passed: `act` is called with the device."""

    tick: int
    act: Callable[[Any], None]


@dataclass(frozen=True, slots=True)
class Faults:
    """A script for one run."""

    frames: tuple[FrameFault, ...] = ()
    device: tuple[DeviceFault | Happening, ...] = ()
