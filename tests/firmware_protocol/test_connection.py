"""Both ends of a connection in every state, for every message and for arbitrary bytes."""

from collections.abc import Iterator
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.connection import (
    OPEN_LIMIT,
    QUEUE_LIMIT,
    REPLIES,
    TRANSITIONS,
    UNASKED,
    Connection,
    Event,
    Received,
    Refused,
    State,
)
from firmware_protocol.errors import IncompatibleMajorError, LocalProtocolError, RemoteProtocolError
from firmware_protocol.faults import Status
from firmware_protocol.framing import ENCODED_LIMIT, encode_frame
from firmware_protocol.messages import Message, Role
from firmware_protocol.packing import HEADER, LAYOUT_OF, pack, type_id_of
from firmware_protocol.replies import Replies
from tests.conformance.wire_strategies import any_message

SESSION = 7
HOST_MESSAGES = [cls for type_id, cls in m.MESSAGES.items() if m.sender_of(type_id) is Role.HOST]
DEVICE_MESSAGES = [cls for type_id, cls in m.MESSAGES.items() if m.sender_of(type_id) is Role.DEVICE]


def example(cls: type[Message]) -> Message:
    """Return a message with harmless fields; DISARM has the clear-fault flag."""
    layout = LAYOUT_OF[cls]
    numbers = [5] + [1] * (len(layout.struct.unpack(bytes(layout.size))) - 1)
    return layout.cls(*numbers, *([b"data"] if layout.tail else []))


def state_message(state: State, sequence: int = 0) -> m.State:
    return m.State(sequence, 0, 1, 2, 3, 4, 0, 0, 0, 0, 0, 0, int(state), 0, 0, 0)


def events(connection: Connection, data: bytes) -> list[Event]:
    connection.receive_data(data)
    return list(iter(connection.next_event, None))


class Pair:
    """A host and a device, connected; the device acknowledges every request with OK."""

    def __init__(self) -> None:
        self.host = Connection(Role.HOST)
        self.device = Connection(Role.DEVICE)
        self.replies = Replies()
        self.executed: list[Message] = []

    def ask(self, message: Message, *, session: int | None = None, status: Status = Status.OK) -> list[Event]:
        """Send a request, let the device reply, and return the events of the host."""
        return events(self.host, self.answer(self.host.send(message, session=session), status))

    def answer(self, frames: bytes, status: Status = Status.OK) -> bytes:
        """Return the replies of the device."""
        return b"".join(self._answers(frames, status))

    def _answers(self, frames: bytes, status: Status) -> Iterator[bytes]:
        for event in events(self.device, frames):
            if isinstance(event, Received) and isinstance(event.message, m.Command):
                self.executed.append(event.message)
                continue
            reply = self.replies.answer(event, partial(self._execute, event, status))
            yield self.device.send(reply)

    def _execute(self, event: Event, status: Status) -> Message:
        if isinstance(event, Refused):
            return event.ack()
        self.executed.append(event.message)
        if isinstance(event.message, m.Identify):
            return m.Identity(event.nonce, m.MINOR, int(self.device.state), 1, 4, 0, b"dict")
        reply = REPLIES.get(type(event.message))
        if reply is None or status is not Status.OK:
            return event.ack(status)
        layout = LAYOUT_OF[reply]
        numbers = layout.struct.unpack(bytes(layout.size))
        return layout.cls(event.nonce, *numbers[1:], *([b""] if layout.tail else []))

    def bring_to(self, state: State) -> None:
        """Go from BOOT to a state by messages alone."""
        path = {
            State.IDENTIFIED: [m.Identify(1, 0)],
            State.CONFIGURED: [m.Identify(1, 0), m.SetBegin(2, 0, 0), m.SetCommit(2)],
        }
        for message in path.get(state, path[State.CONFIGURED] if state > State.CONFIGURED else []):
            self.ask(message)
        if state >= State.ARMED:
            self.ask(m.Arm(3, 1, 1), session=SESSION)
        if state >= State.RUNNING:
            self.answer(self.host.send(m.Command(0, 3000, 0, 0, 0)))
        if state is State.FAULT:
            self.device.fault()
            events(self.host, self.device.send(state_message(State.FAULT)))
        assert (self.host.state, self.device.state) == (state, state)
        assert self.host.session == self.device.session == (SESSION if state >= State.ARMED else 0)


