"""The simulated ODrive against the documentation that its modules cite. Time is virtual."""

import math
import struct

import pytest

from rig.core.errors import ConfigError
from sim_backend.drives.bus import Frame
from sim_backend.drives.can_simple import CanSimpleCommand, Error, Result
from sim_backend.drives.odrive import SimulatedOdrive
from tests.conformance.drives import INERTIA, KT, RATIO, Odrive, drive_rig
from tests.conformance.rigs import linear_rig

TURN = 2.0 * math.pi
SHAFT_INERTIA = INERTIA / RATIO**2
FREE = {  # nothing that alters a torque
    "axis0.controller.config.enable_torque_mode_vel_limit": "0",
    "axis0.controller.config.enable_overspeed_error": "0",
    "axis0.config.motor.current_soft_max": "50",
}
WATCHED = FREE | {"axis0.config.enable_watchdog": "1", "axis0.config.watchdog_timeout": "0.02"}


def test_drive_reports_its_version_and_state() -> None:
    drive = Odrive(firmware=(0, 6, 9))
    assert drive.ask(CanSimpleCommand.GET_VERSION, "8B")[4:7] == (0, 6, 9)
    assert drive.ask(CanSimpleCommand.HEARTBEAT, "IBBBx") == (0, 1, Result.SUCCESS, 1)
    assert drive.ask(CanSimpleCommand.GET_BUS_VOLTAGE_CURRENT, "ff") == (24.0, 0.0)
    assert drive.ask(CanSimpleCommand.GET_TEMPERATURE, "ff")[0] == 25.0
    node, serial, connection = drive.ask(CanSimpleCommand.ADDRESS, "B6sB")
    assert (node, int.from_bytes(serial, "little"), connection) == (0, 0x53494D554C41, 0)


def test_cyclic_messages_come_by_the_millisecond_and_only_those_that_have_a_rate() -> None:
    drive = Odrive(settings={"axis0.config.can.encoder_msg_rate_ms": "2"})
    seen = [frame.identifier for frame in drive.wait(0.2)]
    assert seen.count(CanSimpleCommand.GET_ENCODER_ESTIMATES) == 100
    assert seen.count(CanSimpleCommand.HEARTBEAT) == 2
    assert set(seen) == {CanSimpleCommand.GET_ENCODER_ESTIMATES, CanSimpleCommand.HEARTBEAT}
    rate = SimulatedOdrive.flat_endpoints()["endpoints"]["axis0.config.can.iq_msg_rate_ms"]["id"]
    drive.send(CanSimpleCommand.RX_SDO, "BHBI", 1, rate, 0, 5)
    seen = [frame.identifier for frame in drive.wait(0.1)]
    assert seen.count(CanSimpleCommand.GET_IQ) in {20, 21}  # from now on, and none for the time before


def test_torque_is_what_was_asked_through_the_ratio() -> None:
    drive = Odrive(settings=FREE)
    drive.start()
    drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.05)
    drive.wait(0.1)
    assert drive.ask(CanSimpleCommand.GET_TORQUES, "ff") == (pytest.approx(0.05), pytest.approx(0.05))
    assert drive.ask(CanSimpleCommand.GET_IQ, "ff")[1] == pytest.approx(0.05 / KT)
    position, velocity = drive.ask(CanSimpleCommand.GET_ENCODER_ESTIMATES, "ff")
    acceleration = 0.05 / SHAFT_INERTIA / TURN
    assert velocity == pytest.approx(acceleration * 0.1, rel=0.05)
    assert position == pytest.approx(acceleration * 0.1**2 / 2.0, rel=0.05)


def test_a_drive_that_is_wrong_about_its_motor_is_wrong_about_torque_and_right_about_current() -> None:
    drive = Odrive(settings=FREE | {"axis0.config.motor.torque_constant": str(2.0 * KT)})
    drive.start()
    drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.05)
    drive.wait(0.01)
    assert drive.ask(CanSimpleCommand.GET_TORQUES, "ff")[1] == pytest.approx(0.05)
    assert drive.drive.motor.torque == pytest.approx(0.025)
    assert drive.ask(CanSimpleCommand.GET_IQ, "ff")[1] == pytest.approx(0.025 / KT)


