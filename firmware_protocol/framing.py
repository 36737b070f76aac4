"""Encode and decode frames: COBS byte stuffing, one 0x00 after each frame, CRC-32 inside.

    wire = COBS(raw) 0x00        raw = header, payload, CRC-32/ISO-HDLC of both (little-endian)

The byte 0x00 occurs only between frames, so a receiver that lost bytes is synchronised again at the next 0x00.
`Connection` and `rig.firmware` use it; `rig.realtime.codec` does the same in compiled code and must give the same
bytes.
"""

from enum import IntEnum
from zlib import crc32

from firmware_protocol.counters import LinkStatistics
from firmware_protocol.errors import LocalProtocolError, RemoteProtocolError

HEADER_BYTES = 6
CRC_BYTES = 4
SHORT_RAW_LIMIT = 60  # with stuffing and delimiter 62 bytes: one 64-byte packet of full-speed USB
# No run of 254 bytes without a zero exists in so short a frame: the block code 0xFF, about whose end COBS encoders
# disagree, never occurs, and every raw frame has exactly one encoding.
RAW_LIMIT = 252  # BATCH; with stuffing 253, below the 254 where a COBS block would have to be split
ENCODED_LIMIT = RAW_LIMIT + 1
RAW_MINIMUM = HEADER_BYTES + CRC_BYTES

_CODES = [bytes([length + 1]) for length in range(RAW_LIMIT + 1)]  # COBS code before a run without zeros


class Defect(IntEnum):
    """Reason why received bytes are not a frame; the compiled decoder (`rig.realtime.codec`) returns it negated."""

    COBS = 1
    CRC = 2
    TOO_LONG = 3
    TOO_SHORT = 4


class FrameError(RemoteProtocolError):
    """Bytes between two delimiters are not a frame; `defect` gives the reason."""

    def __init__(self, defect: Defect) -> None:
        super().__init__(f"received bytes are not a valid frame: {defect.name} error")
        self.defect = defect


def encode_frame(raw: bytes) -> bytes:
    """Return the encoded frame of header and payload (`raw`), with CRC, byte stuffing and delimiter, ready to send.

    Raise `LocalProtocolError` if `raw` is too short or too long for a frame.
    """
    if not HEADER_BYTES <= len(raw) <= RAW_LIMIT - CRC_BYTES:
        raise LocalProtocolError(
            f"header and payload have {len(raw)} bytes; a frame allows {HEADER_BYTES} … {RAW_LIMIT - CRC_BYTES}"
        )
    runs = (raw + crc32(raw).to_bytes(CRC_BYTES, "little")).split(b"\0")
    return b"".join([_CODES[len(run)] + run for run in runs]) + b"\0"


def decode_frame(encoded: bytes | bytearray) -> bytes:
    """Return header and payload of an encoded frame; `encoded` does not contain the delimiter.

    Raise `FrameError` for wrong byte stuffing, a wrong CRC or a wrong length.
    """
    size = len(encoded)
    if size > ENCODED_LIMIT:
        raise FrameError(Defect.TOO_LONG)
    if size < RAW_MINIMUM + 1:
        raise FrameError(Defect.TOO_SHORT)
    if 0 in encoded:
        raise FrameError(Defect.COBS)
    frame = bytearray(encoded)
    here = 0
    while here < size:
        code = frame[here]
        frame[here] = 0
        here += code
    if here != size:
        raise FrameError(Defect.COBS)
    raw = bytes(frame[1:-CRC_BYTES])
    # Hamming distance 5 or more at these lengths (decoded). A flipped bit on the wire can spread through COBS, so the
    # tests try every single one.
    if crc32(raw) != int.from_bytes(frame[-CRC_BYTES:], "little"):
        raise FrameError(Defect.CRC)
    return raw


class FrameSplitter:
    """Splitter of a received byte stream into raw frames. Bad frames are counted in `statistics`, not raised.

    The splitter stores at most one unfinished frame and processes every byte once. Empty frames (two delimiters in
    succession) are ignored: a sender may begin with a delimiter to end noise on the line.
    """

    def __init__(self, statistics: LinkStatistics | None = None) -> None:
        self.statistics = statistics if statistics is not None else LinkStatistics()
        self._pending = bytearray()
        self._skipping = False  # inside a frame that is too long: ignore bytes to its end

    def feed(self, data: bytes) -> list[bytes]:
        """Accept received bytes; return the raw frames (header and payload) that are now complete, oldest first."""
        *ends, tail = data.split(b"\0")
        frames = []
        for piece in ends:
            encoded = self._complete_frame(piece)
            if encoded:
                raw = self._decode(encoded)
                if raw is not None:
                    frames.append(raw)
        self._store_unfinished(tail)
        return frames

    def reset(self) -> None:
        """Discard an unfinished frame, for example after other code has read from the link."""
        self._pending.clear()
        self._skipping = False

    def _complete_frame(self, piece: bytes) -> bytes | bytearray:
        if self._skipping:
            self._skipping = False
            return b""
        if not self._pending:
            return piece
        encoded = self._pending + piece
        self._pending.clear()
        return encoded

    def _store_unfinished(self, tail: bytes) -> None:
        if self._skipping or not tail:
            return
        if len(self._pending) + len(tail) > ENCODED_LIMIT:
            self.statistics.too_long += 1
            self._pending.clear()
            self._skipping = True
        else:
            self._pending += tail

    def _decode(self, encoded: bytes | bytearray) -> bytes | None:
        try:
            raw = decode_frame(encoded)
        except FrameError as error:
            self._count(error.defect)
            return None
        self.statistics.frames += 1
        return raw

    def _count(self, defect: Defect) -> None:
        statistics = self.statistics
        if defect is Defect.CRC:
            statistics.crc_errors += 1
        elif defect is Defect.COBS:
            statistics.cobs_errors += 1
        elif defect is Defect.TOO_LONG:
            statistics.too_long += 1
        else:
            statistics.too_short += 1