@pytest.fixture
def pair() -> Pair:
    return Pair()


# ---------------------------------------------------------------------- the table


@pytest.mark.parametrize("state", State)
def test_each_message_in_each_state_follows_the_table(state: State) -> None:
    for cls in HOST_MESSAGES:
        pair = Pair()
        pair.bring_to(state)
        pair.executed.clear()
        after = TRANSITIONS[state].get(cls)
        message = example(cls)
        session = SESSION + 1 if cls is m.Arm else None
        if after is not None:
            answers = pair.answer(pair.host.send(message, session=session))
            assert pair.executed == [message]
            assert bool(answers) == (cls is not m.Command), "a COMMAND has no answer"
            events(pair.host, answers)
            assert (pair.host.state, pair.device.state) == (after, after), cls
            continue
        with pytest.raises(LocalProtocolError, match="not allowed"):
            pair.host.send(message, session=session)
        frame = encode_frame(pack(message, session=pair.device.session if session is None else session))
        received = events(pair.device, frame)
        refused = Refused(
            type_id_of(cls), 5, received[0].session if received else 0, Status.BAD_STATE, int(state)
        )
        assert received == ([] if cls is m.Command else [refused])
        assert pair.device.statistics.out_of_state == 1
        assert pair.device.state is state, cls


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("cls", [m.State, m.Batch])
def test_device_sends_unasked_only_what_its_state_allows(
    pair: Pair, state: State, cls: type[Message]
) -> None:
    pair.bring_to(state)
    message = state_message(state, 9) if cls is m.State else example(cls)
    if cls in UNASKED[state]:
        assert [event.message for event in events(pair.host, pair.device.send(message))] == [message]  # type: ignore[union-attr]
        assert pair.host.state is state
    else:
        with pytest.raises(LocalProtocolError, match="not allowed"):
            pair.device.send(message)


@pytest.mark.parametrize("state", State)
def test_device_enters_fault_from_every_state_and_the_host_follows(pair: Pair, state: State) -> None:
    pair.bring_to(state)
    pair.device.fault()
    events(pair.host, pair.device.send(state_message(State.FAULT)))
    assert (pair.device.state, pair.host.state) == (State.FAULT, State.FAULT)
    with pytest.raises(LocalProtocolError):
        pair.host.fault()


def test_each_end_refuses_to_send_the_messages_of_the_other(pair: Pair) -> None:
    pair.bring_to(State.RUNNING)
    for cls in (*HOST_MESSAGES, *DEVICE_MESSAGES):
        name, end = ("device", pair.device) if cls in HOST_MESSAGES else ("host", pair.host)
        with pytest.raises(LocalProtocolError, match=f"a {name} must not send"):
            end.send(example(cls))


# ---------------------------------------------------------------------- the rules beside the table


def test_through_all_states_and_back(pair: Pair) -> None:
    pair.bring_to(State.FAULT)
    pair.ask(m.Disarm(9, m.DisarmFlag.CLEAR_FAULT))
    assert pair.host.state is pair.device.state is State.CONFIGURED
    assert pair.host.session == pair.device.session == 0
    pair.ask(m.Arm(10, 1, 1), session=SESSION + 1)
    assert pair.host.state is pair.device.state is State.ARMED
    assert pair.host.session == pair.device.session == SESSION + 1


def test_a_session_is_given_with_arm_alone_and_differs_from_the_last(pair: Pair) -> None:
    pair.bring_to(State.RUNNING)
    pair.ask(m.Disarm(4, 0))
    for session in (None, 0, SESSION, 256):
        with pytest.raises(LocalProtocolError, match=r"ARM|1 … 255"):
            pair.host.send(m.Arm(5, 1, 1), session=session)
    with pytest.raises(LocalProtocolError, match="only with ARM"):
        pair.host.send(m.GetTime(3, 1), session=4)