def test_torque_mode_is_reduced_near_the_velocity_limit_unless_disabled() -> None:
    def after(setting: str) -> float:
        drive = Odrive(settings=FREE | {"axis0.controller.config.enable_torque_mode_vel_limit": setting})
        drive.start()
        drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.02)
        drive.wait(0.5)
        return float(drive.ask(CanSimpleCommand.GET_TORQUES, "ff")[0])

    assert after("0") == pytest.approx(0.02)
    assert after("1") < 0.01  # (vel_limit − velocity)·vel_gain


def test_overspeed_lets_go_with_a_reason() -> None:
    drive = Odrive(settings=FREE | {"axis0.controller.config.enable_overspeed_error": "1"})
    drive.start()
    drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.05)
    drive.wait(0.5)
    assert (drive.state, drive.errors[1]) == (1, Error.VELOCITY_LIMIT_VIOLATION)
    assert drive.drive.motor.torque == 0.0


def test_the_watchdog_is_fed_by_inputs_and_not_by_questions() -> None:
    drive = Odrive(settings=WATCHED)
    drive.start()
    for _ in range(30):
        drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.01)
        drive.wait(0.002)
    assert drive.state == 8
    for _ in range(15):
        drive.ask(CanSimpleCommand.GET_ENCODER_ESTIMATES, "ff")
        drive.wait(0.002)
    assert (drive.state, drive.drive.motor.torque) == (1, 0.0)
    assert drive.errors == (Error.WATCHDOG_TIMER_EXPIRED, Error.WATCHDOG_TIMER_EXPIRED)


def test_with_an_error_it_is_not_armed_until_it_was_cleared() -> None:
    drive = Odrive(settings=FREE)
    drive.start()
    drive.send(CanSimpleCommand.ESTOP)
    drive.wait(0.001)
    assert (drive.state, drive.errors[1]) == (1, Error.ESTOP_REQUESTED)
    drive.start()
    assert drive.state == 1
    assert drive.ask(CanSimpleCommand.HEARTBEAT, "IBBBx")[2] == Result.DISARMED
    drive.send(CanSimpleCommand.CLEAR_ERRORS, "B", 0)
    drive.start()
    assert (drive.state, drive.errors) == (8, (0, 0))


@pytest.mark.parametrize(
    ("event", "value", "error"),
    [
        ("fault", 0x20, Error.DRV_FAULT),
        ("voltage", 5.0, Error.DC_BUS_UNDER_VOLTAGE),
        ("voltage", 60.0, Error.DC_BUS_OVER_VOLTAGE),
        ("temperature", 120.0, Error.INVERTER_OVER_TEMP),
        ("estop", 0.0, Error.ESTOP_REQUESTED),
    ],
)
def test_a_fault_ends_the_torque_with_its_bit(event: str, value: float, error: Error) -> None:
    drive = Odrive(settings=FREE)
    drive.start()
    drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.05)
    drive.wait(0.001)
    drive.drive.happen(event, value)
    drive.wait(0.001)
    assert (drive.state, drive.errors[1], drive.drive.motor.torque) == (1, error, 0.0)


def test_drive_off_the_bus_neither_receives_nor_sends_and_its_watchdog_acts() -> None:
    drive = Odrive(settings=WATCHED)
    drive.start()
    drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.05)
    drive.drive.happen("bus-off", 0.2)
    assert drive.wait(0.15) == []
    assert drive.send(CanSimpleCommand.GET_VERSION) == []
    assert drive.drive.motor.torque == 0.0
    assert drive.wait(0.1) != []
    assert drive.errors[1] == Error.WATCHDOG_TIMER_EXPIRED


def test_the_other_modes_hold_a_position_or_a_velocity() -> None:
    drive = Odrive(settings=FREE | {"axis0.controller.config.vel_limit": "10"})
    drive.send(CanSimpleCommand.SET_CONTROLLER_MODE, "II", 3, 1)
    drive.send(CanSimpleCommand.SET_AXIS_STATE, "I", 8)
    drive.wait(0.001)
    drive.send(CanSimpleCommand.SET_INPUT_POS, "fhh", 0.25, 0, 0)
    drive.wait(2.0)
    assert drive.ask(CanSimpleCommand.GET_ENCODER_ESTIMATES, "ff")[0] == pytest.approx(0.25, abs=1e-3)
    drive.send(CanSimpleCommand.SET_CONTROLLER_MODE, "II", 2, 1)
    drive.send(CanSimpleCommand.SET_INPUT_VEL, "ff", 1.5, 0.0)
    drive.wait(1.0)
    assert drive.ask(CanSimpleCommand.GET_ENCODER_ESTIMATES, "ff")[1] == pytest.approx(1.5, rel=0.05)


