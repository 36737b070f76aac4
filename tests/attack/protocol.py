"""Run host and device of the protocol over a faulty line, and compare the compiled codec with the Python one."""

import random
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.connection import OPEN_LIMIT, QUEUE_LIMIT, Connection, Received, State
from firmware_protocol.errors import IncompatibleMajorError, LocalProtocolError, RemoteProtocolError
from firmware_protocol.faults import Status
from firmware_protocol.framing import ENCODED_LIMIT, FrameError, decode_frame
from firmware_protocol.messages import MAJOR, Message
from firmware_protocol.packing import HEADER, LAYOUT_OF, LAYOUTS, unpack_batch_samples
from rig.realtime import codec
from tests.attack.area import Outcome, require
from tests.attack.frames import any_message, frame_of, mangled
from tests.firmware_protocol.test_connection import DEVICE_MESSAGES, HOST_MESSAGES, Pair, state_message

STEPS = 1500
KEPT_BYTES = 8192
SHARE_OF_COMMANDS = 0.8
_COUNTED_PIECES = 64  # of a block whose codecs are compared
_LONG = 1 << 63  # what an int64 holds of a u64

_DECODERS: dict[type[Message], Callable[..., int]] = {
    m.State: codec.decode_state,
    m.Time: codec.decode_time,
    m.Ack: codec.decode_ack,
}


class Talk(Pair):
    """A host and a device connected by a line that mangles frames in both directions."""

    def __init__(self, chance: random.Random) -> None:
        super().__init__()
        self.chance = chance
        self.bytes = 0
        self.sent = bytearray()  # to the device
        self.sent_to_host = bytearray()

    def mangle_frames(self, frames: bytes, sent: bytearray) -> bytes:
        """Return what arrives at the other end; messages of strangers are inserted between the frames."""
        chance, out = self.chance, b""
        for piece in frames.split(b"\0")[:-1]:
            out += mangled(chance, piece + b"\0") if piece else b"\0"
        if chance.random() < 0.3:
            classes = chance.choice((HOST_MESSAGES, DEVICE_MESSAGES))
            session = chance.choice((0, self.device.session, chance.randrange(256)))
            out += mangled(chance, frame_of(any_message(chance, classes), session, chance.randrange(8)))
        self.bytes += len(out)
        sent += out
        del sent[:-KEPT_BYTES]
        return out

    def step(self) -> None:
        """Send one message of the host, the device's replies, and messages that the device sends unrequested."""
        host, device, chance = self.host, self.device, self.chance
        frame = b""
        likely = host.state >= State.ARMED and chance.random() < SHARE_OF_COMMANDS
        cls = m.Command if likely else chance.choice(HOST_MESSAGES)
        session = chance.randrange(1, 256) if cls is m.Arm else None
        with suppress(LocalProtocolError):  # the state forbids it
            frame = host.send(any_message(chance, [cls]), session=session)
        answers = self.reply_to(frame)
        if device.session and chance.random() < 0.5:
            with suppress(LocalProtocolError):
                answers += device.send(state_message(device.state, chance.randrange(4)))
        if chance.random() < 0.005:
            device.fault()
        elif chance.random() < 0.001:
            device.reset()
        self.deliver(self.mangle_frames(answers, self.sent_to_host))

    def reply_to(self, frame: bytes) -> bytes:
        """Return the device's reply to a damaged frame, and require that only a received ARM arms it."""
        before = self.device.state
        came = self.mangle_frames(frame, self.sent)
        status = Status.OK if self.chance.random() < 0.9 else Status.OUT_OF_RANGE
        answers = self.answer(came, status)
        device = self.device
        if device.state is State.ARMED and before < State.ARMED:
            require(_armed_by(self.sent, device.session), "armed without an ARM: session", device.session)
        require(
            bool(device.session) == (device.state >= State.ARMED) or device.state is State.FAULT, "session"
        )
        return answers

    def deliver(self, data: bytes) -> None:
        host = self.host
        host.receive_data(data)
        while True:
            try:
                event = host.next_event()
            except IncompatibleMajorError:
                continue
            if event is None:
                break
            require(isinstance(event, Received), "a host is asked nothing:", event)

    def check_bounds(self) -> None:
        """Require that the queues of both ends are bounded, whatever arrived."""
        for end in (self.host, self.device):
            _check_bounds(end)


