"""Transactions of the host: retries, rejected requests, sessions of other hosts, and closing without errors."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from firmware_protocol import dictionary as dictionaries
from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Status
from firmware_protocol.framing import decode_frame, encode_frame
from firmware_protocol.messages import STOP_FRAMES
from firmware_protocol.packing import pack, type_id_of, unpack
from firmware_protocol.parameters import BY_NAME, block_crc, encode_block
from firmware_protocol.transaction import MOST_TRIES, RETRY_AFTER_S
from rig.core.errors import DeviceRefusedError, IncompatibleDeviceError, LinkLostError
from rig.devices import framed
from rig.devices.device import DeviceUrl
from rig.devices.fault_script import DeviceFault, Direction, FaultKind, Faults, FrameFault
from rig.devices.framed import FAULT_LOG_S, READY_AGAIN_S, FramedDevice
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.claimed import claim_to_be_real
from tests.conformance.host import RUN_PARAMETERS
from tests.conformance.rigs import linear_rig, rotary_rig
from tests.conformance.tiers import first_by_default


class Wire:
    """A link that records the frames of both ends, the host's with their times."""

    def __init__(self, link: Any) -> None:
        self.link = link
        self.url, self.clock, self.bytes_per_second = link.url, link.clock, link.bytes_per_second
        self.sent = []
        self.received = b""

    def read(self, timeout_s: Any) -> Any:
        data = self.link.read(timeout_s)
        self.received += data
        return data

    def write(self, data: Any) -> None:
        self.sent.append((self.clock.now_ns(), data))
        self.link.write(data)

    def close(self) -> None:
        self.link.close()

    def messages(self) -> Any:
        """Return the frames of the host, decoded."""
        return [decoded(frame) for _, frame in self.sent]

    def answers(self, kind: Any) -> Any:
        frames = [frame + b"\0" for frame in self.received.split(b"\0") if frame]
        return [message for message in map(decoded, frames) if isinstance(message, kind)]


def decoded(frame: Any) -> Any:
    return unpack(decode_frame(frame.rstrip(b"\0")))[1]


def make(*, faults: Any = None, **options: Any) -> Any:
    """Return a device, the wire to it, and a host without cached dictionaries."""
    framed._dictionaries.clear()
    simulated = SimulatedDevice(rotary_rig(), **options)
    wire = Wire(MemoryLink(simulated, faults))
    return simulated, wire, FramedDevice(wire)


def configured(**options: Any) -> Any:
    simulated, wire, device = make(**options)
    device.configure(RUN_PARAMETERS)
    return simulated, wire, device


def armed(**options: Any) -> Any:
    simulated, wire, device = configured(**options)
    device.arm()
    return simulated, wire, device


def drive(wire: Any, device: Any) -> None:
    wire.write(device.connection.send(m.Command(0, 20_000, int(m.Mode.CURRENT), 0, 300)))
    wire.link.elapse(0.005)


class Answering:
    """A far end in virtual time that replies by one function of the request."""

    def __init__(self, answer: Any) -> None:
        self._link = MemoryLink(SimulatedDevice(rotary_rig()))
        self.url, self.clock, self.bytes_per_second = DeviceUrl.parse("sim://strange"), self._link.clock, None
        self._answer = answer
        self._arrived = b""

    def read(self, timeout_s: Any) -> Any:
        data, self._arrived = self._arrived, b""
        if not data:
            self.clock.sleep_until(self.clock.now_ns() + round(timeout_s * 1e9))
        return data

    def write(self, data: Any) -> None:
        self._arrived += self._answer(unpack(decode_frame(data.rstrip(b"\0")))[1])

    def close(self) -> None:
        pass


# ---------------------------------------------------------------------- retries


def test_a_request_without_reply_is_sent_four_times_and_the_link_is_lost() -> None:
    silence = [FrameFault(kind=FaultKind.SILENCE, direction=direction, frame=0) for direction in Direction]
    _, wire, device = make(faults=Faults(frames=tuple(silence)))
    with pytest.raises(LinkLostError, match="no reply to Identify") as caught:
        device.identify()
    times_ms = [time_ns / 1e6 for time_ns, _ in wire.sent]
    assert times_ms == pytest.approx([0.0, 20.0, 60.0, 140.0])
    assert wire.clock.now_ns() * 1e-9 == pytest.approx(sum(RETRY_AFTER_S) + RETRY_AFTER_S[-1])
    assert len({message.nonce for message in wire.messages()}) == 1, "a repeat is the same request"
    assert "baud" in caught.value.remedy
    assert caught.value.statistics.frames == 0
    assert caught.value.exit_code == 6