def test_frame_of_a_second_host_moves_the_drive_and_reaches_the_first_host() -> None:
    drive = Odrive(settings=FREE)
    drive.start()
    (frame,) = drive.drive.happen("master", 0.03)
    assert frame == Frame(CanSimpleCommand.SET_INPUT_TORQUE, struct.pack("<f", 0.03))
    drive.wait(0.001)
    assert drive.drive.motor.torque == pytest.approx(0.03)


def test_a_parameter_is_read_and_written_by_the_number_of_its_path() -> None:
    drive = Odrive()
    endpoints = SimulatedOdrive.flat_endpoints()["endpoints"]
    limit = endpoints["axis0.controller.config.vel_limit"]
    flag = endpoints["axis0.controller.config.enable_torque_mode_vel_limit"]
    assert (limit["type"], flag["type"]) == ("float", "bool")
    (answer,) = drive.send(CanSimpleCommand.RX_SDO, "BHB", 0, flag["id"], 0)
    assert answer.identifier == CanSimpleCommand.TX_SDO
    assert answer.data == struct.pack("<BHB?", 0, flag["id"], 0, True)
    (confirmed,) = drive.send(CanSimpleCommand.RX_SDO, "BHBf", 1, limit["id"], 0, 7.5)
    assert confirmed.data == struct.pack("<BHB", 0, limit["id"], 0)
    (answer,) = drive.send(CanSimpleCommand.RX_SDO, "BHB", 0, limit["id"], 0)
    assert struct.unpack_from("<f", answer.data, 4) == (7.5,)
    assert drive.send(CanSimpleCommand.RX_SDO, "BHB", 0, 60000, 0) == []
    assert Odrive(firmware=(0, 6, 10)).send(CanSimpleCommand.RX_SDO, "BHBf", 1, limit["id"], 0, 7.5) == []


def test_saved_settings_survive_a_reboot_and_the_torque_does_not() -> None:
    drive = Odrive(settings=FREE)
    drive.send(CanSimpleCommand.SET_LIMITS, "ff", 3.0, 20.0)
    drive.send(CanSimpleCommand.REBOOT, "B", 1)
    drive.send(CanSimpleCommand.SET_LIMITS, "ff", 4.0, 20.0)
    drive.start()
    drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.05)
    drive.wait(0.001)
    drive.send(CanSimpleCommand.REBOOT, "B", 0)
    drive.wait(0.001)
    assert (drive.state, drive.drive.motor.torque) == (1, 0.0)
    assert drive.drive.values["axis0.controller.config.vel_limit"] == 3.0


def test_another_node_a_wrong_encoder_and_a_calibration_lead_nowhere() -> None:
    assert Odrive().drive.receive(Frame(3 << 5 | CanSimpleCommand.GET_VERSION, b"", remote=True)) == []
    blind = Odrive(settings=FREE | {"axis0.config.load_encoder": "5"})
    blind.wait(0.001)
    blind.start()
    assert (blind.state, blind.errors[0]) == (1, Error.MISSING_ESTIMATE)
    drive = Odrive()
    drive.send(CanSimpleCommand.SET_AXIS_STATE, "I", 3)
    assert drive.ask(CanSimpleCommand.HEARTBEAT, "IBBBx")[2] == Result.INVALID_STATE


def test_a_linear_rig_and_an_unknown_setting_are_refused() -> None:
    with pytest.raises(ConfigError, match="linear"):
        Odrive(linear_rig())
    with pytest.raises(ConfigError, match=r"axis0\.nothing"):
        Odrive(settings={"axis0.nothing": "1"})


def test_how_time_is_cut_changes_no_bit() -> None:
    def ran(steps: list[int]) -> tuple[float, ...]:
        drive = Odrive(drive_rig(coulomb=0.001), FREE)
        drive.start()
        drive.send(CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.03)
        for step in steps:
            drive.drive.run(drive.drive.ticks + step)
        return drive.ask(CanSimpleCommand.GET_ENCODER_ESTIMATES, "ff")

    assert ran([300]) == ran([1] * 300) == ran([7] * 42 + [6])
