"""The bridge in virtual time: its commands to a drive, and zero torque after every kind of end."""

import re

import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import OUT_OF_TIME, Fault, Input
from rig.core.errors import DeviceRefusedError
from rig.devices.framed import FramedDevice
from rig.extras.drives import library, odrive
from rig.extras.drives.faults import TEXTS, DriveFault
from rig.extras.drives.library import BRIDGE
from sim_backend.drives.can_simple import Error
from sim_backend.drives.moteus_registers import WHOLE
from tests.conformance.bridged import (
    CURRENT,
    KINDS,
    UNIT_TWICE_NS,
    Bridged,
    Strike,
    Way,
    armed,
    bridged_rig,
    push,
    push_until_fault,
)
from tests.conformance.device import check_device
from tests.conformance.faults import FarEnd, check_faults
from tests.conformance.host import RUN_PARAMETERS, Host
from tests.conformance.tiers import first_by_default

WATCHDOG_S = 0.005  # five periods: the drive's own
LIFETIME_S, RAMP_S = 0.020, 0.010  # of a command; in which the effort falls behind it
SLACK_S = 0.003
RUN_TICKS = 8
TORQUE_PER_QUANTUM = 1e-3 * 0.1 / 2.0  # N·m at the drive: 1 mA, 0.1 N·m/A, geared 1:2
each_drive = pytest.mark.parametrize("kind", KINDS)
PERIOD_NS = 1_000_000


@each_drive
def test_a_bridge_is_a_device_like_any_other(kind: str) -> None:
    check_device(lambda: Bridged(kind=kind))


@each_drive
@pytest.mark.parametrize("sign", [1, -1])
def test_a_command_turns_the_drive_as_the_rig_says(kind: str, sign: int) -> None:
    """Where counts fall while the position rises, the drive is turned the other way."""
    world, host = armed(Bridged(bridged_rig(sign=sign), kind=kind), encoder_sign=sign)
    push(host, 20)
    assert world.mode == world.far.on
    assert world.torque == pytest.approx(sign * CURRENT * TORQUE_PER_QUANTUM, rel=1e-6)
    state = host.next_state()
    assert state.current_commanded == CURRENT
    assert state.current_measured == pytest.approx(CURRENT, abs=20)  # behind a lag of 1 ms
    assert sign * state.count > 0
    truth = world.drive.motor.count
    # Behind the drive's own filter of 400 Hz.
    assert state.count == pytest.approx(truth, abs=0.01 * abs(truth) + 3)


def test_a_can_socket_in_place_of_an_adapter() -> None:
    world, host = armed(Bridged(socket=True))
    push(host, 20)
    assert world.torque == pytest.approx(CURRENT * TORQUE_PER_QUANTUM, rel=1e-6)
    assert world.bridge.facts.lost == 0
    bus_off = (0x20000000 | 0x40).to_bytes(4, "little") + bytes(12)  # CAN_ERR_FLAG, CAN_ERR_BUSOFF
    world._to_drive(world.bridge.receive_bus(bus_off, world._now))
    assert host.next_state().fault == DriveFault.BUS_LOST
    world.run(0.004)
    assert world.torque == 0.0


@each_drive
def test_a_command_acts_at_the_next_tick_and_its_sample_comes_with_it(kind: str) -> None:
    """One tick from a sample to its torque: host and bus use parts of the same period."""
    world, host = armed(Bridged(kind=kind))
    host.next_state()
    host.command(CURRENT)
    sent_ns = world.clock.now_ns()
    while world.torque == 0.0:
        world.step(sent_ns + 5_000_000)
    assert world.clock.now_ns() - sent_ns <= PERIOD_NS