@pytest.mark.parametrize("direction", first_by_default(Direction))
def test_one_lost_frame_of_any_transaction_costs_a_repeat_and_nothing_else(direction: Any) -> None:
    _, clean, device = make(faults=Faults())
    echo = device.configure(RUN_PARAMETERS)
    device.arm()
    device.disarm()
    requests = len(clean.sent)
    # Pages and chunks are all alike: a few of them, and the last requests.
    for frame in [0, requests // 2, *range(requests - 20, requests - 4, 4), *range(requests - 4, requests)]:
        fault = FrameFault(kind=FaultKind.DROP, direction=direction, frame=frame)
        simulated, wire, device = make(faults=Faults(frames=(fault,)))
        assert device.configure(RUN_PARAMETERS).values == echo.values
        device.arm()
        device.disarm()
        assert wire.link.line.acted[FaultKind.DROP] == 1
        assert len(wire.sent) == requests + 1
        assert simulated.connection.state is State.CONFIGURED


def test_a_late_answer_to_an_earlier_step_is_not_taken_for_the_answer() -> None:
    """The ACKs of BEGIN, CHUNKs and COMMIT share a nonce: a duplicated ACK must not answer the next request."""
    seen = []

    def answer(request: Any) -> Any:
        if isinstance(request, m.Identify):
            return identity_of(request, PACKED)
        if isinstance(request, m.SetBegin | m.SetChunk):
            offset = getattr(request, "offset", 0)
            ack = frame_of(m.Ack(request.nonce, type_id_of(type(request)), 0, offset, 0, 0))
            old, seen[:] = b"".join(seen), [ack]
            return old + ack + ack
        assert isinstance(request, m.SetCommit)
        stale = b"".join(seen)
        return stale + frame_of(m.Ack(request.nonce, type_id_of(m.SetCommit), Status.BAD_CRC, 0, 0, 0))

    device = FramedDevice(Answering(answer))
    with pytest.raises(DeviceRefusedError, match="refused SetCommit") as caught:
        device.configure(RUN_PARAMETERS)
    assert caught.value.status == Status.BAD_CRC


PACKED = dictionaries.encode(
    dictionaries.build(device="strange", firmware="1", simulated=True, current_quantum_a=0.001)
)


def frame_of(message: Any, major: Any = m.MAJOR) -> Any:
    return encode_frame(bytes([major]) + pack(message)[1:])


# ---------------------------------------------------------------------- incompatible devices


def identity_of(request: Any, packed: bytes, number: int | None = None) -> Any:
    """Return the requested page of a dictionary, under its hash or another number."""
    number = dictionaries.dictionary_hash(packed) if number is None else number
    piece = packed[request.offset : request.offset + 30]
    return frame_of(
        m.Identity(request.nonce, 0, State.IDENTIFIED, number, len(packed), request.offset, piece)
    )


def page_of(request: Any, number: int, offset: int, major: int = m.MAJOR) -> Any:
    return frame_of(m.Identity(request.nonce, 0, 1, number, 100, offset, b"0123456789"), major)


INVALID = {
    "no dictionary": lambda request: identity_of(request, b"this is no dictionary"),
    "another hash": lambda request: identity_of(request, PACKED, 7),
    "a hash that changes": lambda request: page_of(request, request.offset, request.offset),
    "one page for ever": lambda request: page_of(request, 7, 0),
}


def test_a_device_of_another_major_version_is_named_with_both_versions() -> None:
    device = FramedDevice(Answering(lambda request: page_of(request, 7, 0, m.MAJOR + 1)))
    with pytest.raises(IncompatibleDeviceError) as caught:
        device.identify()
    assert f"uses protocol {m.MAJOR + 1}, this package uses {m.MAJOR}" in str(caught.value)
    assert "firmware" in caught.value.remedy
    assert caught.value.exit_code == 4


@pytest.mark.parametrize("answer", INVALID)
def test_a_dictionary_that_makes_no_sense_is_an_incompatible_device(answer: str) -> None:
    device = FramedDevice(Answering(INVALID[answer]))
    with pytest.raises(IncompatibleDeviceError, match="sends invalid data"):
        device.identify()


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        (m.Time(0, 0, 0, 0), "replied Time, which does not belong"),
        (m.Ack(0, 0, 200, 0, 0, 0), r"refused Identify: status 200 .unknown to this"),
        (m.Ack(0, 0, Status.BAD_STATE, 99, 0, 0), r"refused Identify: .*\(state 99\)"),
    ],
)
def test_a_reply_that_this_package_does_not_know_is_a_refusal_that_names_it(reply: Any, words: str) -> None:
    device = FramedDevice(Answering(lambda request: frame_of(replace(reply, nonce=request.nonce))))
    with pytest.raises(DeviceRefusedError, match=words) as refused:
        device.identify()
    assert refused.value.remedy
    if "status 200" in words:
        with pytest.raises(DeviceRefusedError, match=words):
            device.status_of(m.Identify(0, 0))


