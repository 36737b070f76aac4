"""Convert received bytes to events and messages to frames, and track the state of the device on both ends of the link.

The caller passes bytes to `receive_data`, takes events until `next_event` returns None, and writes the result of `send`
to the link. Host and device use the same class, so a test can connect two of them directly. It has no port, clock or
thread. For any bytes it returns events or raises `RemoteProtocolError`, and its memory stays bounded.
`rig.devices.framed` and the simulated device use it. It must not decide when to send: its caller has the time.
"""

import struct
from collections import deque
from dataclasses import dataclass
from enum import IntEnum

from firmware_protocol import messages as m
from firmware_protocol.counters import LinkStatistics
from firmware_protocol.errors import IncompatibleMajorError, LocalProtocolError, RemoteProtocolError
from firmware_protocol.faults import Status
from firmware_protocol.framing import HEADER_BYTES, FrameSplitter, encode_frame
from firmware_protocol.messages import MAJOR, Delivery, Message, Role
from firmware_protocol.packing import HEADER, LAYOUT_OF, LAYOUTS, Layout, type_id_of
from firmware_protocol.transaction import (
    CHUNK,
    CHUNK_BYTES,
    DONE,
    MOST_TRIES,
    Transaction,
    after_answer,
    after_time,
)


class State(IntEnum):
    """State of the device, which determines the messages that it accepts."""

    BOOT = 0  # started, not yet identified
    IDENTIFIED = 1  # known, with the parameters it started with
    CONFIGURED = 2  # a parameter block is active
    ARMED = 3  # a session is open, the amplifier enabled, no COMMAND yet, zero effort
    RUNNING = 4  # COMMANDs come within their lifetimes
    FAULT = 5  # latched: zero effort, amplifier off


_QUESTIONS: tuple[type[Message], ...] = (
    m.Identify,
    m.GetParameters,
    m.GetTime,
    m.GetFaultLog,
    m.GetStatistics,
    m.GetReference,
)
_SETTING: tuple[type[Message], ...] = (m.SetBegin, m.SetChunk)

# The device owns the state. A transaction takes effect with its answer: the device moves when it sends the reply (for
# an ACK: with status OK), the host when it receives it. A COMMAND has no reply and takes effect when it is received.
# State → message of the host → state after it. What is not here is refused.
TRANSITIONS: dict[State, dict[type[Message], State]] = {
    State.BOOT: {m.Identify: State.IDENTIFIED},
    State.IDENTIFIED: {
        **dict.fromkeys(_QUESTIONS + _SETTING, State.IDENTIFIED),
        m.SetCommit: State.CONFIGURED,
        m.EnterBootloader: State.BOOT,
    },
    State.CONFIGURED: {
        **dict.fromkeys(_QUESTIONS + _SETTING, State.CONFIGURED),
        m.SetCommit: State.CONFIGURED,
        m.Arm: State.ARMED,
        m.EnterBootloader: State.BOOT,
    },
    State.ARMED: {
        **dict.fromkeys(_QUESTIONS + _SETTING, State.ARMED),
        m.SetCommit: State.ARMED,  # of live parameters
        m.Command: State.RUNNING,
        m.Disarm: State.CONFIGURED,
    },
    State.RUNNING: {
        **dict.fromkeys(_QUESTIONS + _SETTING, State.RUNNING),
        m.SetCommit: State.RUNNING,
        m.Command: State.RUNNING,
        m.Disarm: State.CONFIGURED,
    },
    State.FAULT: {
        **dict.fromkeys(_QUESTIONS, State.FAULT),
        m.Disarm: State.CONFIGURED,  # only with CLEAR_FAULT: see Connection._find_rejection
        m.EnterBootloader: State.BOOT,
    },
}

# The reply that each question has of its own; all other requests, and all refusals, are answered by ACK.
REPLIES: dict[type[Message], type[Message]] = {
    m.Identify: m.Identity,
    m.GetParameters: m.Parameters,
    m.GetTime: m.Time,
    m.GetFaultLog: m.FaultLog,
    m.GetStatistics: m.Statistics,
    m.GetReference: m.Reference,
}

# State → what the device may send unasked. With session 0 STATE only shows the rig to a host that has
# not armed it.
UNASKED: dict[State, frozenset[type[Message]]] = {
    State.BOOT: frozenset(),
    State.IDENTIFIED: frozenset({m.State}),
    State.CONFIGURED: frozenset({m.State}),
    State.ARMED: frozenset({m.State}),
    State.RUNNING: frozenset({m.State, m.Batch}),
    State.FAULT: frozenset({m.State, m.Batch}),  # the batches that were still in the buffer
}

