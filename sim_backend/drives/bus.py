"""Define a frame on a CAN bus and the interfaces of simulated drives and of the adapters that carry frames to them."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class Frame(NamedTuple):
    """Frame on a CAN bus.

    `extended` marks a 29-bit identifier, `remote` a request for the frame of that identifier. `error` marks a report of
    the CAN controller about the bus; its identifier is an error class of include/uapi/linux/can/error.h.
    """

    identifier: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


class DriveModel(Protocol):
    """Simulated drive with its rig, in simulated time, which passes only in `run`.

    Attributes
    ----------
    rate_hz
        Ticks a second.
    ticks
        Ticks that have passed since power-up.
    next_due
        Tick at which the drive sends its next unrequested frame; None if it sends only replies.
    """

    rate_hz: int
    ticks: int

    @property
    def next_due(self) -> int | None:
        """Return the tick of the next unrequested frame, or None."""
        ...

    def run(self, until: int) -> list[Frame]:
        """Simulate up to tick `until`; return the unrequested frames that the drive sends meanwhile."""
        ...

    def receive(self, frame: Frame) -> list[Frame]:
        """Process a frame at the present time; return the replies."""
        ...

    @property
    def events(self) -> frozenset[str]:
        """Return the names of the events that `happen` accepts."""
        ...

    def happen(self, name: str, value: float) -> list[Frame]:
        """Apply an external event to the drive; return the frames of other hosts that it puts on the bus."""
        ...


class Splitter(Protocol):
    """Splitter of a byte stream into units: lines or frames."""

    def split(self, data: bytes) -> list[bytes]:
        """Return the complete units received so far; keep the rest for the next call."""
        ...


class SimulatedAdapter(Protocol):
    """Converter between units of a byte stream (lines or binary frames) and CAN frames."""

    def splitter(self) -> Splitter:
        """Return a new splitter for the host's bytes."""
        ...

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        """Return the frame in a unit from the host (or None), and the adapter's own replies to the unit."""
        ...

    def close(self, frame: Frame) -> list[bytes]:
        """Return the units that carry a frame to the host."""
        ...