@pytest.mark.parametrize("stamps", [(0, 2**64 - 1), (2**64 - 1, 0)])
def test_a_device_time_out_of_range_is_an_incompatible_device(stamps: Any) -> None:
    _, wire, device = make()
    assert device.dictionary
    wire.link = Answering(lambda request: frame_of(m.Time(request.nonce, 0, *stamps)))
    with pytest.raises(IncompatibleDeviceError, match="a device time of"):
        device.exchange_clock()


def test_a_fault_log_or_a_parameter_block_that_makes_no_sense_is_an_incompatible_device() -> None:
    _, wire, device = configured()
    wire.link = Answering(lambda request: frame_of(m.FaultLog(request.nonce, 1, 0, 0, 5, 0, b"123")))
    with pytest.raises(IncompatibleDeviceError, match="sends invalid data"):
        device.fault_report()
    answer_with(wire, device, b"\xff\xff\xff")
    with pytest.raises(IncompatibleDeviceError, match="parameter"):
        device.configure(RUN_PARAMETERS)


def test_parameters_that_are_not_those_of_the_acknowledged_checksum_are_refused() -> None:
    _, wire, device = configured()
    answer_with(wire, device, encode_block(RUN_PARAMETERS), crc=1)
    with pytest.raises(DeviceRefusedError, match="differ from those that were sent"):
        device.configure(RUN_PARAMETERS)


def answer_with(wire: Any, device: FramedDevice, block: bytes, crc: int | None = None) -> None:
    """Replace the device by one whose active parameters are `block`; it acknowledges `crc`, by default the block's."""

    def reply(request: Any) -> bytes:
        if isinstance(request, m.GetParameters):
            chunk = block[request.offset : request.offset + 40]
            return frame_of(m.Parameters(request.nonce, len(block), block_crc(block), request.offset, chunk))
        if isinstance(request, m.Identify):
            return frame_of(m.Identity(request.nonce, 0, State.CONFIGURED, known, 1, 0, b"x"))
        detail = getattr(request, "offset", 0)
        acknowledged = block_crc(block) if crc is None else crc
        return frame_of(m.Ack(request.nonce, type_id_of(type(request)), 0, detail, 0, acknowledged))

    known = device.dictionary_hash
    wire.link = Answering(reply)


# ---------------------------------------------------------------------- refusals


def test_a_refused_parameter_is_named_with_the_range_that_the_device_allows() -> None:
    _, _, device = make()
    peak = device.dictionary.parameter("current_limit").maximum
    with pytest.raises(DeviceRefusedError) as caught:
        device.configure({**RUN_PARAMETERS, "current_limit": int(peak) + 1})
    assert caught.value.status == Status.OUT_OF_RANGE
    assert f"current_limit, allowed 0 … {peak:g}" in str(caught.value)
    assert caught.value.remedy


def pages(wire: Any) -> Any:
    return sum(isinstance(message, m.GetParameters) for message in wire.messages())