def test_commands_of_another_session_are_dropped_and_counted(pair: Pair) -> None:
    pair.bring_to(State.ARMED)
    for session in (0, SESSION - 1, SESSION + 1):
        assert events(pair.device, encode_frame(pack(m.Command(0, 3000, 0, 0, 99), session=session))) == []
    assert pair.device.statistics.stale_session == 3
    assert pair.device.state is State.ARMED


def test_a_new_host_finds_an_armed_device_and_disarms_it(pair: Pair) -> None:
    pair.bring_to(State.RUNNING)
    pair.host = Connection(Role.HOST)
    pair.ask(m.Identify(100, 0))
    assert pair.host.state is State.RUNNING
    with pytest.raises(LocalProtocolError, match="another host"):
        pair.host.send(m.Command(0, 3000, 0, 0, 0))
    pair.ask(m.Disarm(101, 0))
    assert pair.host.state is pair.device.state is State.CONFIGURED


def test_refusal_for_the_state_contains_the_state(pair: Pair) -> None:
    pair.bring_to(State.CONFIGURED)
    pair.device.fault()
    (answer,) = pair.ask(m.Arm(3, 1, 1), session=SESSION)
    assert isinstance(answer, Received)
    assert answer.message == m.Ack(3, type_id_of(m.Arm), Status.BAD_STATE, State.FAULT, 0, 0)
    assert pair.host.state is State.FAULT


@pytest.mark.parametrize(
    ("message", "before", "after"),
    [
        (m.SetCommit(2), State.IDENTIFIED, State.CONFIGURED),
        (m.Arm(3, 1, 1), State.CONFIGURED, State.ARMED),
        (m.Disarm(4, 0), State.RUNNING, State.CONFIGURED),
    ],
)
def test_a_repeated_request_is_done_once(pair: Pair, message: Message, before: State, after: State) -> None:
    pair.bring_to(before)
    pair.executed.clear()
    session = SESSION if isinstance(message, m.Arm) else None
    pair.answer(pair.host.send(message, session=session))  # the answer is lost
    assert (pair.host.state, pair.device.state) == (before, after)
    received = pair.ask(message, session=session)
    assert pair.executed == [message]
    assert len(received) == 1
    assert (pair.host.state, pair.device.state) == (after, after)
    assert pair.host.session == pair.device.session


def test_reply_to_a_superseded_request_does_not_arm(pair: Pair) -> None:
    pair.bring_to(State.CONFIGURED)
    answer = pair.answer(pair.host.send(m.Arm(3, 1, 1), session=SESSION))
    events(pair.host, answer)
    pair.answer(pair.host.send(m.Command(0, 3000, 0, 0, 0)))
    assert len(events(pair.host, answer)) == 1
    assert pair.host.state is State.RUNNING
    pair.ask(m.Disarm(4, 0))
    assert len(events(pair.host, answer)) == 1
    assert (pair.host.state, pair.host.session) == (State.CONFIGURED, 0)


def test_questions_are_executed_each_time_and_changes_of_another_host_too(pair: Pair) -> None:
    pair.bring_to(State.IDENTIFIED)
    pair.executed.clear()
    for _ in range(2):
        pair.ask(m.GetTime(5, 1))
    for _ in range(2):  # a new process that happens to begin with the same nonce
        pair.ask(m.SetBegin(2, 0, 0))
        pair.ask(m.SetCommit(2))
    assert len(pair.executed) == 6
    pair.ask(m.SetCommit(2))
    assert len(pair.executed) == 6
    pair.replies.forget()
    pair.ask(m.SetCommit(2))
    assert len(pair.executed) == 7