QUEUE_LIMIT = 4096  # frames that wait for `next_event`; beyond it the oldest are dropped and counted
OPEN_LIMIT = 16  # requests without a reply yet; a host has one or two

_REQUEST_OF: dict[type[Message], int] = {reply: type_id_of(request) for request, reply in REPLIES.items()}
_NEXT: dict[State, dict[int, State]] = {
    state: {type_id_of(cls): after for cls, after in row.items()} for state, row in TRANSITIONS.items()
}
_COMMAND = type_id_of(m.Command)
_STATE = type_id_of(m.State)
_ARM = type_id_of(m.Arm)
_IDENTIFY = type_id_of(m.Identify)
_NONCE = struct.Struct("<H")
_STATES: dict[int, State] = {int(state): state for state in State}


@dataclass(frozen=True, slots=True)
class Received:
    """Event: a message arrived that the device's state allows; `session` and `sequence` are fields of its header."""

    message: Message
    session: int
    sequence: int

    @property
    def request(self) -> int:
        """Return the type id of the received message."""
        return LAYOUT_OF[type(self.message)].type_id

    @property
    def nonce(self) -> int:
        """Return the number (nonce) of a received transaction; raise AttributeError for a message without a nonce."""
        return self.message.nonce  # type: ignore[attr-defined, no-any-return]

    def ack(
        self, status: Status = Status.OK, *, detail: int = 0, sample_index: int = 0, crc: int = 0
    ) -> m.Ack:
        """Return the ACK of this request: status with detail, tick at which it took effect, CRC of the parameters."""
        return m.Ack(self.nonce, self.request, int(status), detail, sample_index, crc)


@dataclass(frozen=True, slots=True)
class Refused:
    """Event: a request that the device must reject with `ack()`, unless it repeats the last one: resend that reply."""

    request: int  # type id, possibly unknown to this version
    nonce: int
    session: int
    status: Status
    detail: int

    def ack(self) -> m.Ack:
        """Return the ACK that rejects this request: status, and as detail the parameter, state or fault concerned."""
        return m.Ack(self.nonce, self.request, int(self.status), self.detail, 0, 0)


Event = Received | Refused