def test_parameters_with_a_matching_fingerprint_are_not_read() -> None:
    simulated, wire, device = make()
    echo = device.configure(RUN_PARAMETERS)
    assert pages(wire) == 0
    assert FramedDevice(MemoryLink(simulated)).active_parameters() == echo.values
    part = device.configure({"ramp_us": 5_000})
    assert pages(wire) == 0
    assert part.values == {**echo.values, "ramp_us": 5_000, "verified": 0}
    assert FramedDevice(MemoryLink(simulated)).active_parameters() == part.values


def test_parameters_without_a_matching_fingerprint_are_read() -> None:
    simulated, _, stranger = make()
    stranger.configure({**RUN_PARAMETERS, "slew_limit": 77})
    wire = Wire(MemoryLink(simulated))
    heir = FramedDevice(wire)
    values = {name: value for name, value in RUN_PARAMETERS.items() if name != "slew_limit"}
    echo = heir.configure(values)
    assert pages(wire) > 10
    assert echo.values["slew_limit"] == 77
    assert echo.values == heir.active_parameters()


def test_a_known_dictionary_is_recognised_by_its_hash() -> None:
    simulated, wire, device = make()
    known = device.dictionary
    read = len(wire.sent)
    assert read > 10
    wire = Wire(MemoryLink(simulated))
    again = FramedDevice(wire)
    assert again.dictionary == known
    assert again.dictionary_hash == device.dictionary_hash
    assert len(wire.sent) == 1
    other = SimulatedDevice(linear_rig())
    assert FramedDevice(MemoryLink(other)).dictionary != known


def test_a_stale_session_is_answered_with_another_number() -> None:
    """The device stores the number of the last session; a newly started host does not know it."""
    simulated, _, first = make()
    first.configure(RUN_PARAMETERS)
    used = first.arm()
    first.disarm()
    wire = Wire(MemoryLink(simulated))
    second = FramedDevice(wire)
    second.configure(RUN_PARAMETERS)
    second._nonce = used - 2  # so that its first choice is the number used last
    assert second.arm() == used % 255 + 1
    assert [type(message) for message in wire.messages()[-2:]] == [m.Arm, m.Arm]
    assert wire.answers(m.Ack)[-2].status == Status.STALE_SESSION
    assert simulated.connection.state is State.ARMED


def test_a_device_that_is_not_ready_is_asked_again_until_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such a device may still compute its excitation; the timeout counts in the link's time."""
    monkeypatch.setattr(framed, "READY_S", 3.0)
    simulated, wire, device = configured()
    answers = iter([Status.NOT_READY] * 3 + [None] * 9)
    true_arm, start_ns = device._arm, wire.clock.now_ns()

    def arm(session: Any) -> None:
        if (status := next(answers)) is not None:
            raise DeviceRefusedError("not ready", status=status)
        true_arm(session)

    device._arm = arm
    device.arm()
    assert simulated.connection.state is State.ARMED
    assert wire.clock.now_ns() - start_ns >= 3 * round(READY_AGAIN_S * 1e9)
    device.disarm()
    answers = iter([Status.NOT_READY] * 10_000)
    with pytest.raises(DeviceRefusedError) as refused:
        device.arm()
    assert refused.value.status == Status.NOT_READY
    assert 3.0 <= (wire.clock.now_ns() - start_ns) * 1e-9 < 4.0


def test_a_device_that_calls_every_session_stale_is_not_asked_for_ever() -> None:
    _, _, device = configured()
    asked = []

    def arm(session: Any) -> None:
        asked.append(session)
        raise DeviceRefusedError("stale", status=Status.STALE_SESSION)

    device._arm = arm
    with pytest.raises(DeviceRefusedError):
        device.arm()
    assert len(set(asked)) == 2


def test_parameters_that_a_loop_has_changed_are_ours() -> None:
    _, wire, device = armed()
    streams = {"next_command": 0, "newest_state": 0, "state": int(State.RUNNING), "nonce": 9}
    device.take_back(**streams, parameters_crc=0x12345678)
    device.disarm()
    with pytest.raises(DeviceRefusedError) as refused:  # this device took none, and so compares
        device.arm()
    assert refused.value.status == Status.HASH_MISMATCH
    assert wire.messages()[-1].parameters_crc == 0x12345678


def test_any_number_of_sessions_can_follow_each_other_on_one_device() -> None:
    _, _, device = configured()
    previous = 0
    for _ in range(260):
        device._nonce = (previous - 2) % 0x10000
        session = device.arm()
        assert 1 <= session <= 255
        assert session != previous
        previous = session
        device.disarm()