def test_another_major_stops_the_host_with_both_numbers(pair: Pair) -> None:
    frame = encode_frame(HEADER.pack(m.MAJOR + 1, type_id_of(m.State), 0, 0, 0) + bytes(34))
    pair.host.receive_data(frame + encode_frame(pack(state_message(State.IDENTIFIED))))
    with pytest.raises(IncompatibleMajorError, match=f"major protocol version {m.MAJOR + 1}") as caught:
        pair.host.next_event()
    assert (caught.value.ours, caught.value.theirs) == (m.MAJOR, m.MAJOR + 1)
    assert pair.host.next_event() is not None, "the frame is dropped, the connection continues"


def test_an_echo_is_counted_and_dropped(pair: Pair) -> None:
    assert events(pair.host, pair.host.send(m.Identify(1, 0))) == []
    assert pair.host.statistics.wrong_direction == 1


def test_a_state_that_does_not_exist_is_malformed(pair: Pair) -> None:
    assert events(pair.host, encode_frame(pack(m.State(*[0] * 12, 77, 0, 0, 0)))) == []
    assert pair.host.statistics.malformed == 1


def test_a_value_that_does_not_fit_sends_nothing_and_changes_nothing(pair: Pair) -> None:
    pair.bring_to(State.ARMED)
    with pytest.raises(LocalProtocolError):
        pair.host.send(m.Command(0, 3000, 0, 0, 1 << 15))
    assert pair.host.state is State.ARMED
    assert pair.host.sequence_to_send(m.Command) == 0


# ---------------------------------------------------------------------- sequences


def command_frame(sequence: int) -> bytes:
    return encode_frame(pack(m.Command(sequence, 3000, 0, 0, 0), session=SESSION, sequence=sequence))


@given(st.integers(0, 65535), st.lists(st.integers(0, 40), min_size=1, max_size=30))
def test_losses_repeats_and_reordering_are_counted_round_the_circle(start: int, offsets: list[int]) -> None:
    pair = Pair()
    pair.bring_to(State.ARMED)
    delivered = []
    for offset in offsets:
        received = events(pair.device, command_frame((start + offset) & 0xFFFF))
        delivered += [(event.sequence - start) & 0xFFFF for event in received if isinstance(event, Received)]
    # The oracle: a frame is new if it is ahead of every frame before it.
    news = [offset for i, offset in enumerate(offsets) if all(offset > earlier for earlier in offsets[:i])]
    newest = [max(offsets[:i]) for i in range(1, len(offsets))]
    assert delivered == news
    statistics = pair.device.statistics
    assert statistics.lost == news[-1] - news[0] + 1 - len(news)
    assert statistics.duplicated == sum(a == b for a, b in zip(offsets[1:], newest, strict=True))
    assert statistics.reordered == sum(a < b for a, b in zip(offsets[1:], newest, strict=True))


def test_a_late_batch_is_still_delivered_but_not_twice_in_a_row(pair: Pair) -> None:
    pair.bring_to(State.RUNNING)
    frames = [pair.device.send(m.Batch(7 * i, 0, 0, 0, b"")) for i in range(3)]
    order = [0, 2, 1, 2]
    received = [event for i in order for event in events(pair.host, frames[i])]
    assert [event.message.first_index for event in received] == [0, 14, 7]  # type: ignore[union-attr]
    assert (pair.host.statistics.reordered, pair.host.statistics.duplicated) == (1, 1)


def test_the_sequence_of_a_stream_begins_anew_with_each_session(pair: Pair) -> None:
    pair.bring_to(State.CONFIGURED)
    for _ in range(3):
        events(pair.host, pair.device.send(state_message(State.CONFIGURED)))
    pair.ask(m.Arm(3, 1, 1), session=SESSION)
    (event,) = events(pair.host, pair.device.send(state_message(State.ARMED)))
    assert isinstance(event, Received)
    assert (event.session, event.sequence) == (SESSION, 0)
    assert pair.host.statistics.lost == 0


