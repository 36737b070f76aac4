"""Script faults of frames and of the simulated device, for a test.

The fixture ``rig_faults`` returns it. A script must not be used on a real rig.
"""

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
    """Script of faults for a test; every later run of the test applies them, counted from the start of the run.

    Attributes
    ----------
    script
        Faults so far; None if the script is empty.
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
        """Add a fault of one frame to the script.

        Raise `ConfigError` if the kind or the direction is unknown, or `frame` and `tick` are both given or both
        missing.

        Parameters
        ----------
        kind
            ``drop``, ``corrupt`` (`bit` of `byte` flips), ``duplicate``, ``reorder`` (swapped with the next frame),
            ``truncate`` (to `byte` bytes), ``delay`` (this and all later frames, by `ticks` ticks), ``silence`` (this
            and all later frames are lost; with `both`, in both directions), or ``unplug``.
        to
            Receiver of the frame: ``host`` or ``device``.
        frame, tick
            Either the number of the frame in its direction, from 0; or a tick of the device: the first frame from this
            tick on is faulty.
        """
        if (frame is None) == (tick is None):
            raise ConfigError(
                "exactly one of frame = and tick = must be given", remedy="give one, like frame=60"
            )
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
        """Add to the script a fault that the device detects at tick `tick`; `fault` is its name, such as ``ENCODER``.

        ``EMERGENCY_STOP`` simulates that the emergency stop is pressed. Raise `ConfigError` for an unknown name.
        """
        names = [one.name for one in Fault if one is not Fault.NONE]
        if fault not in names:
            raise ConfigError(f"unknown fault {fault!r}", remedy=f"choose one of: {', '.join(names)}")
        self.add(device=(DeviceFault(tick, Fault[fault]),))

    def at(self, tick: int, act: Callable[[Any], None]) -> None:
        """Add a function `act` to the script, which is called with the simulated device as argument at tick `tick`."""
        self.add(device=(Happening(tick, act),))

    def add(
        self, frames: tuple[FrameFault, ...] = (), device: tuple[DeviceFault | Happening, ...] = ()
    ) -> None:
        """Append faults of frames and of the device to the script."""
        before = self.script or Faults()
        self.script = replace(before, frames=before.frames + frames, device=before.device + device)


def kind_of(word: str) -> FaultKind:
    """Return the kind of frame fault with this name, such as ``drop``; raise `ConfigError` for an unknown name."""
    if word not in KINDS:
        raise ConfigError(f"{word!r} is not a fault of frames", remedy=f"choose one of: {', '.join(KINDS)}")
    return FaultKind(word)


def direction_of(to: str) -> Direction:
    """Return the direction of frames to the receiver ``host`` or ``device``; raise `ConfigError` for another text."""
    if to not in DIRECTIONS:
        raise ConfigError(f"to = {to!r} is not a direction of frames", remedy="give to='host' or to='device'")
    return DIRECTIONS[to]
