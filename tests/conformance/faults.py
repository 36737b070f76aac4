"""The fault suite of a device: each fault once, for every kind of device that can have it.

`check_faults` injects a fault into a device that gives effort and checks the reaction and its time limit: the effort
becomes and stays zero, the fault is latched and reported, and the next session needs the specified steps.
Limits are in ticks of the device on the clock of its link; no wall clock is read.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input, LimitFlag, Status
from firmware_protocol.framing import encode_frame
from firmware_protocol.messages import Mode
from firmware_protocol.packing import pack, unpack_fault_entries
from firmware_protocol.parameter import Value
from rig.devices.device import Link
from tests.conformance.host import RUN_PARAMETERS, Host

LONG_AGO = 1_000  # STATEs: at every rate here more than the life of a command
_U16 = 0xFFFF


class FarEnd(ABC):
    """A device with effort, the host at its link, and the faults that a test can cause."""

    rate = 2_000  # ticks a second
    # What the host commands, for how long a command lives, and in which time the effort falls behind it.
    mode, current, lifetime_us, ramp_us = Mode.CURRENT, 200, 20_000, 10_000
    most = 200.0  # the largest effort that the device may give (quanta)
    grain = 0.0  # how well `effort` is known (quanta)
    send_every = 1  # ticks between two commands
    rest_ticks = 100  # in which a host that ignores a fault must move nothing
    late = 0  # ticks by which this far end may show an effect later: an emulator runs in slices

    def __init__(self, link: Link) -> None:
        self.host = Host(link)
        self.strikes: dict[str, Callable[[], object]] = {}  # fault of `FOUND` → what causes it here
        # Fault → what ends its cause, if that does not end by itself.
        self.repairs: dict[str, Callable[[], object]] = {}
        self.received: list[m.Message] = []  # while time passed
        self.session = 0
        self._sent = 0

    @abstractmethod
    def effort(self) -> float:
        """Return the motor's present effort (quanta), exactly 0 without any."""

    def enabled(self) -> bool:
        """Return True if the amplifier is on; False also where this cannot be observed."""
        return False

    def hold(self, held: bool) -> None:
        raise NotImplementedError

    def parameters(self) -> dict[str, Value]:
        times = {"command_lifetime_us": self.lifetime_us, "ramp_us": self.ramp_us}
        return {**RUN_PARAMETERS, "position_rate": self.rate, **times}

    def arm(self, **changes: Value) -> m.Ack:
        if self.host.connection.state > State.CONFIGURED:
            self.host.disarm(clear_fault=True)
        self.host.identify()
        ack = self.host.configure(**{**self.parameters(), **changes})
        assert ack.status == Status.OK, ack
        return self.host.arm(self.next_session(), ack.crc)

    def next_session(self) -> int:
        self.session = self.session % 255 + 1
        return self.session

    def begin(self, **changes: Value) -> FarEnd:
        """Arm the device and command it until it gives effort."""
        ack = self.arm(**changes)
        assert ack.status == Status.OK, ack
        self.host.next_state()
        self.push()
        return self

    def push(self) -> None:
        self.watch(3 * self.send_every + self.late, self.command)
        assert self.effort() != 0.0

    def command(self, mode: int | None = None) -> None:
        mode = self.mode if mode is None else mode
        self.host.command(self.current, lifetime_us=self.lifetime_us, mode=mode)

    def watch(self, ticks: int, send: Callable[[], object] | None = None) -> list[float]:
        """Return the effort after each of `ticks` ticks; call `send`, if given, in every `send_every`-th."""
        begin_ns, efforts = self.host.link.clock.now_ns(), []
        for tick in range(ticks):
            if send is not None and tick % self.send_every == 0:
                send()
            self._wait_until(begin_ns + round((tick + 1) * 1e9 / self.rate))
            efforts.append(self.effort())
        return efforts

    def _wait_until(self, end_ns: int) -> None:
        while (left_ns := end_ns - self.host.link.clock.now_ns()) > 0:
            for event in self.host.events(left_ns * 1e-9):
                self.received.append(event.message)

    def frame(self, *, session: int | None = None, behind: int | None = None, **changes: int) -> bytes:
        """Return the next command with some changes, or with a sequence `behind` the newest one."""
        connection = self.host.connection
        self._sent += 1
        sequence = connection.sequence_to_send(m.Command) + (self._sent if behind is None else -1 - behind)
        command = m.Command(self.host.sequences[-1], self.lifetime_us, int(self.mode), 0, self.current)
        of = connection.session if session is None else session
        return encode_frame(pack(replace(command, **changes), session=of, sequence=sequence & _U16))

    def ticks_of(self, us: int) -> int:
        return round(us * 1e-6 * self.rate)

    @property
    def state(self) -> m.State:
        return self.host.states[-1]


MakeFarEnd = Callable[[], FarEnd]

# ---------------------------------------------------------------------- what feeds no watchdog