@each_drive
def test_a_sample_has_the_torque_that_its_current_gives(kind: str) -> None:
    """At 200 Hz each change has settled: a moteus is read in its frame, an ODrive sends half a message later."""
    slowly = {odrive.ENCODER_MS: "5", odrive.TORQUES_MS: "5", odrive.WATCHDOG_S: "0.025"}
    _, host = armed(Bridged(kind=kind, settings=slowly if kind == "odrive" else {}), position_rate=200)
    for number in range(12):
        state = host.next_state()
        assert not state.fault
        assert state.current_measured == pytest.approx(state.current_commanded, abs=0.15 * CURRENT)
        host.command(CURRENT * (number // 2 % 2))


@each_drive
def test_a_drive_at_rest_is_only_asked(kind: str) -> None:
    world = Bridged(kind=kind)
    world.run(0.05)
    assert world.mode == world.far.rest
    assert world.bridge.facts.lost == 0
    assert world.bridge.facts.replies > 40


@each_drive
def test_arming_waits_until_the_drive_is_prepared_and_gives_no_torque_meanwhile(kind: str) -> None:
    world = Bridged(kind=kind)
    device = FramedDevice(world)
    device.configure(RUN_PARAMETERS)
    assert world.mode == world.far.rest
    device.arm()
    assert world.mode == world.far.on
    assert world.torque == 0.0
    device.disarm()
    world.run(0.01)
    assert world.mode == world.far.rest


def test_arming_right_after_disarming_waits_until_the_drive_is_on_again() -> None:
    """The last reply of the drive at arming is older than its stop."""
    world, host = armed()
    push(host, 5)
    assert host.disarm().status == 0
    ack = host.configure(**RUN_PARAMETERS)
    assert host.arm(2, ack.crc).status == 0
    push(host, 20)
    assert world.bridge.fault == 0
    assert world.torque > 0.0


@each_drive
def test_a_drive_that_is_not_armed_is_switched_off_again(kind: str) -> None:
    world = Bridged(kind=kind)
    host = Host(world)
    host.identify()
    ack = host.configure(**RUN_PARAMETERS)
    host.send(m.Arm(host.nonce(), host.hash, ack.crc), 1)
    world.run(0.1)
    assert world.mode == world.far.on
    world.run(1.5)
    assert world.mode == world.far.rest


# ---------------------------------------------------------------------- every way ends in zero torque


class Behind(FarEnd):
    rate, current, most = 1_000, CURRENT, float(CURRENT)
    grain, late = 1e-3, 2

    def __init__(self, kind: str) -> None:
        self.world = Bridged(kind=kind)
        super().__init__(self.world)

    def effort(self) -> float:
        return self.world.torque / TORQUE_PER_QUANTUM

    def enabled(self) -> bool:
        return self.world.mode == self.world.far.on


@each_drive
def test_a_fault_of_the_host_is_zero_torque_in_time_latched_and_reported(kind: str) -> None:
    check_faults(lambda: Behind(kind))


@each_drive
def test_a_bridge_that_is_killed_leaves_it_to_the_watchdog_of_the_drive(kind: str) -> None:
    world, host = armed(Bridged(kind=kind))
    push(host, 10)
    assert world.torque != 0.0
    world.alive = False
    world.run(WATCHDOG_S + SLACK_S)
    assert world.mode == world.far.expired
    assert world.torque == 0.0
    assert abs(world.far.measured) < 1e-3  # N·m; behind a lag of 1 ms


@each_drive
def test_a_bridge_that_ends_switches_the_drive_off(kind: str) -> None:
    world, host = armed(Bridged(kind=kind))
    push(host, 10)
    world._to_drive(world.bridge.stop())
    world.alive = False
    world.run(0.001)
    assert world.mode == world.far.rest


@each_drive
def test_an_adapter_that_is_pulled_out(kind: str) -> None:
    world, host = armed(Bridged(kind=kind))
    push(host, 10)
    world.bridge.lose_bus(world._now)
    world.strike("to drive", drop)
    state = host.next_state()
    assert (state.state, state.fault) == (State.FAULT, DriveFault.BUS_LOST)
    world.run(WATCHDOG_S + SLACK_S)
    assert world.torque == 0.0


def drop(line: bytes) -> bytes:
    return b""


def garble(line: bytes) -> bytes:
    place = len(line) // 2
    return line[:place] + bytes((line[place] ^ 1,)) + line[place + 1 :]


ENDINGS: dict[str, tuple[Way, Strike, int]] = {
    "a lost question": ("to drive", drop, 1),
    "lost questions": ("to drive", drop, 4),
    "a lost answer": ("from drive", drop, 1),
    "lost answers": ("from drive", drop, 8),
    "a garbled question": ("to drive", garble, 1),
    "a garbled answer": ("from drive", garble, 1),
    "a line that stays dead": ("from drive", drop, 10_000),
}


@pytest.mark.parametrize(
    ("kind", "ending"),
    first_by_default(
        [
            *(("moteus", ending) for ending in ENDINGS),
            # a CAN controller passes on no garbled frame
            *(("odrive", ending) for ending, (_, strike, _) in ENDINGS.items() if strike is drop),
        ],
        9,
    ),
)
def test_a_fault_at_any_line_of_a_run(kind: str, ending: str) -> None:
    """Every loss leads to zero torque in time; losses are counted, and no old count is reported as new."""
    way, strike, length = ENDINGS[ending]
    of_the_run = RUN_TICKS * (1 if way == "to drive" else 2)  # the adapter sends OK, too
    for first in range(0, of_the_run, 1 if strike is drop and length == 1 else 5):
        world, host = armed(Bridged(kind=kind))
        world.strike(way, strike, length, after=first)
        indices = []
        for _ in range(RUN_TICKS):
            state = host.next_state()
            indices.append(state.sample_index)
            if state.fault:
                break
            host.command(CURRENT)
        assert indices == sorted(set(indices))
        if state.fault:
            watched = {DriveFault.DRIVE_LEFT} if kind == "odrive" and way == "to drive" else set()
            assert state.fault in {DriveFault.DRIVE_SILENT, *watched}
            world.run(WATCHDOG_S + SLACK_S)
        else:
            world.run(LIFETIME_S + RAMP_S + SLACK_S)
        assert world.torque == 0.0
        facts = world.bridge.facts
        assert facts.lost >= (1 if way == "from drive" and strike is drop and length > 1 else 0)


HAPPENINGS: dict[str, tuple[str, float, int]] = {
    "moteus: over voltage": ("fault", 34, DriveFault.OVER_VOLTAGE),
    "moteus: too hot": ("temperature", 90.0, DriveFault.TEMPERATURE),
    "moteus: under voltage": ("voltage", 3.0, DriveFault.UNDER_VOLTAGE),
    "moteus: its watchdog": ("expire", 0.0, DriveFault.DRIVE_LEFT),
    "moteus: a power cut": ("reboot", 0.0, DriveFault.DRIVE_LEFT),
    "moteus: stopped by another host": ("mode", 0, DriveFault.DRIVE_LEFT),
    "moteus: held by another host": ("mode", 12, DriveFault.DRIVE_LEFT),
    "moteus: a second master": ("master", 0.1, DriveFault.OTHER_MASTER),
    "odrive: over voltage": ("voltage", 60.0, DriveFault.OVER_VOLTAGE),
    "odrive: too hot": ("temperature", 120.0, DriveFault.TEMPERATURE),
    "odrive: under voltage": ("voltage", 3.0, DriveFault.UNDER_VOLTAGE),
    "odrive: its driver": ("fault", Error.DRV_FAULT, DriveFault.DRIVER),
    "odrive: another error": ("fault", 0x2, DriveFault.DRIVE_INTERNAL),
    "odrive: its watchdog": ("expire", 0.0, DriveFault.DRIVE_LEFT),
    "odrive: a power cut": ("reboot", 0.0, DriveFault.DRIVE_LEFT),
    "odrive: stopped by another host": ("estop", 0.0, DriveFault.DRIVE_LEFT),
    "odrive: held through its USB port": ("mode", 3, DriveFault.DRIVE_LEFT),
    "odrive: off the bus": ("bus-off", 0.0, DriveFault.DRIVE_SILENT),
    "odrive: a second master": ("master", 0.1, DriveFault.OTHER_MASTER),
}


@pytest.mark.parametrize("what", HAPPENINGS)
def test_a_drive_that_stops_by_itself_or_for_another_host(what: str) -> None:
    name, value, fault = HAPPENINGS[what]
    world, host = armed(Bridged(kind=what.partition(":")[0]))
    push(host, 10)
    world.happen(name, value)
    # An ODrive's heartbeat reports it.
    state = push_until_fault(host, 5 if world.far.name == "moteus" else 15)
    assert state.fault == fault
    world.run(WATCHDOG_S + SLACK_S)
    assert world.drive.motor.torque == pytest.approx(0.0, abs=1e-3)
    text = FramedDevice(world).dictionary.explain_fault(fault).text
    assert text == world.far.texts[DriveFault(fault)][0]


def test_the_silence_of_a_drive_is_known_as_want_of_time() -> None:
    assert DriveFault.DRIVE_SILENT.name in OUT_OF_TIME


@each_drive
def test_a_drive_that_fell_silent_is_homed_again(kind: str) -> None:
    """A drive without power loses its count of turns."""
    world = Bridged(kind=kind)
    device = FramedDevice(world)
    device.configure(RUN_PARAMETERS)
    world.strike("from drive", drop, 2 * 30)
    world.run(0.05)
    with pytest.raises(DeviceRefusedError, match="has lost counts"):
        device.configure(RUN_PARAMETERS)


@each_drive
def test_a_drive_that_hiccups_before_it_is_armed_is_only_counted(kind: str) -> None:
    world = Bridged(kind=kind)
    device = FramedDevice(world)
    device.configure(RUN_PARAMETERS)
    world.run(0.02)
    world.strike("from drive", drop, 2 * 5)
    world.run(0.05)
    assert world.bridge.facts.lost in (4, 5)  # an ODrive's heartbeats are lines, too
    device.arm()


@each_drive
@pytest.mark.parametrize("turns", [-1, 1])
def test_a_position_that_jumps_by_turns_is_no_motion(kind: str, turns: int) -> None:
    """A restarted drive measures its angle within a turn, but not which turn."""
    world, host = armed(Bridged(kind=kind))
    push(host, 5)
    world.happen("slip", turns * 4 * 4096)
    state = push_until_fault(host, 5, 0)
    assert state.fault in {Fault.ENCODER, Fault.OVER_SPEED}
    world.run(0.004)
    assert (world.torque, world.mode) == (0.0, world.far.rest)


@each_drive
def test_a_fault_while_the_drive_is_prepared_has_the_text_of_the_drive(kind: str) -> None:
    world = Bridged(kind=kind)
    device = FramedDevice(world)
    device.configure(RUN_PARAMETERS)
    world.happen("voltage", 3.0)
    with pytest.raises(DeviceRefusedError, match=r"(?i)under.voltage"):
        device.arm()
    assert world.torque == 0.0


@each_drive
def test_a_sample_that_was_lost_is_missing_in_the_index_however_soon_the_next_one_comes(kind: str) -> None:
    world, host = armed(Bridged(kind=kind, travel_ns=400_000))
    push(host, 5)
    before = host.next_state().sample_index
    world.strike("from drive", drop, 2)
    world.travel_ns = 100_000
    state = host.next_state()
    assert (state.sample_index - before, state.missed_ticks) == (2, 1)


@each_drive
@pytest.mark.parametrize("awaits", first_by_default([False, True]))
def test_a_computer_that_stands_still_loses_samples_and_has_no_old_ones(kind: str, awaits: bool) -> None:
    """Pauses shorter than a command's lifetime are counted, longer ones end the run; index and clock agree."""
    faults = {}
    for stood_us in range(1_300, 7_000, 1_000):
        world, host = armed(Bridged(kind=kind))
        push(host, 5)
        before = host.next_state()
        host.command(CURRENT)
        world.run(0.9e-3 if awaits else 0.3e-3)  # a question is on its way, or answered
        world.sleep(1e-6 * stood_us)
        state = host.next_state()
        lost = state.sample_index - before.sample_index - 1
        apart_ns = (state.device_time - before.device_time) * UNIT_TWICE_NS // 2 - (lost + 1) * PERIOD_NS
        assert abs(apart_ns) < PERIOD_NS
        assert state.missed_ticks == lost
        assert abs(stood_us * 1000 - lost * PERIOD_NS) < 2 * PERIOD_NS  # parts of a period at both ends
        faults[lost] = state.fault
        world.run(WATCHDOG_S + SLACK_S + LIFETIME_S + RAMP_S)
        assert world.torque == 0.0
    assert {2, 3, 4, 5} <= set(faults)
    for lost, fault in faults.items():  # the drive's watchdog has five periods
        assert fault in ((0,) if lost < 4 else (Fault.TICK_OVERRUN, DriveFault.DRIVE_LEFT))


def test_replies_that_are_late_are_not_taken_for_the_ones_that_are_awaited() -> None:
    world, host = armed(Bridged(travel_ns=300_000))
    push(host, 5)
    world.travel_ns = 700_000  # there and back in more than a period
    push_until_fault(host, 4)
    world.run(0.01)
    assert world.bridge.facts.late > 0
    assert world.bridge.fault == DriveFault.DRIVE_SILENT
    assert world.torque == 0.0


def test_an_answer_of_before_is_not_taken_for_a_new_one() -> None:
    """Each request has another sender id, which the reply repeats."""
    world, host = armed()
    push(host, 5)
    lines: list[bytes] = []

    def keep(line: bytes) -> bytes:
        lines.append(line)
        return line

    def stale(line: bytes) -> bytes:
        return lines[0] if line.startswith(b"rcv") else line

    world.strike("from drive", keep, 2)
    before = host.next_state().sample_index
    host.command(CURRENT)
    lines[:] = [line for line in lines if line.startswith(b"rcv")]
    world.strike("from drive", stale, 2)
    state = host.next_state()
    facts = world.bridge.facts
    assert (facts.late, facts.lost) == (1, 1)
    assert state.sample_index == before + 2
    assert state.missed_ticks == 1


# ---------------------------------------------------------------------- the C code and its mirror


def test_codes_are_those_of_the_header() -> None:
    header = (BRIDGE.root / "bridge" / "drive.h").read_text()
    codes = {
        name: int(code) for name, code in re.findall(r"^    BRIDGE_(\w+) = (\d+),", header, re.MULTILINE)
    }
    assert codes == {fault.name: int(fault) for fault in DriveFault}
    assert all(set(texts) == set(DriveFault) for texts in TEXTS.values())


def test_structures_are_those_of_the_header() -> None:
    made = library.library()
    assert made.bridge_facts_bytes() == library.ctypes.sizeof(library.BridgeFacts)
    header = (BRIDGE.root / "bridge" / "bridge.h").read_text()
    facts = header[header.index("struct bridge_facts {") :]
    names = re.findall(r"\b(\w+)(?:\[\w+\])?[;,]", re.sub(r"/\*.*?\*/", "", facts[: facts.index("};")]))
    assert names == [name for name, *_ in library.BridgeFacts._fields_]
    setup = header[header.index("struct bridge_setup {") :]
    names = re.findall(r"(\w+);", re.sub(r"/\*.*?\*/", "", setup[: setup.index("};")]))
    assert names == [name for name, *_ in library.Setup._fields_]


def set_pins(world: Bridged, pins: int) -> None:
    world.drive._computed_registers[0x05E] = (lambda words: pins, WHOLE)


def test_a_hold_to_run_switch_on_a_pin_of_the_drive() -> None:
    world, host = armed(Bridged(switches={"hold": "aux1.2"}), hold_to_run=1)
    push(host, 5)
    assert world.torque == 0.0
    set_pins(world, 1 << 2)
    push(host, 5)
    assert world.torque > 0.0
    assert host.next_state().inputs & Input.HOLD_TO_RUN
    set_pins(world, 0)
    push(host, 2)
    assert world.torque == 0.0


def test_an_emergency_stop_on_a_pin_of_the_drive_and_its_broken_wire() -> None:
    world = Bridged(switches={"stop": "aux1.3"})
    set_pins(world, 1 << 3)
    world.run(0.01)  # before it has replied, it counts as pressed
    world, host = armed(world)
    push(host, 5)
    set_pins(world, 0)
    push(host, 3)
    assert host.next_state().fault == Fault.EMERGENCY_STOP
    world.run(0.01)
    assert (world.torque, world.mode) == (0.0, world.far.rest)