class Connection:
    """One end of the link between host and device.

    Parameters
    ----------
    role
        HOST or DEVICE: the end of the link at which this object is used.

    Attributes
    ----------
    state
        State of the device; on the host, the last reported state.
    session
        Number of the session while the device is armed, otherwise 0.
    transaction
        Progress of the last transaction; only on the host.
    statistics
        Counters of received and dropped frames.
    """

    def __init__(self, role: Role) -> None:
        self.role = role
        self.state = State.BOOT
        self.session = 0
        self.statistics = LinkStatistics()
        self.transaction = Transaction(0, 0, DONE)
        self._requests: tuple[Message, ...] = ()  # all messages of the transaction
        self._session_to_open: int | None = None  # number in the header, if the transaction is an ARM
        self._last_session = 0
        self._splitter = FrameSplitter(self.statistics)
        self._frames: deque[bytes] = deque()
        self._next_sequences: dict[int, int] = {}  # type id → sequence of the next frame
        self._newest_sequences: dict[int, int] = {}  # stream type id → sequence of the newest frame delivered
        # (type id, nonce) of each request without a reply yet → session in its header
        self._open_requests: dict[tuple[int, int], int] = {}

    # ------------------------------------------------------------------ receiving

    def receive_data(self, data: bytes) -> None:
        """Accept bytes from the link, in pieces of any size. Call `next_event` next, until it returns None."""
        self._frames.extend(self._splitter.feed(data))
        while len(self._frames) > QUEUE_LIMIT:
            self._frames.popleft()
            self.statistics.overrun += 1

    def next_event(self) -> Event | None:
        """Return the next event, or None if the received bytes contain no further event.

        On the host, raise `IncompatibleMajorError` if the device uses another major version: the frame is dropped, and
        the connection stays usable.
        """
        while self._frames:
            event = self._process_frame(self._frames.popleft())
            if event is not None:
                return event
        return None

    def _process_frame(self, raw: bytes) -> Event | None:
        major, type_id, _, session, sequence = HEADER.unpack_from(raw)
        # IDENTIFY is answered whatever its major version: a host must be able to read which device it has found.
        if major != MAJOR and not (type_id == _IDENTIFY and self.role is Role.DEVICE):
            self.statistics.foreign_major += 1
            if self.role is Role.HOST:
                raise IncompatibleMajorError(MAJOR, major)
            return None
        if m.sender_of(type_id) is self.role:
            self.statistics.wrong_direction += 1
            return None
        layout = LAYOUTS.get(type_id)
        if layout is None:
            self.statistics.unknown_type += 1
            return self._refuse(raw, Status.UNSUPPORTED)
        if layout.delivery is Delivery.TRANSACTION:
            return self._process_transaction(layout, raw, session, sequence)
        return self._process_stream_frame(layout, raw, session, sequence)

    def _process_stream_frame(self, layout: Layout, raw: bytes, session: int, sequence: int) -> Event | None:
        statistics = self.statistics
        if session != self.session:
            # Frames of a process that died cannot belong to the next run. Transactions are taken from any session: a
            # new host must be able to disarm.
            statistics.stale_session += 1
            return None
        after = self.state
        if self.role is Role.DEVICE:
            known = _NEXT[self.state].get(layout.type_id)
            if known is None:
                statistics.out_of_state += 1
                return None
            after = known
        message = self._unpack(layout, raw)
        if message is None:
            return None
        if isinstance(message, m.State):
            if message.state not in _STATES:
                statistics.malformed += 1
                return None
            after = _STATES[message.state]
        if not self._must_deliver(layout, sequence):
            return None
        if after is not self.state:
            self._enter_state(after)
        return Received(message, session, sequence)

    def _must_deliver(self, layout: Layout, sequence: int) -> bool:
        """Return True if a stream frame must be delivered; count lost, repeated and late frames by their sequence."""
        newest = self._newest_sequences.get(layout.type_id)
        step = 1 if newest is None else (sequence - newest) & 0xFFFF
        if step == 0:
            self.statistics.duplicated += 1
            return False
        if step > 0x7FFF:  # half of the circle lies behind
            self.statistics.reordered += 1
            # An older BATCH fills a gap in a recording; an older STATE or COMMAND must not act.
            return layout.delivery is Delivery.BATCH
        self.statistics.lost += step - 1
        self._newest_sequences[layout.type_id] = sequence
        return True

    def _process_transaction(self, layout: Layout, raw: bytes, session: int, sequence: int) -> Event | None:
        message = self._unpack(layout, raw)
        if message is None:
            return self._refuse(raw, Status.BAD_LENGTH)
        event = Received(message, session, sequence)
        if self.role is Role.HOST:
            self._handle_reply(message)
            self.transaction = after_answer(self.transaction, event.nonce, *self._as_ack(message))
            return event
        rejection = self._find_rejection(event)
        if rejection is not None:
            self.statistics.out_of_state += 1
            return self._refuse(raw, *rejection)
        self._store_open_request(layout.type_id, event.nonce, session)
        return event

    def _find_rejection(self, event: Received) -> tuple[Status, int] | None:
        """Return the status, and its detail, with which the device must reject a request now; None if it is allowed."""
        if event.request not in _NEXT[self.state]:
            return Status.BAD_STATE, int(self.state)
        message = event.message
        # Session 0 means "not armed". The number used last is refused, so that late frames of the previous run cannot
        # be taken for the new one's.
        if isinstance(message, m.Arm) and event.session in {0, self._last_session}:
            return Status.STALE_SESSION, event.session
        if (
            self.state is State.FAULT
            and isinstance(message, m.Disarm)
            and not message.flags & m.DisarmFlag.CLEAR_FAULT
        ):
            return Status.FAULT_LATCHED, 0
        return None

    def _unpack(self, layout: Layout, raw: bytes) -> Message | None:
        try:
            return layout.unpack(raw)
        except RemoteProtocolError:
            self.statistics.malformed += 1
            return None

    def _refuse(self, raw: bytes, status: Status, detail: int = 0) -> Refused | None:
        """Return the device's rejection of a request of any type; None on the host, or if the frame has no nonce."""
        if (
            self.role is Role.HOST
            or m.delivery_of(raw[1]) is not Delivery.TRANSACTION
            or len(raw) < HEADER_BYTES + 2
        ):
            return None
        (nonce,) = _NONCE.unpack_from(raw, HEADER_BYTES)
        return Refused(raw[1], nonce, raw[3], status, detail)

    # ------------------------------------------------------------------ sending

    def send(self, message: Message, *, session: int | None = None) -> bytes:
        """Return the frame of a message, ready to be written to the link.

        Raise `LocalProtocolError` if only the other role sends this message, the state forbids it, or a value does not
        fit its field; the connection is then unchanged.

        Parameters
        ----------
        message
            Message to send.
        session
            Required for ARM and forbidden for all other messages: number of the new session, 1 … 255, not the last one
            used.
        """
        layout = LAYOUT_OF[type(message)]
        type_id = layout.type_id
        if layout.sender is not self.role:
            ours, theirs = self.role.name.lower(), layout.sender.name.lower()
            raise LocalProtocolError(
                f"a {ours} must not send the message {layout.name}: only the {theirs} sends it"
            )
        if self.role is Role.HOST:
            number = self._session_of_request(layout, session)
        else:
            self._check_unrequested(layout)
            number = self.session
        sequence = self._next_sequences.get(type_id, 0)
        frame = encode_frame(HEADER.pack(MAJOR, type_id, 0, number, sequence) + layout.pack(message))
        self._next_sequences[type_id] = (sequence + 1) & 0xFFFF
        if type_id == _COMMAND:
            self.state = State.RUNNING
        elif layout.delivery is Delivery.TRANSACTION:
            if self.role is Role.HOST:
                self._store_open_request(type_id, message.nonce, number)  # type: ignore[attr-defined]
            else:
                self._handle_reply(message)
        return frame

    def begin(self, *requests: Message, session: int | None = None) -> None:
        """Host: begin a transaction: one request, or the messages of a parameter update (`transfer.set_parameters`).

        Call `say` repeatedly to get the frames to send. `session` is the number of the new session for ARM, else None.
        An unfinished transaction is abandoned.
        """
        self._require_role(Role.HOST, "begin")
        self._requests, self._session_to_open = requests, session
        nonce, step = requests[0].nonce, type_id_of(type(requests[0]))  # type: ignore[attr-defined]
        length = requests[0].length if isinstance(requests[0], m.SetBegin) else 0
        self.transaction = Transaction(nonce, length, step)

    def say(self, time_ns: int) -> bytes:
        """Host: return the transaction's frame that must be sent at `time_ns`, or b"" if nothing must be sent now.

        `time_ns` is any monotonic clock's time (ns). Raise `LocalProtocolError` if the device's state forbids the
        request.
        """
        before = self.transaction
        self.transaction = after_time(before, time_ns, MOST_TRIES)
        if self.transaction.tries == before.tries:
            return b""
        return self.send(self.request, session=self._session_to_open)

    @property
    def request(self) -> Message:
        """Host: return the request of the transaction that waits for its reply."""
        t = self.transaction
        if t.step == CHUNK:
            return self._requests[1 + t.offset // CHUNK_BYTES]
        return self._requests[0 if t.step == type_id_of(type(self._requests[0])) else -1]

    def _as_ack(self, reply: Message) -> tuple[int, int, int]:
        """Return type id of the request, status and detail of a reply; a reply that is not an ACK counts as an ACK.

        Its status is then OK if it is the reply of the present request, else UNSUPPORTED.
        """
        if isinstance(reply, m.Ack):
            return reply.request, reply.status, reply.detail
        step = self.transaction.step
        return step, int(Status.OK if _REQUEST_OF[type(reply)] == step else Status.UNSUPPORTED), 0

    def _session_of_request(self, layout: Layout, session: int | None) -> int:
        if layout.type_id not in _NEXT[self.state]:
            raise self._not_allowed(layout)
        if (session is not None) != (layout.type_id == _ARM):
            raise LocalProtocolError(
                f"session = {session} for the message {layout.name}: give a session number with ARM, and only with ARM"
            )
        if session is not None:
            if not 1 <= session <= 0xFF or session == self._last_session:
                raise LocalProtocolError(
                    f"session number {session} must be 1 … 255 and differ from the last one ({self._last_session})"
                )
            return session
        if layout.type_id == _COMMAND and not self.session:
            raise LocalProtocolError(
                "COMMAND is not allowed: another host armed the device, so this host does not know its session; "
                "disarm the device, then arm it from this host"
            )
        return self.session

    def _not_allowed(self, layout: Layout) -> LocalProtocolError:
        allowed = [s.name for s in State if layout.type_id in _NEXT[s] or layout.cls in UNASKED[s]]
        return LocalProtocolError(
            f"the message {layout.name} is not allowed in state {self.state.name}, only in {', '.join(allowed)}"
        )

    def _check_unrequested(self, layout: Layout) -> None:
        if layout.delivery is not Delivery.TRANSACTION and layout.cls not in UNASKED[self.state]:
            raise self._not_allowed(layout)

    # ------------------------------------------------------------------ transactions and states, both roles

    def _store_open_request(self, request: int, nonce: int, session: int) -> None:
        self._open_requests.pop((request, nonce), None)
        if len(self._open_requests) >= OPEN_LIMIT:
            del self._open_requests[next(iter(self._open_requests))]
        self._open_requests[request, nonce] = session

    def _handle_reply(self, reply: Message) -> None:
        """Change the state if a reply answers an open request; a repeated reply changes nothing."""
        request = reply.request if isinstance(reply, m.Ack) else _REQUEST_OF[type(reply)]
        session = self._open_requests.pop((request, reply.nonce), None)  # type: ignore[attr-defined]
        if session is None:
            return
        if self.role is Role.HOST:
            self._adopt_state(reply)
        after = _NEXT[self.state].get(request)
        if after is None or (isinstance(reply, m.Ack) and reply.status != Status.OK):
            return
        if request == _ARM:
            self._set_session(session)
        self._enter_state(after)

    def _adopt_state(self, reply: Message) -> None:
        """Host: take over the device's state from an IDENTITY or BAD_STATE reply, because it may have restarted."""
        if isinstance(reply, m.Identity):
            self._enter_state(_STATES.get(reply.state, self.state))
        elif isinstance(reply, m.Ack) and reply.status == Status.BAD_STATE:
            self._enter_state(_STATES.get(reply.detail, self.state))

    def _enter_state(self, after: State) -> None:
        if self.session and after < State.ARMED:
            self._set_session(0)
        self.state = after

    def _set_session(self, session: int) -> None:
        self.session = session
        if session:
            self._last_session = session
        for type_id in LAYOUTS:
            if m.delivery_of(type_id) is not Delivery.TRANSACTION:
                # The sequences of a stream begin at 0 with each session.
                self._next_sequences.pop(type_id, None)
                self._newest_sequences.pop(type_id, None)

    # ------------------------------------------------------------------ changes by the caller

    def fault(self) -> None:
        """Device: enter the state FAULT. The session stays open, so the host still accepts STATE frames."""
        self._require_role(Role.DEVICE, "fault")
        self.state = State.FAULT

    def resend(self, event: Event) -> None:
        """Device: mark a request as answered before, so that sending its reply again does not change the state."""
        self._require_role(Role.DEVICE, "resend")
        # Otherwise a late repeat of a DISARM would clear a fault that occurred in between.
        self._open_requests.pop((event.request, event.nonce), None)

    def reset(self) -> None:
        """Return to the state BOOT, after a reset of the device or a reopened port; the counters keep their values."""
        self.state = State.BOOT
        self._set_session(0)
        self._last_session = 0
        self._next_sequences.clear()
        self._open_requests.clear()
        self._frames.clear()
        self._splitter.reset()

    def sequence_to_send(self, cls: type[Message]) -> int:
        """Return the number of the next frame of message class `cls`, from which a compiled loop continues to count."""
        return self._next_sequences.get(LAYOUT_OF[cls].type_id, 0)

    @property
    def answered(self) -> int:
        """Host: return the sequence number of the newest STATE message, 0 without one; the next COMMAND repeats it."""
        self._require_role(Role.HOST, "answered")
        return self._newest_sequences.get(_STATE, 0)

    def resume(self, *, next_command: int, newest_state: int, state: State) -> None:
        """Host: continue with sequence numbers and state after a compiled loop has used the link.

        Parameters
        ----------
        next_command
            Sequence number of the first COMMAND message that the loop did not send.
        newest_state
            Sequence number of the newest STATE that the loop received.
        state
            State of the device in that STATE.
        """
        self._require_role(Role.HOST, "resume")
        self._splitter.reset()
        self._frames.clear()
        self._next_sequences[_COMMAND] = next_command & 0xFFFF
        self._newest_sequences[_STATE] = newest_state & 0xFFFF
        self._enter_state(state)

    def _require_role(self, role: Role, what: str) -> None:
        if self.role is not role:
            raise LocalProtocolError(
                f"only the {role.name.lower()} may call `{what}`; this connection is the {self.role.name.lower()}'s"
            )
