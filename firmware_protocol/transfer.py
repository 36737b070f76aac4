"""Transfer data longer than a frame: parameter blocks to the device, paged replies to the host.

SET_PARAMETERS consists of BEGIN, CHUNKs and COMMIT, each acknowledged; only COMMIT changes parameters. Longer replies
(dictionary, parameters, fault log) are read page by page: each request contains the first wanted byte or entry, so
the device stores no progress.
"""

from __future__ import annotations

from firmware_protocol.errors import RemoteProtocolError
from firmware_protocol.faults import Status
from firmware_protocol.messages import SetBegin, SetChunk, SetCommit
from firmware_protocol.parameters import BLOCK_LIMIT, block_crc
from firmware_protocol.transaction import CHUNK_BYTES


def set_parameters(block: bytes, nonce: int) -> list[SetBegin | SetChunk | SetCommit]:
    """Return the messages that send a block to the device; the host sends each after the ACK of the message before."""
    chunks = [SetChunk(nonce, at, block[at : at + CHUNK_BYTES]) for at in range(0, len(block), CHUNK_BYTES)]
    return [SetBegin(nonce, len(block), block_crc(block)), *chunks, SetCommit(nonce)]


class Assembler:
    """Device side of SET_PARAMETERS: it assembles a block of at most `limit` bytes.

    Chunks may arrive in any order and more than once. A BEGIN with another nonce, length or CRC starts a new block; a
    repeated BEGIN changes nothing.
    """

    def __init__(self, limit: int = BLOCK_LIMIT) -> None:
        self._limit = limit
        self._begun: SetBegin | None = None
        self._block = bytearray()
        self._missing: set[int] = set()

    def begin(self, message: SetBegin) -> Status:
        """Start a block and return OK, or return the status of the refusal."""
        if message.length > self._limit:
            return Status.BAD_LENGTH
        # The same BEGIN again changes nothing: a repeat after a lost ACK is harmless.
        if message != self._begun:
            self._begun = message
            self._block = bytearray(message.length)
            self._missing = set(range(message.length))
        return Status.OK

    def chunk(self, message: SetChunk) -> Status:
        """Store a piece of the block and return OK, or return the status of the refusal."""
        if self._begun is None or message.nonce != self._begun.nonce:
            return Status.INCOMPLETE
        end = message.offset + len(message.data)
        if end > self._begun.length:
            return Status.BAD_LENGTH
        self._block[message.offset : end] = message.data
        self._missing.difference_update(range(message.offset, end))
        return Status.OK

    def commit(self, message: SetCommit) -> tuple[Status, bytes]:
        """Return OK and the block, or the status of the failure. This ends the transfer, unless bytes are missing."""
        begun = self._begun
        if begun is None or message.nonce != begun.nonce or self._missing:
            return Status.INCOMPLETE, b""
        block = bytes(self._block)
        self._begun = None
        if block_crc(block) != begun.crc:
            return Status.BAD_CRC, b""
        return Status.OK, block


def page(content: bytes, offset: int, size: int) -> bytes:
    """Return at most `size` bytes of a reply from `offset` on; b"" beyond its end."""
    # Each request names the first byte wanted, so that reading needs no memory on the device.
    return content[offset : offset + size]


class PageReader:
    """Host side of a paged reply of at most `limit` bytes: request `offset` and `add` the page, until `complete`."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._head: tuple[int, int] | None = None
        self._content = bytearray()

    @property
    def offset(self) -> int:
        """Return the offset of the next byte to request."""
        return len(self._content)

    @property
    def complete(self) -> bool:
        """Return True if all bytes have arrived."""
        return self._head is not None and len(self._content) == self._head[0]

    @property
    def content(self) -> bytes:
        """Return the bytes that have arrived."""
        return bytes(self._content)

    def add(self, *, total: int, fingerprint: int, offset: int, data: bytes) -> None:
        """Add one page; ignore a page that was added before.

        Raise `RemoteProtocolError` for a too long reply, a missing page, or another total or fingerprint (hash or CRC).
        """
        if self._head is None:
            if total > self._limit:
                raise RemoteProtocolError(
                    f"the reply announces {total} bytes, above the limit of {self._limit}"
                )
            self._head = (total, fingerprint)
        if (total, fingerprint) != self._head:
            raise RemoteProtocolError("the reply changed while it was read; read it again")
        if offset < self.offset or self.complete:
            return
        if offset > self.offset or not data or self.offset + len(data) > total:
            raise RemoteProtocolError(
                f"a page of {len(data)} bytes at offset {offset}; expected at offset {self.offset} of {total}"
            )
        self._content += data