def test_a_fault_in_the_middle_of_configuring_is_a_refusal() -> None:
    """The BEGIN is lost, and before its retry the device enters FAULT, in which it rejects BEGIN."""
    _, wire, device = configured(faults=Faults())
    begin = next(i for i, message in enumerate(wire.messages()) if isinstance(message, m.SetBegin))
    _, wire, device = make(
        faults=Faults(
            (FrameFault(kind=FaultKind.DROP, direction=Direction.TO_DEVICE, frame=begin),),
            (DeviceFault(5, Fault.ENCODER),),
        )
    )
    with pytest.raises(DeviceRefusedError, match="FAULT"):
        device.configure(RUN_PARAMETERS)
    assert device.configure(RUN_PARAMETERS), "and the next attempt clears it"


# ---------------------------------------------------------------------- taking over


@pytest.mark.parametrize("left_in", [State.ARMED, State.RUNNING, State.FAULT])
def test_a_device_of_a_dead_host_is_taken_over_by_configuring_it(left_in: Any) -> None:
    simulated, wire, first = armed()
    if left_in is not State.ARMED:
        drive(wire, first)
    if left_in is State.FAULT:
        wire.link.elapse(0.1)
    assert simulated.connection.state is left_in
    second = FramedDevice(MemoryLink(simulated))
    second._nonce = 20_000
    second.configure(RUN_PARAMETERS)
    assert simulated.connection.state is State.CONFIGURED
    assert simulated.current == 0
    assert second.arm() != first.connection.session


