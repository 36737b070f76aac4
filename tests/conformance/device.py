"""The conformance suite of a device, tested over its link.

`check_device` sends requests through a real link and uses only the device's replies. The simulated device, its process,
the firmware and a real rig run it alike; a rig on a bench must be free to move by a few counts.
"""

import itertools
import random
import time
from collections.abc import Callable

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input, LimitFlag, Status
from firmware_protocol.framing import decode_frame, encode_frame
from firmware_protocol.packing import pack, unpack_fault_entries
from firmware_protocol.parameters import BY_NAME, block_crc, decode_block, encode_block
from rig.devices.device import Link
from tests.conformance.host import RUN_PARAMETERS, Host

UNITS_PER_US = 16
PROBE_CURRENT = 100  # quanta: small enough for a bench, large enough to see a ramp
MakeLink = Callable[[], Link]


def check_device(make_device_connection: MakeLink, *, starts_in_boot: bool = True) -> None:
    """Run all checks; each calls `make_device_connection()` for a link to a device that is not armed.

    Parameters
    ----------
    make_device_connection
        Returns an open link; the suite closes it.
    starts_in_boot
        True if each link leads to a device that has just started. A process or a board that continues between two
        links passes False, and checks that need a new device are omitted.
    """
    checks = [
        _identifies,
        _runs_through_the_states,
        _refuses_to_arm,
        _sets_all_or_nothing,
        _wants_to_be_verified_again,
        _stops_at_once,
        _ramps_down_when_the_host_falls_silent,
        _shows_on_its_pins_what_commands_say,
        _answers_what_it_does_not_know,
        _survives_noise,
        _executes_once,
        _check_time,
    ]
    for check in [_refuses_to_arm_unhomed, *checks] if starts_in_boot else checks:
        link = make_device_connection()
        try:
            check(Host(link))
        finally:
            link.close()


def _identifies(host: Host) -> None:
    about = host.read_dictionary()
    assert about.major == m.MAJOR
    assert 50 <= about.position_rate_default <= about.position_rate_maximum
    assert host.connection.state >= State.IDENTIFIED
    first_hash = host.hash
    host.read_dictionary()
    assert host.hash == first_hash


def _runs_through_the_states(host: Host) -> None:
    host.identify()
    ack = host.configure(**RUN_PARAMETERS)
    assert (ack.status, host.connection.state) == (Status.OK, State.CONFIGURED)
    ack = host.arm(_unused_session(), ack.crc)
    assert (ack.status, host.connection.state) == (Status.OK, State.ARMED)
    armed = host.next_state()
    assert (armed.state, armed.command_age, armed.current_commanded) == (State.ARMED, 0xFFFF, 0)
    indices = []
    for _ in range(20):
        host.command(0)
        indices.append(host.next_state().sample_index)
    assert indices == sorted(set(indices))
    assert host.states[-1].state == State.RUNNING
    assert host.disarm().status == Status.OK
    assert host.connection.state is State.CONFIGURED


def _refuses_to_arm_unhomed(host: Host) -> None:
    host.identify()
    host.expect_state(State.CONFIGURED)
    assert host.arm(1, 0).status == Status.BAD_STATE
    unhomed = {name: value for name, value in RUN_PARAMETERS.items() if name != "reference_count"}
    ack = host.configure(**unhomed)
    assert host.arm(1, ack.crc).status == Status.NOT_HOMED


def _refuses_to_arm(host: Host) -> None:
    host.identify()
    crc = host.configure(**RUN_PARAMETERS).crc
    session = _unused_session()
    wrong_hash = host.ask(m.Arm(host.nonce(), host.hash ^ 1, crc), session)
    assert wrong_hash.status == Status.HASH_MISMATCH
    assert host.arm(session, crc ^ 1).status == Status.HASH_MISMATCH
    assert host.arm(session, crc).status == Status.OK
    assert host.disarm().status == Status.OK
    successor = Host(host.link, first_nonce=1_000)  # as from another process, without the session
    successor.identify()
    assert successor.arm(session, crc).status == Status.STALE_SESSION
    assert successor.connection.state is State.CONFIGURED
    unverified = successor.configure(**{**RUN_PARAMETERS, "verified": 0})
    assert successor.arm(session % 255 + 1, unverified.crc).status == Status.NOT_VERIFIED