def _check_bounds(end: Connection) -> None:
    require(len(end._frames) <= QUEUE_LIMIT and len(end._open_requests) <= OPEN_LIMIT, "a queue that grows")
    require(len(end._splitter._pending) <= ENCODED_LIMIT, "an unfinished frame that grows")


def raw_frames(data: bytes | bytearray) -> list[bytes]:
    """Return header and payload of each frame with a valid CRC in these bytes."""
    found = []
    for piece in bytes(data).split(b"\0"):
        with suppress(FrameError):
            found.append(decode_frame(piece))
    return found


def _armed_by(data: bytes | bytearray, session: int) -> bool:
    arm = LAYOUT_OF[m.Arm].type_id
    return any(raw[1] == arm and raw[3] == session != 0 for raw in raw_frames(data))


class Protocol:
    """The area "protocol": each case is one conversation; both codecs decode its bytes once more."""

    def __init__(self, place: Path) -> None:
        self._raw = np.zeros(codec.RAW_BYTES, np.uint8)
        self._header = np.zeros(len(codec.HEAD), np.int64)
        self._values = np.zeros(32, np.int64)
        self._samples = np.zeros((codec.MOST_SAMPLES, len(codec.SAMPLE)), np.int64)

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run one conversation of `STEPS` steps."""
        talk, armed = Talk(chance), 0
        talk.bring_to(chance.choice(list(State)))
        for _ in range(STEPS):
            talk.step()
            armed += talk.device.state in (State.ARMED, State.RUNNING)
        talk.check_bounds()
        pieces = bytes(talk.sent + talk.sent_to_host).split(b"\0")[:_COUNTED_PIECES]
        pieces += [chance.randbytes(chance.randrange(270)).replace(b"\0", b"\1") for _ in range(4)]
        for piece in pieces:
            self._compare(piece)
        figures = Counter(bytes=talk.bytes, steps=STEPS, steps_armed=armed, decoded=len(pieces))
        return Outcome(figures)

    def _compare(self, encoded: bytes) -> None:
        """Require that the compiled codec decodes a frame as the Python codec does."""
        buffer = np.frombuffer(encoded, np.uint8).copy()
        length = codec.decode_frame(buffer, 0, len(buffer), self._raw)
        try:
            readable = decode_frame(encoded)
        except FrameError as error:
            require(length == -int(error.defect), "compiled", length, "readable", error, encoded.hex())
            return
        require(self._raw[: max(0, length)].tobytes() == readable, "other bytes in", encoded.hex())
        for cls, decode in _DECODERS.items():
            found = decode(self._raw, length, self._header, self._values)
            self._check(cls, found, readable)
        found = codec.decode_batch(self._raw, length, self._header, self._values, self._samples)
        self._check_batch(found, readable)

    def _check(self, cls: type[Message], found: int, raw: bytes) -> None:
        message = _decode_readable(cls, raw)
        if isinstance(message, int):
            require(found == message, cls.__name__, found, "not", message, raw.hex())
            return
        require(found == 0, cls.__name__, found, raw.hex())
        read = astuple(message)  # type: ignore[call-overload]
        same = all(ours == theirs for ours, theirs in zip(self._values, read, strict=False) if theirs < _LONG)
        require(same and tuple(self._header) == HEADER.unpack_from(raw), cls.__name__, raw.hex())

    def _check_batch(self, found: int, raw: bytes) -> None:
        message = _decode_readable(m.Batch, raw)
        if isinstance(message, int):
            require(found == message, "Batch", found, "not", message, raw.hex())
            return
        try:
            samples = unpack_batch_samples(message)
        except RemoteProtocolError:
            unknown = message.layout not in m.BATCH_LAYOUTS
            wanted = codec.BAD_VALUE if unknown else codec.BAD_PAYLOAD
            require(found == wanted, "Batch", found, "not", wanted, raw.hex())
            return
        require(found == len(samples), "Batch", found, raw.hex())


def _decode_readable(cls: type[Message], raw: bytes) -> Any:
    """Return the decoded message, or the error code that the compiled decoder must return."""
    if raw[0] != MAJOR:
        return codec.FOREIGN_MAJOR
    if raw[1] != LAYOUT_OF[cls].type_id:
        return codec.OTHER_TYPE
    try:
        return LAYOUTS[raw[1]].unpack(raw)
    except RemoteProtocolError:
        return codec.BAD_PAYLOAD
