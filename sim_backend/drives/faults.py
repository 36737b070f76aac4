"""Parse the scripted faults of a simulated drive, such as ``drop to=host frame=12`` or ``fault value=33 tick=300``.

The first word is a `rig.devices.fault_script.FaultKind`, which acts on one unit of the line (a line of text or a CAN
frame), an event of a drive (`SimulatedMoteus.happen`, `SimulatedOdrive.happen`), ``stale`` or ``host-bus-off``.
`frame` is the number of a unit in its direction, from 0 (for an event: of a unit from the host). `tick` is the time in
milliseconds since the host's first unit. `process` and `serving` use it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from rig.core.errors import ConfigError
from rig.devices.fault_script import Direction, FaultKind, FrameFault

# stale: the drive repeats its previous answer. host-bus-off: the host's own CAN controller reports that it has left the
# bus, and nothing is transferred any more.
STALE, HOST_BUS_OFF = "stale", "host-bus-off"
EVENTS = (
    *(STALE, HOST_BUS_OFF),
    *("fault", "voltage", "temperature", "slip", "expire", "reboot", "mode", "master"),
    *("estop", "bus-off"),
)
_DIRECTIONS = {"device": Direction.TO_DEVICE, "host": Direction.TO_HOST}
_EXAMPLE = 'like "drop to=host frame=12" or "fault value=33 tick=300"'


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveEvent:
    """An event that acts on a drive just before line or frame number `frame` of the host arrives, or at `tick` (ms)."""

    name: str
    value: float = 0.0
    frame: int | None = None
    tick: int | None = None


@dataclass(frozen=True, slots=True)
class DriveScript:
    """The scripted faults of a run: faults of the line (`frames`), and events that act on the drive (`events`)."""

    frames: tuple[FrameFault, ...] = ()
    events: tuple[DriveEvent, ...] = ()

    def on_a_can_bus(self) -> DriveScript:
        """Return a copy for a CAN bus, where a frame to be damaged is dropped, because it would fail its CRC."""
        damaged = (FaultKind.CORRUPT, FaultKind.TRUNCATE)
        frames = (
            replace(fault, kind=FaultKind.DROP) if fault.kind in damaged else fault for fault in self.frames
        )
        return replace(self, frames=tuple(frames))

    def check(self, known: Iterable[str]) -> None:
        """Raise `ConfigError` if the script has an event that is not in `known`, the names of the drive's events."""
        for event in self.events:
            if event.name not in {STALE, HOST_BUS_OFF, *known}:
                raise ConfigError(
                    f"the fault {event.name!r} does not exist for this drive",
                    remedy=f"choose one of {', '.join(known)}",
                )

    @classmethod
    def of(cls, texts: Iterable[str]) -> DriveScript:
        """Return the script with one fault for each of `texts`; raise `ConfigError` for an invalid text."""
        found = [_parse_fault(text) for text in texts]
        return cls(
            frames=tuple(one for one in found if isinstance(one, FrameFault)),
            events=tuple(one for one in found if isinstance(one, DriveEvent)),
        )


def _parse_fault(text: str) -> FrameFault | DriveEvent:
    word, *rest = text.split()
    given = dict(part.partition("=")[::2] for part in rest)
    to = given.pop("to", "host")
    if ("frame" in given) == ("tick" in given) or to not in _DIRECTIONS:
        raise ConfigError(
            f"fault {text!r} must have either frame= or tick=, not both, and to= must be host or device",
            remedy=f"write it {_EXAMPLE}",
        )
    try:
        if word in {kind.value for kind in FaultKind}:
            numbers = {name: int(value) for name, value in given.items()}
            return FrameFault(kind=FaultKind(word), direction=_DIRECTIONS[to], **numbers)  # type: ignore[arg-type]
        if word in EVENTS:
            value = float(given.pop("value", "0"))
            return DriveEvent(name=word, value=value, **{name: int(when) for name, when in given.items()})
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{text!r} is not a valid fault: {error}", remedy=f"write it {_EXAMPLE}") from error
    known = ", ".join((*(kind.value for kind in FaultKind), *EVENTS))
    raise ConfigError(f"{word!r} is not the name of a fault", remedy=f"choose one of {known}, {_EXAMPLE}")