def _sets_all_or_nothing(host: Host) -> None:
    host.identify()
    before_crc = host.configure(**RUN_PARAMETERS).crc
    before = host.parameters()
    assert block_crc(before) == before_crc
    for name, value in RUN_PARAMETERS.items():
        assert decode_block(before)[name] == value
    ramp = BY_NAME["ramp_us"].id
    out_of_range = (
        encode_block({"position_rate": 50}) + ramp.to_bytes(2, "little") + (10_001).to_bytes(4, "little")
    )
    ack = host.set_block(out_of_range)
    assert (ack.status, ack.detail) == (Status.OUT_OF_RANGE, ramp)
    assert host.set_block((999).to_bytes(2, "little") + bytes(4)).status == Status.UNKNOWN_PARAMETER
    ack = host.configure(window_minimum=10, window_maximum=-10)
    assert (ack.status, ack.detail) == (Status.INCONSISTENT, BY_NAME["window_maximum"].id)
    assert host.set_block(b"\x01").status == Status.BAD_LENGTH
    assert host.parameters() == before


def _wants_to_be_verified_again(host: Host) -> None:
    host.identify()
    host.configure(**RUN_PARAMETERS)
    ack = host.configure(ramp_us=5_000)
    assert decode_block(host.parameters())["verified"] == 0
    assert host.arm(_unused_session(), ack.crc).status == Status.NOT_VERIFIED


def _stops_at_once(host: Host) -> None:
    host.begin(_unused_session())
    _drive(host)
    host.command(mode=m.Mode.STOP)
    states = [host.next_state() for _ in range(5)]
    assert {state.current_commanded for state in states} <= {0, PROBE_CURRENT}, "no ramp"
    assert (states[-1].current_commanded, states[-1].state) == (0, State.RUNNING)
    host.disarm()


def _ramps_down_when_the_host_falls_silent(host: Host) -> None:
    """The current is zero within lifetime + 10 ms and never rises; the fault is latched until cleared explicitly."""
    host.begin(_unused_session())
    _drive(host, lifetime_us=10_000)
    seen = [host.states[-1]]
    while seen[-1].state != State.FAULT:
        seen.append(host.next_state())
    currents = [state.current_commanded for state in seen]
    assert currents == sorted(currents, reverse=True)
    assert seen[-1].current_commanded == 0
    assert seen[-1].fault == Fault.LINK_LOST
    # A process that was stalled in real time shows neither its ramp nor when it would have begun.
    if all(after.sample_index - before.sample_index == 1 for before, after in itertools.pairwise(seen)):
        assert any(state.limits & LimitFlag.RAMPING for state in seen)
        passed_us = ((seen[-1].device_time - seen[0].device_time) & 0xFFFFFFFF) / UNITS_PER_US
        period_us = passed_us / (seen[-1].sample_index - seen[0].sample_index)
        assert (seen[-1].command_age - 1) * period_us <= 10_000 + 10_000
    assert host.disarm().status == Status.FAULT_LATCHED
    log = host.ask(m.GetFaultLog(host.nonce(), 0))
    assert log.fault == Fault.LINK_LOST
    assert log.total >= len(unpack_fault_entries(log.data)) > 0
    assert host.disarm(clear_fault=True).status == Status.OK
    assert host.connection.state is State.CONFIGURED