def test_a_compiled_loop_takes_the_stream_and_gives_it_back(pair: Pair) -> None:
    pair.bring_to(State.ARMED)
    first = pair.host.sequence_to_send(m.Command)
    pair.host.receive_data(b"\x05half a frame")  # the rest of it goes to the loop
    for sequence in range(first, first + 10):
        events(pair.device, command_frame(sequence))
    for _ in range(20):
        state = pair.device.send(state_message(State.RUNNING))
    pair.host.resume(next_command=first + 10, newest_state=18, state=State.RUNNING)
    (event,) = events(pair.host, state)
    assert isinstance(event, Received)
    assert event.sequence == 19
    assert len(events(pair.device, pair.host.send(m.Command(19, 3000, m.Mode.STOP, 0, 0)))) == 1
    statistics = pair.device.statistics
    assert (statistics.lost, statistics.duplicated, pair.host.statistics.lost) == (0, 0, 0)
    with pytest.raises(LocalProtocolError):
        pair.device.resume(next_command=0, newest_state=0, state=State.RUNNING)


# ---------------------------------------------------------------------- bytes from anywhere


def receive_all(connection: Connection, pieces: list[bytes]) -> list[Event | str]:
    """Receive all pieces; return the events and the names of the errors."""
    received: list[Event | str] = []
    for piece in pieces:
        connection.receive_data(piece)
        while True:
            try:
                event = connection.next_event()
            except RemoteProtocolError as error:
                received.append(type(error).__name__)
                continue
            if event is None:
                break
            received.append(event)
    return received


def header_bytes() -> st.SearchStrategy[bytes]:
    types = st.sampled_from(sorted(m.MESSAGES)) | st.integers(0, 255)
    sessions = st.sampled_from([0, SESSION]) | st.integers(0, 255)
    return st.builds(
        HEADER.pack, st.sampled_from([1, 1, 1, 2]), types, st.integers(0, 255), sessions,
        st.integers(0, 65535),
    )  # fmt: skip


good_crc = st.builds(
    lambda header, payload: encode_frame(header + payload), header_bytes(), st.binary(max_size=60)
)
sensible = st.builds(
    lambda message, session, sequence: encode_frame(pack(message, session=session, sequence=sequence)),
    any_message(),
    st.sampled_from([0, SESSION]),
    st.integers(0, 5),
)
anything = st.lists(good_crc | sensible | st.binary(max_size=300), max_size=12).map(b"".join)


@given(st.sampled_from(Role), st.sampled_from(State), anything)
def test_arbitrary_bytes_give_events_or_remote_protocol_errors(role: Role, state: State, data: bytes) -> None:
    pair, twin = Pair(), Pair()
    pair.bring_to(state)
    twin.bring_to(state)
    whole, single = ((p.host if role is Role.HOST else p.device) for p in (pair, twin))
    received = receive_all(whole, [data])
    assert receive_all(single, [bytes([byte]) for byte in data]) == received, "byte by byte as whole"
    assert single.statistics == whole.statistics
    assert whole.state in State
    assert len(whole._splitter._pending) <= ENCODED_LIMIT
    assert len(whole._open_requests) <= OPEN_LIMIT
    for event in received:
        if role is Role.DEVICE and not isinstance(event, str) and event.request < 0x40:
            whole.send(event.ack() if isinstance(event, Refused) else event.ack(Status.UNSUPPORTED))


def test_untaken_frames_are_bounded_and_counted(pair: Pair) -> None:
    frame = encode_frame(pack(m.Identify(1, 0)))
    pair.device.receive_data(frame * (QUEUE_LIMIT + 10))
    assert pair.device.statistics.overrun == 10
    assert len(list(iter(pair.device.next_event, None))) == QUEUE_LIMIT
    assert len(pair.device._open_requests) == 1


def test_open_requests_are_bounded(pair: Pair) -> None:
    pair.bring_to(State.IDENTIFIED)
    for nonce in range(10 * OPEN_LIMIT):
        pair.host.send(m.GetTime(nonce, 0))
    assert len(pair.host._open_requests) == OPEN_LIMIT
