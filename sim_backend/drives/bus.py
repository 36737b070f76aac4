"""A frame on a CAN bus, and what every simulated drive is to those that carry frames to it."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class Frame(NamedTuple):
    """Identifier and data.

    `extended` is the 29-bit form, `remote` a request for the frame of that identifier, `error` what a controller says
    of the bus, by the classes of include/uapi/linux/can/error.h in place of an identifier.
    """

    identifier: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


class DriveModel(Protocol):
    """A drive with its rig, in its own time: it moves only in `run`.

    Attributes
    ----------
    rate_hz
        Ticks a second.
    ticks
        Ticks that have passed since power-up.
    next_due
        Tick at which it will send a frame by itself; None when it never does.
    """

    rate_hz: int
    ticks: int

    @property
    def next_due(self) -> int | None:
        """Return when it will send a frame by itself (ticks)."""
        ...

    def run(self, until: int) -> list[Frame]:
        """Let time pass to a tick; what it sends by itself meanwhile."""
        ...

    def receive(self, frame: Frame) -> list[Frame]:
        """Take a frame, now; its answers."""
        ...

    @property
    def events(self) -> frozenset[str]:
        """Return the names of the events that `happen` accepts."""
        ...

    def happen(self, name: str, value: float) -> list[Frame]:
        """Let the world do something to it; frames of others that this puts on the bus."""
        ...


class Splitter(Protocol):
    """Cuts bytes into units: a line, a frame."""

    def split(self, data: bytes) -> list[bytes]:
        """Return whole units of what has come; the rest waits."""
        ...


class SimulatedAdapter(Protocol):
    """Units of a line to and from frames."""

    def splitter(self) -> Splitter:
        """Make what cuts its bytes into units."""
        ...

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        """Return the frame in a unit of the host, and the adapter's own answers to it."""
        ...

    def close(self, frame: Frame) -> list[bytes]:
        """Return units that carry a frame to the host."""
        ...