def _shows_on_its_pins_what_commands_say(host: Host) -> None:
    """The sync pins change with the command's current, and reset when the command's lifetime ends."""
    host.begin(_unused_session())
    trial, inside, both = int(m.Sync.TRIAL), int(m.Sync.INSIDE), int(m.Sync.TRIAL | m.Sync.INSIDE)
    _expect_pins(host, trial, Input.SYNC_TRIAL)
    _expect_pins(host, both, Input.SYNC_TRIAL | Input.SYNC_INSIDE)
    _expect_pins(host, 0xFF & ~trial, Input.SYNC_INSIDE)
    _expect_pins(host, 0xFF, 0, m.Mode.STOP)
    _expect_pins(host, trial, Input.SYNC_TRIAL)
    _expect_pins(host, 0xFF, 0, m.Mode.SUPERVISE)  # no law runs here
    _expect_pins(host, inside, Input.SYNC_INSIDE)
    while host.states[-1].state == State.RUNNING and not host.states[-1].limits & LimitFlag.RAMPING:
        assert host.states[-1].inputs & Input.SYNC_INSIDE
        host.next_state()
    assert not host.next_state().inputs & Input.SYNC_INSIDE
    host.disarm(clear_fault=True)


def _expect_pins(host: Host, flags: int, wanted: int, mode: int = m.Mode.CURRENT) -> None:
    """Send commands until the pins are as wanted; begin a new session if a delay exceeded the command's lifetime."""
    for _ in range(40):
        host.command(0, mode=mode, flags=flags)
        state = host.next_state()
        if state.inputs & (Input.SYNC_TRIAL | Input.SYNC_INSIDE) == wanted:
            return
        if state.fault == Fault.LINK_LOST:
            host.disarm(clear_fault=True)
            host.begin(_unused_session())
    raise AssertionError(f"the sync outputs never showed {wanted}")


def _answers_what_it_does_not_know(host: Host) -> None:
    host.identify()
    unknown = pack(m.Identify(77, 0))
    host.link.write(encode_frame(bytes([m.MAJOR, 0x3E]) + unknown[2:]))
    ack = host.answer(77)
    assert (ack.request, ack.status) == (0x3E, Status.UNSUPPORTED)
    foreign = pack(m.Identify(78, 0))
    host.link.write(encode_frame(bytes([m.MAJOR + 1]) + foreign[1:]))
    assert host.answer(78).dictionary_hash == host.hash  # IDENTIFY is answered to every major
    foreign = pack(m.GetTime(79, 0))
    host.link.write(encode_frame(bytes([m.MAJOR + 1]) + foreign[1:]))
    for _ in range(5):
        assert all(getattr(event.message, "nonce", 0) != 79 for event in host.events(0.01))


def _survives_noise(host: Host) -> None:
    noise = random.Random(1)
    for _ in range(20):
        host.link.write(noise.randbytes(200))
    host.link.write(b"\0")  # ends a frame that the noise may have begun
    host.identify()
    damaged = bytearray(host.sent)
    damaged[len(damaged) // 2] ^= 0x10
    host.link.write(bytes(damaged) + b"\0")
    host.identify()


def _executes_once(host: Host) -> None:
    """When the reply to ARM was lost, the repeated ARM gets the same reply and begins no second session."""
    host.identify()
    crc = host.configure(**RUN_PARAMETERS).crc
    first = host.arm(_unused_session(), crc)
    frame = host.sent
    assert decode_frame(frame[:-1])[1] == first.request
    host.link.write(frame)
    assert host.answer(first.nonce) == first
    assert host.disarm().status == Status.OK


def _check_time(host: Host) -> None:
    host.identify()
    earlier = 0
    for host_sent in (0, 1, 2**64 - 1):
        stamps = host.ask(m.GetTime(host.nonce(), host_sent))
        assert stamps.host_sent == host_sent
        assert earlier <= stamps.device_received <= stamps.device_sent
        earlier = stamps.device_sent


def _drive(host: Host, lifetime_us: int = 20_000) -> None:
    """Send commands until the newest STATE reports the current."""
    for _ in range(10):
        host.command(PROBE_CURRENT, lifetime_us=lifetime_us)
        if host.next_state().current_commanded == PROBE_CURRENT:
            return
    raise AssertionError("the commanded current never came into force")


_sessions = itertools.count(time.time_ns())


def _unused_session() -> int:
    """Return a session number that this process has not used last."""
    return 1 + next(_sessions) % 255
