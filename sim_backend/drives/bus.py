"""Define a frame on a CAN bus, and the interfaces of simulated drives and of the adapters that carry frames to them.

All files of this package use it. It must not know a particular drive or adapter.
"""

from typing import NamedTuple, Protocol


class Frame(NamedTuple):
    """A frame on a CAN bus: identifier and data bytes.

    `extended` marks a 29-bit identifier, `remote` a request for the frame of that identifier. `error` marks a report of
    the CAN controller about the bus; its identifier is an error class of include/uapi/linux/can/error.h.
    """

    identifier: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


class DriveModel(Protocol):
    """A simulated drive with its rig, in simulated time, which passes only in `run`.

    Attributes
    ----------
    rate_hz
        Ticks of the drive in a second (Hz).
    ticks
        Number of ticks since power-up.
    next_due
        Tick at which the drive sends its next unrequested frame; None if it sends only replies.
    """

    rate_hz: int
    ticks: int

    @property
    def next_due(self) -> int | None:
        """Return the tick of the next frame that the drive sends without a request, None without such frames."""
        ...

    def run(self, until: int) -> list[Frame]:
        """Simulate the drive up to tick `until`; return the frames that it sends meanwhile without a request."""
        ...

    def receive(self, frame: Frame) -> list[Frame]:
        """Process a frame from the bus at the present time; return the drive's replies."""
        ...

    @property
    def events(self) -> frozenset[str]:
        """Return the names of the external events that `happen` accepts."""
        ...

    def happen(self, name: str, value: float) -> list[Frame]:
        """Apply an external event to the drive by name; return the frames that the event puts on the bus."""
        ...


class Splitter(Protocol):
    """A splitter of a byte stream into units: each is a line of text or a binary frame."""

    def split(self, data: bytes) -> list[bytes]:
        """Return the lines or binary frames that are complete after `data`, oldest first; store an incomplete one."""
        ...


class SimulatedAdapter(Protocol):
    """A converter between units of a byte stream (lines or binary frames) and CAN frames."""

    def splitter(self) -> Splitter:
        """Return a new splitter for the bytes that the host sends."""
        ...

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        """Return the CAN frame in a line or binary frame of the host (else None), and the adapter's own replies."""
        ...

    def close(self, frame: Frame) -> list[bytes]:
        """Return the lines or binary frames of the byte stream that carry a CAN frame to the host."""
        ...