def test_a_fault_whose_cause_is_still_there_is_not_cleared() -> None:
    simulated, wire, device = armed()
    simulated.press_emergency_stop()
    wire.link.elapse(0.01)
    with pytest.raises(DeviceRefusedError) as caught:
        device.configure(RUN_PARAMETERS)
    assert caught.value.status == Status.FAULT_PRESENT
    assert "emergency stop" in str(caught.value), "the fault by name, not a parameter of the same number"


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make simulated devices claim to be real ones, whose zero a person sets once a session."""
    claim_to_be_real(monkeypatch)


def stay_alone(simulated: Any, wire: Any) -> None:
    pass


def meet_another(simulated: Any, wire: Any) -> None:
    FramedDevice(MemoryLink(simulated)).identify()


def break_encoder(simulated: Any, wire: Any) -> None:
    """Cause a fault that hides the state BOOT, so that only the parameters show the restart."""
    simulated.inject_fault(Fault.ENCODER)
    wire.link.elapse(0.01)


def be_configured(simulated: Any, wire: Any) -> None:
    FramedDevice(MemoryLink(simulated)).configure({**RUN_PARAMETERS, "reference_count": 77})


@pytest.mark.parametrize("then", [stay_alone, meet_another, break_encoder, be_configured])
def test_a_real_device_that_restarted_is_not_armed_with_the_old_zero(then: Any, real: None) -> None:
    simulated, wire, device = armed()
    device.disarm()
    simulated.reset()
    then(simulated, wire)
    for _ in range(2):
        with pytest.raises(DeviceRefusedError, match="has restarted") as caught:
            device.configure(RUN_PARAMETERS)
    assert "position zero" in caught.value.remedy
    assert caught.value.status == Status.NOT_HOMED
    assert not any(isinstance(message, m.SetBegin) for message in wire.messages()[-4:])
    FramedDevice(MemoryLink(simulated)).configure(RUN_PARAMETERS)  # a new session has a new zero


def test_counts_that_a_real_device_lost_in_the_middle_of_a_session_shift_its_zero_as_well(real: None) -> None:
    simulated, wire, device = configured()
    simulated.inject_fault(Fault.ENCODER)
    wire.link.elapse(0.01)
    with pytest.raises(DeviceRefusedError, match="lost counts"):
        device.configure(RUN_PARAMETERS)
    heir = FramedDevice(wire.link)  # reads its own zero, and so may clear the fault
    heir.configure(RUN_PARAMETERS)
    assert heir.cleared_fault.code == Fault.ENCODER


def test_a_restart_between_reading_the_zero_and_configuring_is_noticed_too(real: None) -> None:
    simulated, _, device = make()
    device.count()
    simulated.reset()
    with pytest.raises(DeviceRefusedError, match="has restarted"):
        device.configure(RUN_PARAMETERS)


def test_a_real_device_is_configured_again_as_often_as_one_likes(real: None) -> None:
    """Trials, faults and rejected parameters do not count as restarts."""
    simulated, wire, device = make()
    for stiffness in (100.0, 200.0):
        device.configure({**RUN_PARAMETERS, "float_stiffness": stiffness})
        device.arm()
        device.disarm()
    with pytest.raises(DeviceRefusedError):
        device.configure({**RUN_PARAMETERS, "current_limit": 32_767})
    device.configure(RUN_PARAMETERS)
    simulated.inject_fault(Fault.OVER_CURRENT)
    wire.link.elapse(0.01)
    device.configure(RUN_PARAMETERS)
    assert device.cleared_fault.code == Fault.OVER_CURRENT
    device.arm()


def test_a_lost_answer_to_the_parameters_is_no_restart(real: None) -> None:
    """The parameters may be active or not, so their values do not prove a restart."""
    other = {**RUN_PARAMETERS, "float_stiffness": 333.0}
    _, wire, device = configured(faults=Faults())
    first = wire.link.line.frames[Direction.TO_HOST]
    device.configure(other)
    for frame in range(first, wire.link.line.frames[Direction.TO_HOST]):
        silence = FrameFault(kind=FaultKind.SILENCE, direction=Direction.TO_HOST, frame=frame)
        simulated, wire, device = make(faults=Faults(frames=(silence,)))
        device.configure(RUN_PARAMETERS)
        with pytest.raises(LinkLostError):
            device.configure(other)
        wire.link.line._silent.clear()  # the plug is back in
        device.configure(RUN_PARAMETERS)
        assert simulated.connection.state is State.CONFIGURED


# ---------------------------------------------------------------------- ending


def test_stop_sends_zero_several_times_and_closing_disarms() -> None:
    simulated, wire, device = armed()
    drive(wire, device)
    assert simulated.current == 300
    before = len(wire.sent)
    device.stop()
    assert simulated.current == 0
    stops = wire.messages()[before:]
    assert len(stops) == STOP_FRAMES
    assert all(stop.mode == m.Mode.STOP and stop.current == 0 for stop in stops)
    drive(wire, device)
    with device:
        pass
    assert (simulated.connection.state, simulated.current) == (State.CONFIGURED, 0)
    with pytest.raises(LinkLostError):
        wire.link.write(b"x")


@pytest.mark.parametrize("break_it", ["closed", "unplugged", "disarmed", "bug"])
def test_stop_and_close_never_raise(break_it: str) -> None:
    simulated, wire, device = armed(faults=Faults())
    if break_it == "closed":
        wire.close()
    elif break_it == "unplugged":
        wire.link.line.unplugged = True
    elif break_it == "disarmed":
        device.disarm()
    else:
        simulated.receive = lambda data: 1 // 0  # a bug
    device.stop()
    device.close()
    device.close()


@pytest.mark.parametrize("back", [False, True], ids=["gone", "back"])
@pytest.mark.parametrize("ways", [tuple(Direction), (Direction.TO_DEVICE,)], ids=["nothing", "STATE"])
def test_closing_without_replies_sends_each_frame_and_does_not_wait(ways: Any, back: bool) -> None:
    """A transaction times out after more than the lifetime of a COMMAND, so the effort is zero by then."""
    simulated, wire, device = armed(faults=Faults())
    drive(wire, device)
    line = wire.link.line
    line.add([FrameFault(kind=FaultKind.SILENCE, direction=d, frame=line.frames[d]) for d in ways])
    with pytest.raises(LinkLostError):
        device.has_restarted()
    assert simulated.current == 0
    assert simulated.fault == Fault.LINK_LOST
    if back:
        line._silent.clear()
    before, since_ns = len(wire.sent), wire.clock.now_ns()
    stops = 0 if device.connection.state is State.FAULT else STOP_FRAMES  # a device in FAULT takes no COMMAND
    device.close()
    assert wire.clock.now_ns() == since_ns
    sent = [type(message) for message in wire.messages()[before:]]
    assert sent == [m.Command] * stops + [m.Disarm] * MOST_TRIES
    assert (simulated.connection.state is State.CONFIGURED) == back


def test_a_transaction_is_given_up_after_more_than_a_command_lives() -> None:
    most = {
        name: BY_NAME[name].maximum for name in ("command_lifetime_us", "supervise_lifetime_us", "ramp_us")
    }
    lives_us = max(most["command_lifetime_us"], most["supervise_lifetime_us"]) + most["ramp_us"]
    assert sum(RETRY_AFTER_S) + RETRY_AFTER_S[-1] > 1e-6 * lives_us


def test_the_host_can_stop_a_device_in_an_unknown_state() -> None:
    simulated, wire, device = armed()
    device.take_back(next_command=3, newest_state=77, state=200, nonce=9)
    assert (device.connection.sequence_to_send(m.Command), device.connection.state) == (3, State.RUNNING)
    before = len(wire.sent)
    device.stop()
    assert len(wire.sent) == before + STOP_FRAMES
    device.disarm()
    assert simulated.connection.state is State.CONFIGURED


# ---------------------------------------------------------------------- asking


def test_exchanges_lie_at_odd_distances() -> None:
    """Even distances would beat with the ticks of the device."""
    _, wire, device = make()
    stamps = device.exchange_clock(20, over_s=1.0)
    distances = np.diff(stamps["host_sent"])
    assert stamps["host_sent"][-1] - stamps["host_sent"][0] == pytest.approx(1e9, abs=2)
    assert (distances > 0).all()
    for period_ns in (1_000_000, 10_000_000):  # frames of a bus, STATE of a device that is not armed
        phases = np.sort(stamps["host_sent"] % period_ns) / period_ns
        assert np.diff(phases, append=1.0 + phases[0]).max() < 0.25
    asked = [message.host_sent for message in wire.messages() if isinstance(message, m.GetTime)]
    assert asked == stamps["host_sent"].tolist()


def test_a_request_that_had_to_be_repeated_took_from_its_first_frame_on() -> None:
    _, wire, device = make(faults=Faults())
    assert device.dictionary.simulated
    asked = wire.link.line.frames[Direction.TO_DEVICE]
    lost = FrameFault(kind=FaultKind.DROP, direction=Direction.TO_DEVICE, frame=asked + 1)
    _, wire, device = make(faults=Faults(frames=(lost,)))
    assert device.dictionary.simulated
    stamps = device.exchange_clock(4)
    trips = stamps["host_received"] - stamps["host_sent"]
    assert trips[1] >= RETRY_AFTER_S[0] * 1e9
    assert (np.delete(trips, 1) == 0).all()
    assert (np.diff(stamps["device_received"]) >= 0).all()


def test_the_fault_report_pages_through_the_whole_ring_of_ticks() -> None:
    simulated, wire, device = configured()
    wire.link.elapse(0.5)
    simulated.inject_fault(Fault.ENCODER)
    report = device.fault_report()
    assert (report.code, report.name) == (Fault.ENCODER, "ENCODER")
    assert report.text == Fault.ENCODER.text
    assert report.remedy == Fault.ENCODER.remedy
    indices = [entry["sample_index"] for entry in report.entries]
    assert len(indices) == 256
    assert indices == list(range(indices[0], indices[0] + 256))
    pages = [message for message in wire.messages() if isinstance(message, m.GetFaultLog)]
    assert len(pages) > 10
    assert report.device_time_ns == pytest.approx(simulated.time_ns, abs=2_000_000)


def test_reading_the_ticks_of_a_slow_device_is_bounded() -> None:
    """The report contains the pages that arrived in time, the oldest ticks first."""
    simulated, wire, device = configured(faults=Faults())
    wire.link.elapse(0.5)
    simulated.inject_fault(Fault.ENCODER)
    quickly, before = wire.write, wire.clock.now_ns()

    def write(data: bytes) -> None:
        wire.clock.sleep_until(wire.clock.now_ns() + 100_000_000)
        quickly(data)

    wire.write = write
    report = device.fault_report()
    assert FAULT_LOG_S <= (wire.clock.now_ns() - before) * 1e-9 <= FAULT_LOG_S + 0.2
    assert report.name == "ENCODER"
    assert 0 < len(report.entries) < 256
    indices = [entry["sample_index"] for entry in report.entries]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
