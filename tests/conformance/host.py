"""A minimal host for the conformance suites: one transaction at a time over any link."""

from collections.abc import Iterator
from typing import Any

from firmware_protocol import dictionary, transfer
from firmware_protocol import messages as m
from firmware_protocol.connection import Connection, Received, State
from firmware_protocol.faults import Status
from firmware_protocol.messages import Message, Role
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import encode_block
from rig.devices.device import DeviceUrl, Link

ANSWER_S = 2.0  # far beyond any honest answer
_dictionaries: dict[int, dictionary.Dictionary] = {}  # by their hashes
RUN_PARAMETERS: dict[str, Value] = {
    "reference_count": 0,
    "verified": 1,
    "command_lifetime_us": 20_000,
    "current_limit": 500,
    "continuous_current": 500,
    "speed_limit": 1_000_000,
    "window_minimum": -1_000_000,
    "window_maximum": 1_000_000,
}


class StubLink:
    """The parts of a link in virtual time that a test does not use."""

    url = DeviceUrl("test", "", {}, "test://")
    bytes_per_second: float | None = None
    messages: tuple[str, ...] = ()

    def failure(self) -> None:
        return None

    def truth(self) -> None:
        return None

    def port(self) -> Any:
        raise NotImplementedError

    def close(self) -> None:
        pass


class Host:
    """A host that sends requests and reads replies; STATEs that arrive meanwhile are stored in `states`."""

    def __init__(self, link: Link, *, first_nonce: int = 1) -> None:
        self.link = link
        self.connection = Connection(Role.HOST)
        self.states: list[m.State] = []
        self.sequences: list[int] = []  # of the frames of `states`
        self.sent = b""  # the last frame
        self._nonce = first_nonce - 1

    def nonce(self) -> int:
        self._nonce += 1
        return self._nonce

    def send(self, message: Message, session: int | None = None) -> None:
        self.sent = self.connection.send(message, session=session)
        self.link.write(self.sent)

    def events(self, timeout_s: float) -> Iterator[Received]:
        """Read once and yield the messages that this completes."""
        self.connection.receive_data(self.link.read(timeout_s))
        while (event := self.connection.next_event()) is not None:
            assert isinstance(event, Received)
            if isinstance(event.message, m.State):
                self.states.append(event.message)
                self.sequences.append(event.sequence)
            yield event

    def ask(self, message: Message, session: int | None = None) -> Any:
        self.send(message, session)
        return self.answer(message.nonce)  # type: ignore[attr-defined]

    def answer(self, nonce: int) -> Any:
        deadline_ns = self.link.clock.now_ns() + round(ANSWER_S * 1e9)
        while self.link.clock.now_ns() < deadline_ns:
            for event in self.events(0.01):
                if getattr(event.message, "nonce", None) == nonce:
                    return event.message
        raise AssertionError(f"no answer within {ANSWER_S} s")

    def identify(self) -> dictionary.Dictionary:
        """Identify the device; read its dictionary unless this process has already read the one with its `hash`."""
        page = self.ask(m.Identify(self.nonce(), 0))
        self.hash = page.dictionary_hash
        if self.hash not in _dictionaries:
            self.read_dictionary()
        return _dictionaries[self.hash]

    def read_dictionary(self) -> dictionary.Dictionary:
        """Read the whole dictionary by pages; its hash is in `hash` afterwards."""
        reader = transfer.PageReader(dictionary.COMPRESSED_LIMIT)
        while not reader.complete:
            page = self.ask(m.Identify(self.nonce(), reader.offset))
            reader.add(total=page.total, fingerprint=page.dictionary_hash, offset=page.offset, data=page.data)
        self.hash = page.dictionary_hash
        assert dictionary.dictionary_hash(reader.content) == self.hash
        return _dictionaries.setdefault(self.hash, dictionary.decode(reader.content))

    def parameters(self) -> bytes:
        reader = transfer.PageReader(0xFFFF)
        while not reader.complete:
            page = self.ask(m.GetParameters(self.nonce(), reader.offset))
            reader.add(total=page.total, fingerprint=page.crc, offset=page.offset, data=page.data)
        return reader.content

    def set_block(self, block: bytes) -> m.Ack:
        """Send a block unchanged; return the reply to COMMIT, or the first refusal."""
        for message in transfer.set_parameters(block, self.nonce()):
            ack: m.Ack = self.ask(message)
            if ack.status:
                break
        return ack

    def configure(self, **values: Value) -> m.Ack:
        return self.set_block(encode_block(values))

    def arm(self, session: int, crc: int) -> m.Ack:
        """Send ARM with this host's dictionary hash; repeat it while the device is not ready."""
        deadline_ns = self.link.clock.now_ns() + round(ANSWER_S * 1e9)
        while True:
            ack: m.Ack = self.ask(m.Arm(self.nonce(), self.hash, crc), session)
            if ack.status != Status.NOT_READY or self.link.clock.now_ns() > deadline_ns:
                return ack
            for _ in self.events(0.005):
                pass

    def disarm(self, clear_fault: bool = False) -> m.Ack:
        ack: m.Ack = self.ask(m.Disarm(self.nonce(), int(m.DisarmFlag.CLEAR_FAULT) if clear_fault else 0))
        return ack

    def expect_state(self, state: State) -> None:
        """Set the device state that the host assumes, as after a lost STATE."""
        self.connection.state = state

    def begin(self, session: int = 1, **values: Value) -> None:
        self.identify()
        ack = self.configure(**{**RUN_PARAMETERS, **values})
        assert ack.status == 0, ack
        ack = self.arm(session, ack.crc)
        assert ack.status == 0, ack

    def command(
        self, current: int = 0, *, lifetime_us: int = 20_000, mode: int = m.Mode.CURRENT, flags: int = 0
    ) -> None:
        """Send a COMMAND that refers to the newest STATE, even after a fault of the device."""
        if self.connection.state is State.FAULT:
            self.expect_state(State.RUNNING)
        answers = self.sequences[-1] if self.sequences else 0
        self.send(m.Command(answers, lifetime_us, int(mode), flags, current))

    def next_state(self) -> m.State:
        self.states.clear()
        deadline_ns = self.link.clock.now_ns() + round(ANSWER_S * 1e9)
        while self.link.clock.now_ns() < deadline_ns:
            for _ in self.events(0.01):
                pass
            if self.states:
                return self.states[-1]
        raise AssertionError(f"no STATE within {ANSWER_S} s")
