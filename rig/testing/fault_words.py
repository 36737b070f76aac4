"""Faults on command, in words: what a test has happen to frames of the link, and to the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

from firmware_protocol.faults import Fault
from rig.core.errors import ConfigError
from rig.devices.fault_script import DeviceFault, Direction, FaultKind, Faults, FrameFault, Happening

Way = Literal["host", "device"]
KINDS = tuple(kind.value for kind in FaultKind)
DIRECTIONS: dict[str, Direction] = {"device": Direction.TO_DEVICE, "host": Direction.TO_HOST}


class FaultWords:
    """The script of faults of a test; every hit that the test makes from then on plays it from its beginning.

    Attributes
    ----------
    script
        Script so far; None while it is empty.
    """

    def __init__(self) -> None:
        self.script: Faults | None = None

    def link(
        self,
        kind: str,
        *,
        to: Way = "host",
        frame: int | None = None,
        tick: int | None = None,
        byte: int = 0,
        bit: int = 0,
        ticks: int = 1,
        both: bool = False,
    ) -> None:
        """Have something happen to one frame.

        Parameters
        ----------
        kind
            ``drop``, ``corrupt`` (`bit` of `byte` flips), ``duplicate``, ``reorder`` (it comes after the next one),
            ``truncate`` (to `byte` bytes), ``delay`` (by `ticks` ticks, with all behind it), ``silence`` (it and all
            that follow are lost, with `both` in the other direction too), ``unplug``.
        to
            To whom the frame goes.
        frame, tick
            Which: number `frame` in its direction, from 0; or the first from `tick` on, counted by the device.

        Raises
        ------
        ConfigError
            Another kind or direction, or not exactly one of `frame` and `tick`.
        """
        if (frame is None) == (tick is None):
            raise ConfigError("exactly one of frame = and tick = must be given", remedy="like frame=60")
        struck = FrameFault(
            kind=kind_of(kind),
            direction=direction_of(to),
            frame=frame,
            tick=tick,
            byte=byte,
            bit=bit,
            ticks=ticks,
            both=both,
        )
        self.add(frames=(struck,))

    def device(self, fault: str, *, tick: int) -> None:
        """Have the device find a fault of its own at a tick: a name of PROTOCOL.md, like ``ENCODER``.

        ``EMERGENCY_STOP`` presses it. Raises `ConfigError` for another name.
        """
        names = [one.name for one in Fault if one is not Fault.NONE]
        if fault not in names:
            raise ConfigError(f"unknown fault {fault!r}", remedy=f"one of {', '.join(names)}")
        self.add(device=(DeviceFault(tick, Fault[fault]),))

    def at(self, tick: int, act: Callable[[Any], None]) -> None:
        """Call a function with the simulated device at a tick: whatever else the world may do to it."""
        self.add(device=(Happening(tick, act),))

    def add(
        self, frames: tuple[FrameFault, ...] = (), device: tuple[DeviceFault | Happening, ...] = ()
    ) -> None:
        """Append faults of frames and of the device to the script."""
        before = self.script or Faults()
        self.script = replace(before, frames=before.frames + frames, device=before.device + device)


def kind_of(word: str) -> FaultKind:
    """Return the kind of fault by its word; raises `ConfigError` for an unknown one."""
    if word not in KINDS:
        raise ConfigError(f"{word!r} is not a fault of frames", remedy=f"one of {', '.join(KINDS)}")
    return FaultKind(word)


def direction_of(to: str) -> Direction:
    """Return a direction, by who receives; `ConfigError` for another."""
    if to not in DIRECTIONS:
        raise ConfigError(f"to = {to!r} is not a direction of frames", remedy="to='host' or to='device'")
    return DIRECTIONS[to]
