"""Transfer data that is longer than a frame: parameter blocks to the device, replies in several pages to the host.

SET_PARAMETERS consists of BEGIN, CHUNKs and COMMIT, each acknowledged; only COMMIT changes parameters. Longer replies
(dictionary, parameters, fault log) are read page by page: each request contains the number of the first byte or entry
of the page, so the device stores no progress. `rig.devices.framed` and the simulated device use it. It must not send
anything itself.
"""

from firmware_protocol.errors import RemoteProtocolError
from firmware_protocol.faults import Status
from firmware_protocol.messages import SetBegin, SetChunk, SetCommit
from firmware_protocol.parameters import BLOCK_LIMIT, block_crc
from firmware_protocol.transaction import CHUNK_BYTES


def set_parameters(block: bytes, nonce: int) -> list[SetBegin | SetChunk | SetCommit]:
    """Return the messages that transfer a parameter block; the host sends each after the ACK of the message before."""
    chunks = [SetChunk(nonce, at, block[at : at + CHUNK_BYTES]) for at in range(0, len(block), CHUNK_BYTES)]
    return [SetBegin(nonce, len(block), block_crc(block)), *chunks, SetCommit(nonce)]


class Assembler:
    """Device side of SET_PARAMETERS: it joins the received chunks to a parameter block of at most `limit` bytes.

    Chunks may arrive in any order and more than once. A BEGIN with another nonce, length or CRC starts a new block; a
    repeated BEGIN changes nothing.
    """

    def __init__(self, limit: int = BLOCK_LIMIT) -> None:
        self._limit = limit
        self._begun: SetBegin | None = None
        self._block = bytearray()
        self._missing: set[int] = set()

    def begin(self, message: SetBegin) -> Status:
        """Start a new parameter block; return OK, or BAD_LENGTH if the announced block is too long."""
        if message.length > self._limit:
            return Status.BAD_LENGTH
        # The same BEGIN again changes nothing: a repeat after a lost ACK is harmless.
        if message != self._begun:
            self._begun = message
            self._block = bytearray(message.length)
            self._missing = set(range(message.length))
        return Status.OK

    def chunk(self, message: SetChunk) -> Status:
        """Store a piece of the parameter block; return OK, BAD_LENGTH (beyond the block) or INCOMPLETE (none begun)."""
        if self._begun is None or message.nonce != self._begun.nonce:
            return Status.INCOMPLETE
        end = message.offset + len(message.data)
        if end > self._begun.length:
            return Status.BAD_LENGTH
        self._block[message.offset : end] = message.data
        self._missing.difference_update(range(message.offset, end))
        return Status.OK

    def commit(self, message: SetCommit) -> tuple[Status, bytes]:
        """Return status OK and the parameter block; or INCOMPLETE (chunks may still follow) or BAD_CRC, and b""."""
        begun = self._begun
        if begun is None or message.nonce != begun.nonce or self._missing:
            return Status.INCOMPLETE, b""
        block = bytes(self._block)
        self._begun = None
        if block_crc(block) != begun.crc:
            return Status.BAD_CRC, b""
        return Status.OK, block


def page(content: bytes, offset: int, size: int) -> bytes:
    """Return the page of a long reply that starts at the byte `offset`: at most `size` bytes, b"" beyond the end."""
    # Each request names the first byte wanted, so that reading needs no memory on the device.
    return content[offset : offset + size]


class PageReader:
    """Host side of a reply in several pages: request the page at `offset`, pass it to `add`, repeat until `complete`.

    The whole reply has at most `limit` bytes.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._head: tuple[int, int] | None = None
        self._content = bytearray()

    @property
    def offset(self) -> int:
        """Return the offset of the next page to request (bytes), which is the number of bytes received so far."""
        return len(self._content)

    @property
    def complete(self) -> bool:
        """Return True if all bytes of the reply have arrived."""
        return self._head is not None and len(self._content) == self._head[0]

    @property
    def content(self) -> bytes:
        """Return the bytes of the reply that have arrived so far."""
        return bytes(self._content)

    def add(self, *, total: int, fingerprint: int, offset: int, data: bytes) -> None:
        """Add one page of the reply; ignore a page that was added before.

        `total` is the length of the whole reply (bytes), `fingerprint` its hash or CRC. Raise `RemoteProtocolError` if
        `total` is above the limit, a page is missing, or `total` or `fingerprint` differ from those of the first page.
        """
        if self._head is None:
            if total > self._limit:
                raise RemoteProtocolError(
                    f"the device announces a reply of {total} bytes, above the limit of {self._limit}"
                )
            self._head = (total, fingerprint)
        if (total, fingerprint) != self._head:
            raise RemoteProtocolError("the device changed the reply between two pages; read all pages again")
        if offset < self.offset or self.complete:
            return
        if offset > self.offset or not data or self.offset + len(data) > total:
            raise RemoteProtocolError(
                f"received {len(data)} bytes at {offset} of the reply; expected the page at {self.offset} of {total}"
            )
        self._content += data
