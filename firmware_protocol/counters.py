"""Counters of the frames that one end of a link received or dropped. Every dropped frame increments one counter.

`Connection` and `FrameSplitter` count with it. A counter must not be reset while its connection lives.
"""

from dataclasses import dataclass


@dataclass(slots=True)
class LinkStatistics:
    """Counters of the frames that a connection received or dropped since it was created; they never decrease."""

    frames: int = 0  # frames with a good CRC
    cobs_errors: int = 0  # byte stuffing that does not add up
    crc_errors: int = 0  # frames whose CRC is wrong
    too_long: int = 0  # frames above the limit of their class, and bytes without an end
    too_short: int = 0  # frames without room for header and CRC
    malformed: int = 0  # good CRC, but a payload that its type cannot have
    unknown_type: int = 0  # types of a newer minor version
    wrong_direction: int = 0  # our own kind of message coming back: an echo
    foreign_major: int = 0  # frames of another major version
    stale_session: int = 0  # stream frames of another session
    out_of_state: int = 0  # messages that the state table forbids
    lost: int = 0  # stream frames missing between two that came, those that came too late included
    duplicated: int = 0  # stream frames that came twice
    reordered: int = 0  # stream frames older than one already delivered; COMMANDs older than their lifetime
    overrun: int = 0  # frames dropped unread because the events were not taken

    @property
    def framing_errors(self) -> int:
        """Return the number of frames with wrong byte stuffing or wrong length; a wrong CRC does not count."""
        return self.cobs_errors + self.too_long + self.too_short
