"""Script of faults for a simulated run: faults of single frames of a link, and faults of the device at given ticks.

A simulation executes it (`rig.devices.open_watched`). A test that runs it for every frame of a short run covers every
moment at which a link can break.

The faults are those of USB and serial lines: noise (corrupt), full buffers (drop, truncate), retries of a hub
(duplicate, delay), a dead cable (silence), a pulled plug.

`rig.testing` writes such scripts. Nothing here breaks a link itself, and a real device has no script.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from firmware_protocol.faults import Fault


class Direction(Enum):
    """Direction of a frame on a link: to the device or to the host."""

    TO_DEVICE = "to device"
    TO_HOST = "to host"

    # Enum's own hash is written in Python, and a simulated line looks up six members for each frame.
    __hash__ = object.__hash__


class FaultKind(Enum):
    """Kind of a simulated fault of one frame on a link."""

    DROP = "drop"
    CORRUPT = "corrupt"  # bit `bit` of byte `byte` flips; a 0x00 may appear or vanish
    DUPLICATE = "duplicate"
    REORDER = "reorder"  # delivered after the next frame of its direction
    # only its first `byte` bytes come, without a delimiter: it runs into the next frame
    TRUNCATE = "truncate"
    DELAY = "delay"  # it, and all behind it, wait for `ticks` ticks
    SILENCE = "silence"  # this frame and all later ones are lost
    UNPLUG = "unplug"  # the line is gone in both directions, and both ends are notified


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFault:
    """Simulated fault of frame number `frame` (from 0) in one direction, or of the first frame sent at or after `tick`.

    `tick` counts device ticks since the link was opened; `byte` is taken modulo the frame's length.
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
    """Fault that a simulated device detects after `tick` ticks; EMERGENCY_STOP means that the button is pressed."""

    tick: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class Happening:
    """Action in a simulated run: after `tick` device ticks, the function `act` is called with the simulated device."""

    tick: int
    act: Callable[[Any], None]


@dataclass(frozen=True, slots=True)
class Faults:
    """Script of all simulated faults in one run: faults of single frames, and faults of the device."""

    frames: tuple[FrameFault, ...] = ()
    device: tuple[DeviceFault | Happening, ...] = ()