def _damaged(far: FarEnd) -> bytes:
    frame = bytearray(far.frame())
    frame[len(frame) // 2] ^= 0x10
    return bytes(frame)


_noise = random.Random(3)
NO_NEWS = ("framing_errors", "stale_session", "duplicated")
BROKEN = ("framing_errors", "crc_errors", "malformed")
# What arrives in place of a command → its bytes, and which counters of the device show it.
INEFFECTIVE: dict[str, tuple[Callable[[FarEnd], bytes], tuple[str, ...]]] = {
    "silence": (lambda far: b"", ()),
    "requests": (lambda far: far.host.connection.send(m.GetTime(far.host.nonce(), 0)), ()),
    "noise": (lambda far: _noise.randbytes(_noise.randrange(1, 30)) + b"\0", BROKEN),
    "damaged commands": (_damaged, BROKEN),
    "commands of another session": (lambda far: far.frame(session=far.session % 255 + 1), ("stale_session",)),
    "the same command again": (lambda far: far.frame(behind=0), ("duplicated",)),
    "commands with an older sequence number": (lambda far: far.frame(behind=1), ("reordered",)),
    "commands that were under way for longer than they live": (
        lambda far: far.frame(state_sequence=(far.host.sequences[-1] - LONG_AGO) & _U16),
        ("reordered",),
    ),
    "commands of an unknown mode": (lambda far: far.frame(mode=9), ("malformed",)),
}


def check_ineffective(make_far_end: MakeFarEnd, name: str) -> None:
    """A frame that is no valid command must not extend the last one: its effort ramps down, then LINK_LOST."""
    make, counters = INEFFECTIVE[name]
    far = make_far_end().begin()
    before = far.host.ask(m.GetStatistics(far.host.nonce()))
    far.host.states.clear()
    far.command()
    lifetime, ramp = far.ticks_of(far.lifetime_us), far.ticks_of(far.ramp_us)
    efforts = far.watch(lifetime + ramp + 1 + far.late, lambda: far.host.link.write(make(far)))
    assert efforts[: lifetime - 1] == _reference_effort(make_far_end, far, lifetime - 1), "the command lives"
    for tick, effort in enumerate(efforts[lifetime + far.late :]):
        assert abs(effort) <= far.most * max(0.0, 1.0 - tick / ramp) + 1.0 + far.grain, tick
    assert efforts[-1] == 0.0
    assert any(state.limits & LimitFlag.RAMPING for state in far.host.states)
    _check_latched(far, (Fault.LINK_LOST,))
    after = far.host.ask(m.GetStatistics(far.host.nonce()))
    assert not counters or any(getattr(after, one) > getattr(before, one) for one in counters)
    assert far.host.disarm(clear_fault=True).status == Status.OK
    assert far.arm().status == Status.OK


def check_ineffective_beside_commands(make_far_end: MakeFarEnd) -> None:
    """Noise, frames of another session and repeated frames change nothing between valid commands."""
    far = make_far_end().begin()
    beside = [make for make, counters in INEFFECTIVE.values() if counters and counters[0] in NO_NEWS]

    def disturb() -> None:
        far.command()
        beside.append(beside.pop(0))
        far.host.link.write(beside[-1](far))

    ticks = 3 * len(beside) * far.send_every
    expected = _reference_effort(make_far_end, far, ticks)
    assert far.watch(ticks, disturb) == expected
    assert far.state.fault == Fault.NONE


def _reference_effort(make_far_end: MakeFarEnd, far: FarEnd, ticks: int) -> Any:
    """Return the effort of a device that receives every command; with a law on the device, of a twin."""
    if far.mode is Mode.CURRENT:
        return pytest.approx([far.current] * ticks, abs=far.grain)
    twin = make_far_end().begin()
    return twin.watch(ticks, twin.command)


# ---------------------------------------------------------------------- what the device finds


@dataclass(frozen=True, slots=True)
class Found:
    """The required reaction to a fault."""

    faults: tuple[Fault, ...]  # one of these is latched
    ticks: int = 1  # until the effort is zero
    remains: bool = False  # True: the device refuses to clear it, and to arm, until its cause has ended
    arms: Status | None = None  # reply to ARM after the clear; None where that depends on the motion since


FOUND: dict[str, Found] = {
    "the emergency stop is pressed": Found((Fault.EMERGENCY_STOP,), remains=True, arms=Status.OK),
    "an illegal transition of the encoder": Found((Fault.ENCODER,), arms=Status.NOT_HOMED),
    "the count jumps": Found((Fault.OVER_SPEED, Fault.BATCH_OVERFLOW, Fault.POSITION_WINDOW)),
    "a short circuit": Found((Fault.OVER_CURRENT,), 2),  # one sample alone is a spike of the converter
    "a blow": Found((Fault.OVER_SPEED, Fault.POSITION_WINDOW), 2_000),
    **{
        f"the port finds {fault.name}": Found(
            (fault,), arms=Status.NOT_HOMED if fault is Fault.ENCODER else None
        )
        for fault in Fault
        if fault not in (Fault.NONE, Fault.EMERGENCY_STOP)
    },
}


def check_found(make_far_end: MakeFarEnd, name: str) -> None:
    """The effort is zero in time and stays zero; the fault is reported, logged and cleared only explicitly."""
    found = FOUND[name]
    far = make_far_end().begin()
    far.strikes[name]()
    for _ in range(found.ticks + far.late):
        far.watch(1, far.command)
        if far.state.fault:
            break
    assert far.effort() == 0.0
    _check_latched(far, found.faults)
    if found.remains:
        assert far.state.inputs & Input.EMERGENCY_STOP
        refused = far.host.disarm(clear_fault=True)
        assert (refused.status, refused.detail) == (Status.FAULT_PRESENT, found.faults[0])
    repair = far.repairs.get(name, lambda: None)
    repair()
    far.watch(1 + far.late)
    assert far.host.disarm(clear_fault=True).status == Status.OK
    if found.remains:
        far.strikes[name]()
        far.watch(1 + far.late)
        refused = far.arm()
        assert (refused.status, refused.detail) == (Status.FAULT_PRESENT, found.faults[0])
        repair()
        far.watch(1 + far.late)
    if found.arms is not None:
        crc = far.host.ask(m.GetParameters(far.host.nonce(), 0)).crc
        assert far.host.arm(far.next_session(), crc).status == found.arms


def _check_latched(far: FarEnd, faults: tuple[Fault, ...]) -> None:
    """The fault stays latched whatever the host commands; its log has the ticks before it."""
    fault = far.state.fault
    assert (far.state.state, fault in faults) == (State.FAULT, True), far.state
    assert not far.enabled()
    assert not any(far.watch(far.rest_ticks, far.command))
    assert (far.state.fault, far.enabled()) == (fault, False)
    far.host.identify()
    assert far.host.connection.state is State.FAULT
    assert far.host.disarm().status == Status.FAULT_LATCHED
    log = far.host.ask(m.GetFaultLog(far.host.nonce(), 0))
    assert log.fault == fault
    assert len(unpack_fault_entries(log.data)) > 0


# ---------------------------------------------------------------------- ends that are no faults


def check_stop(far: FarEnd) -> None:
    """STOP sets zero effort within the tick, without a ramp; a later command is obeyed."""
    far.begin()
    far.command(Mode.STOP)
    assert not any(far.watch(5 + far.late)[far.late :])
    assert (far.state.state, far.state.fault) == (State.RUNNING, Fault.NONE)
    far.command()
    assert any(far.watch(5 * far.send_every + far.late, far.command))


def check_disarm(far: FarEnd) -> None:
    far.begin()
    assert far.host.disarm().status == Status.OK
    assert not any(far.watch(5 + far.late)[far.late :])
    assert far.host.connection.state is State.CONFIGURED


def check_hold_to_run(far: FarEnd) -> None:
    """There is effort only while the switch is held; releasing it is not a fault."""
    far.hold(False)
    assert far.arm(hold_to_run=1).status == Status.OK
    far.host.next_state()
    assert not any(far.watch(5 * far.send_every, far.command))
    far.hold(True)
    far.push()
    far.hold(False)
    assert not any(far.watch(far.rest_ticks, far.command)[1 + far.late :])
    assert (far.state.state, far.state.fault) == (State.RUNNING, Fault.NONE), far.state
    assert far.state.limits & LimitFlag.HOLD_TO_RUN_RELEASED
    assert not far.state.inputs & Input.HOLD_TO_RUN
    far.hold(True)
    far.push()
    assert far.state.inputs & Input.HOLD_TO_RUN


def check_command_in_the_ramp(far: FarEnd) -> None:
    """A host that sends a command before the ramp has ended gets the effort back."""
    far.begin()
    far.command()
    far.watch(far.ticks_of(far.lifetime_us) + far.ticks_of(far.ramp_us) // 2)
    far.push()
    far.watch(2 * far.send_every, far.command)
    assert far.state.fault == Fault.NONE
    assert not far.state.limits & LimitFlag.RAMPING


ENDS: dict[str, Callable[[FarEnd], None]] = {
    "STOP": check_stop,
    "DISARM": check_disarm,
    "hold-to-run is released": check_hold_to_run,
    "a command in the ramp": check_command_in_the_ramp,
}
BESIDE = "invalid frames beside commands"


def faults_of(far_end: FarEnd) -> list[str]:
    held = type(far_end).hold is not FarEnd.hold
    ends = [name for name in ENDS if held or name != "hold-to-run is released"]
    return [*INEFFECTIVE, BESIDE, *ends, *far_end.strikes]


def check_fault(make_far_end: MakeFarEnd, name: str) -> None:
    if name in INEFFECTIVE:
        check_ineffective(make_far_end, name)
    elif name == BESIDE:
        check_ineffective_beside_commands(make_far_end)
    elif name in ENDS:
        ENDS[name](make_far_end())
    else:
        check_found(make_far_end, name)


def check_faults(make_far_end: MakeFarEnd) -> None:
    for name in faults_of(make_far_end()):
        check_fault(make_far_end, name)
