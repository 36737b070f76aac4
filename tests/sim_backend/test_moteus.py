"""The simulated moteus against the pages of the maker's documentation that its modules cite. Time is virtual."""

import math
from dataclasses import replace

import pytest

from rig.core.errors import ConfigError
from sim_backend.drives.moteus_law import PLL_SHAPE, RATE_HZ
from tests.conformance.drives import INERTIA, KT, NAN, RATIO, Moteus, drive_rig
from tests.conformance.rigs import linear_rig

STILL = {"servo.timeout_mode": "0"}
TURN = 2.0 * math.pi
SHAFT_INERTIA = INERTIA / RATIO**2  # kg·m², as the shaft feels it
WATCHDOG_S = 0.1  # servo.default_timeout_s


def test_the_example_of_the_can_page_is_answered_in_its_form() -> None:
    drive = Moteus()
    answer = drive.send(bytes.fromhex("01000a07206000200150ff140400130d"))
    assert answer is not None
    assert answer[:3] == bytes.fromhex("240400")  # int16, four registers, from 0
    assert answer[11:13] == bytes.fromhex("230d")  # int8, three registers, from 13
    assert len(answer) == 16


@pytest.mark.parametrize(("form", "step"), [("b", 0.5), ("h", 0.1), ("i", 0.001), ("f", 1.0)])
def test_a_register_is_read_in_every_form(form: str, step: float) -> None:
    assert Moteus(voltage=24.0).read(0x00D, form) == pytest.approx(24.0 / step)


def test_nan_is_the_most_negative_integer() -> None:
    drive = Moteus()
    drive.torque(0.0)
    assert [drive.read(0x020, form) for form in "bhi"] == [-(1 << 7), -(1 << 15), -(1 << 31)]
    assert math.isnan(drive.read(0x020))


def test_invalid_access_is_answered_with_the_register_and_a_reason() -> None:
    drive = Moteus()
    assert drive.send(bytes((0x1D, 0x60))) == bytes((0x31, 0x60, 1))
    assert drive.send(bytes((0x11, 0x81, 0x02))) == bytes((0x31, 0x81, 0x02, 1))  # the version, not as int32
    assert drive.send(bytes((0x01, 0x01, 5))) == bytes((0x30, 0x01, 2))  # position: not writeable
    assert drive.send(bytes((0x01, 0x00, 16))) == bytes((0x30, 0x00, 1))  # no such mode


def test_drive_accepts_its_own_number_and_broadcast_only() -> None:
    drive = Moteus(settings={"id.id": "5"})
    query = bytes((0x11, 0x00))
    assert drive.send(query, 0x8001) is None
    assert drive.send(query, 0x8005) is not None
    assert drive.send(query, 0x807F) is not None
    assert drive.send(query, 0x0005) is None  # without the bit that requests a reply


def test_drive_reports_its_firmware_and_serial_number() -> None:
    drive = Moteus(firmware=0x010203, serial=(1, 2, 0xFFFFFFFF))
    assert drive.read(0x101, "i") == 0x010203
    assert drive.read(0x102, "i") == 5
    assert [drive.read(0x120 + word, "i") for word in range(3)] == [1, 2, -1]


def test_enabling_takes_milliseconds_without_torque() -> None:
    drive = Moteus()
    seen = []
    drive.torque(0.1, timeout=NAN)
    for _ in range(30):
        drive.wait(0.001)
        seen.append(int(drive.read(0)))
        if seen[-1] < 10:
            assert drive.command == 0.0
    assert sorted(set(seen)) == [2, 3, 10]
    assert seen == sorted(seen)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("gear", [1.0, 0.5])
def test_feed_forward_torque_accelerates_the_rig_through_its_ratios(gear: float, sign: int) -> None:
    output = {"motor_position.rotor_to_output_ratio": str(gear), "motor_position.output.sign": str(sign)}
    drive = Moteus(settings=output)
    drive.start()
    drive.torque(0.05)
    drive.wait(0.05)
    assert drive.read(3) == pytest.approx(0.05, rel=1e-6)
    assert drive.read(4) == pytest.approx(0.05 * gear / KT, rel=1e-6)
    acceleration = 0.05 * gear**2 / SHAFT_INERTIA / TURN  # rev/s²
    delay_s = PLL_SHAPE / (TURN * 400.0) * 2.0  # of a ramp through a critically damped loop
    assert drive.read(2) == pytest.approx(acceleration * (0.05 - delay_s), rel=0.02)
    assert drive.drive.motor.turns * sign > 0.0


def test_a_drive_that_is_wrong_about_its_motor_is_wrong_about_torque_and_right_about_current() -> None:
    drive = Moteus()
    kv = float(drive.console("conf get motor.Kv"))
    drive.console(f"conf set motor.Kv {kv / 2.0}")  # half of Kv is twice the torque of an ampere
    drive.start()
    drive.torque(0.05)
    drive.wait(0.01)
    assert drive.read(3) == pytest.approx(0.05)
    assert drive.command == pytest.approx(0.025)
    assert drive.read(4) == pytest.approx(0.025 / KT)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_positive_torque_turns_the_way_the_encoder_counts(sign: int) -> None:
    drive = Moteus(drive_rig(sign=sign))
    drive.start()
    drive.torque(0.02)
    drive.wait(0.03)
    assert drive.read(1) > 0.001
    assert drive.drive.motor.turns > 0.0


def test_position_is_the_count_in_turns_on_a_grid_of_its_own() -> None:
    drive = Moteus(drive_rig(initial_position=0.3))
    drive.wait(0.05)
    position = drive.read(1)
    assert position == pytest.approx(drive.drive.motor.count / 16384, abs=1 / 65536)
    assert position * 65536 == round(position * 65536)


def test_at_power_up_an_absolute_encoder_knows_the_turn_and_an_incremental_one_nothing() -> None:
    far = 5.0  # rad at the link: 1.59 turns of the shaft
    absolute = Moteus(drive_rig(initial_position=far))
    absolute.wait(0.05)
    assert absolute.read(1) == pytest.approx(far * RATIO / TURN - 2.0, abs=1e-3)
    assert absolute.read(0x00C, "b") == 1
    model = drive_rig(initial_position=far)
    incremental = Moteus(replace(model, encoder=replace(model.encoder, counts_per_revolution=1000)))
    incremental.wait(0.05)
    assert incremental.read(1) == pytest.approx(0.0, abs=1e-4)
    assert incremental.read(0x00C, "b") == 0
    assert incremental.console("conf get motor_position.sources.0.cpr") == "4000\r\n"


# ---------------------------------------------------------------------- watchdog


def test_a_command_lives_for_its_time_and_only_a_stop_ends_the_time_out() -> None:
    drive = Moteus(settings=STILL)
    drive.start(timeout=0.02)
    drive.torque(0.05, timeout=0.02)
    drive.wait(0.0199)
    assert (drive.read(0), drive.command) == (10, pytest.approx(0.05))
    drive.wait(0.0002)
    assert (drive.read(0), drive.command) == (11, 0.0)
    drive.torque(0.05)
    drive.wait(0.01)
    assert (drive.read(0), drive.command) == (11, 0.0)
    drive.write(0)
    drive.wait(0.001)
    assert drive.read(0) == 0


def test_without_a_time_of_its_own_a_command_has_that_of_the_configuration() -> None:
    drive = Moteus(settings=STILL)
    drive.start()
    drive.torque(0.01)
    drive.wait(WATCHDOG_S - 0.001)
    assert drive.read(0) == 10
    drive.wait(0.002)
    assert drive.read(0) == 11


def test_a_question_feeds_no_watchdog() -> None:
    drive = Moteus(settings=STILL)
    drive.start()
    for _ in range(110):
        drive.wait(0.001)
        drive.read(1)
    assert drive.read(0) == 11


def expiring_drive(kd_scale: float = 0.0, **settings: str) -> Moteus:
    """Return a drive whose watchdog expires while it turns at some revolutions per second."""
    drive = Moteus(settings={f"servo.{name}": value for name, value in settings.items()})
    drive.start()
    drive.torque(0.05)
    drive.wait(0.05)
    drive.write(10, {0x020: NAN, 0x023: 0.0, 0x024: kd_scale, 0x02B: 0.0})
    drive.wait(WATCHDOG_S + 0.001)
    assert drive.read(0) == 11
    return drive


def test_a_time_out_lets_go_or_damps_or_brakes_or_holds_as_configured() -> None:
    free = expiring_drive(timeout_mode="0")
    assert free.command == 0.0
    damped = expiring_drive(1.0, timeout_mode="12")
    kd = 0.05  # N·m a revolution a second
    assert damped.command == pytest.approx(-kd * damped.read(2), rel=0.02)
    # With the last command's kd scale: fw, ISR_DoZeroVelocity.
    assert expiring_drive(0.0, timeout_mode="12").command == 0.0
    braked = expiring_drive(timeout_mode="15")
    per_turn = TURN * KT**2 / (1.5 * 0.05)
    assert braked.command == pytest.approx(-per_turn * braked.read(2), rel=0.02)
    held = expiring_drive(timeout_mode="10", default_accel_limit="200", default_velocity_limit="nan")
    held.wait(1.0)
    there = held.read(1)
    held.wait(0.5)
    assert held.read(1) == pytest.approx(there, abs=2e-3)
    assert abs(held.read(2)) < 0.02
    assert held.read(0) == 11


# ---------------------------------------------------------------------- control


def test_position_mode_is_a_spring_and_a_damper_around_the_command() -> None:
    drive = Moteus(settings={"servo.default_accel_limit": "nan"})
    drive.start()
    drive.write(10, {0x020: 0.1, 0x024: 0.0, 0x027: NAN})
    drive.wait(0.0005)
    assert drive.command == pytest.approx(4.0 * 0.1, rel=1e-3)  # kp, N·m a revolution


def test_a_trajectory_keeps_its_acceleration_and_arrives() -> None:
    drive = Moteus(settings={"servo.default_accel_limit": "10"})
    drive.start()
    drive.write(10, {0x020: 0.5, 0x027: NAN})
    drive.wait(0.1)
    assert drive.read(0x039) == pytest.approx(1.0, rel=1e-3)
    assert drive.read(0x00B, "b") == 0
    drive.wait(2.0 * math.sqrt(0.5 / 10.0) - 0.1 + 0.02)
    assert drive.read(0x038) == pytest.approx(0.5, abs=1e-4)
    assert drive.read(0x039) == 0.0
    assert drive.read(0x00B, "b") == 1


def test_stay_within_is_free_inside_and_pulls_from_outside_also_on_the_way_back() -> None:
    drive = Moteus(settings=STILL)
    drive.start()
    wall = {0x040: -1.0, 0x041: 0.002, 0x023: 1.0, 0x024: 1.0, 0x046: NAN}
    drive.write(13, wall)
    drive.wait(0.01)
    assert (drive.read(0), drive.command) == (13, 0.0)
    drive.torque(0.1, timeout=NAN)
    drive.wait(0.02)
    drive.write(13, wall)
    pulls_on_exit = False
    for _ in range(3000):
        drive.wait(1 / RATE_HZ)
        position, velocity = drive.read(1), drive.read(2)
        inside = position <= 0.002
        wanted = 0.0 if inside else -4.0 * (position - 0.002) - 0.05 * velocity
        assert drive.read(0x03A) == pytest.approx(wanted, abs=1e-6)
        pulls_on_exit |= wanted > 0.0
    assert pulls_on_exit


def test_limits_say_which_one_is_in_effect() -> None:
    drive = Moteus(settings={"servo.max_current_A": "1"})
    drive.start()
    drive.write(10, {0x020: NAN, 0x022: 0.2, 0x023: 0.0, 0x024: 0.0, 0x025: 0.03, 0x027: NAN})
    drive.wait(0.001)
    assert (drive.command, drive.read(0x00F, "b")) == (pytest.approx(0.03), 102)
    drive.torque(0.2)
    drive.wait(0.001)
    assert (drive.command, drive.read(0x00F, "b")) == (pytest.approx(1.0 * KT), 99)
    drive.console("conf set servopos.position_max -0.01")
    drive.torque(0.04)
    drive.wait(0.001)
    assert drive.read(0x00F, "b") == 103
    assert 0.0 < drive.command < 0.04


# ---------------------------------------------------------------------- faults


@pytest.mark.parametrize(
    ("event", "value", "code"),
    [("fault", 33, 33), ("voltage", 3.0, 40), ("voltage", 60.0, 34), ("temperature", 80.0, 38)],
)
def test_a_fault_ends_the_torque_and_stays_until_a_stop(event: str, value: float, code: int) -> None:
    drive = Moteus(settings=STILL)
    drive.start()
    drive.torque(0.05, timeout=NAN)
    drive.wait(0.001)
    drive.drive.happen(event, value)
    drive.wait(0.001)
    drive.torque(0.05, timeout=NAN)
    drive.wait(0.05)
    assert (drive.read(0), drive.read(0x00F, "b"), drive.command) == (1, code, 0.0)
    drive.drive.happen("voltage", 24.0)
    drive.drive.happen("temperature", 25.0)
    drive.write(0)
    drive.wait(0.001)
    assert (drive.read(0), drive.read(0x00F, "b")) == (0, 0)


def test_outside_its_bounds_or_without_a_source_position_mode_does_not_start() -> None:
    outside = Moteus(settings={"servopos.position_max": "-0.1"})
    outside.torque(0.0)
    outside.wait(0.02)
    assert (outside.read(0), outside.read(0x00F, "b")) == (1, 39)
    blind = Moteus(settings={"motor_position.output.source": "1"})
    blind.torque(0.05)
    blind.wait(0.02)
    assert (blind.read(0), blind.read(0x00F, "b"), blind.command) == (1, 43, 0.0)


def test_a_stop_position_beside_a_limit_is_a_fault() -> None:
    drive = Moteus()
    drive.start()
    drive.write(10, {0x020: 0.0, 0x026: 0.1})
    drive.wait(0.001)
    assert (drive.read(0), drive.read(0x00F, "b")) == (1, 45)


def test_frame_of_a_second_host_moves_the_drive_and_reaches_the_first_host() -> None:
    drive = Moteus(settings=STILL)
    drive.start()
    (frame,) = drive.drive.happen("master", 0.03)
    assert frame.identifier == 0x0102
    drive.wait(0.001)
    assert drive.command == pytest.approx(0.03)


def test_drive_after_a_reboot_is_stopped_and_has_its_stored_settings() -> None:
    drive = Moteus(settings=STILL)
    drive.console("conf set servo.default_timeout_s 0.5")
    drive.console("conf write")
    drive.console("conf set servo.default_timeout_s 0.7")
    drive.start()
    drive.drive.happen("reboot", 0.0)
    drive.wait(0.001)
    assert (drive.read(0), drive.command) == (0, 0.0)
    assert drive.console("conf get servo.default_timeout_s") == "0.500000\r\n"


# ---------------------------------------------------------------------- console


def test_the_console_knows_its_settings_and_refuses_others() -> None:
    drive = Moteus()
    assert drive.console("conf set servo.timeout_mode 0") == "OK\r\n"
    assert drive.console("conf get servo.timeout_mode") == "0\r\n"
    assert drive.console("conf get unknown.name") == "ERR unknown group\r\n"
    assert drive.console("conf get servo.unknown") == "ERR error reading\r\n"
    assert drive.console("conf set servo.timeout_mode soon") == "ERR error setting\r\n"
    assert drive.console("unknown") == "ERR unknown command\r\n"
    listed = drive.console("conf enumerate").splitlines()
    assert "servo.timeout_mode 0" in listed
    assert listed[-1] == "OK"
    assert drive.console("conf default") == "OK\r\n"
    assert drive.console("conf get servo.timeout_mode") == "12\r\n"


def test_the_console_drives_without_a_watchdog() -> None:
    drive = Moteus(settings=STILL)
    assert drive.console("d pos nan 0 nan p0 d0 i0 f0.02") == "OK\r\n"
    drive.wait(0.3)
    assert (drive.read(0), drive.command) == (10, pytest.approx(0.02))
    assert drive.console("d stop") == "OK\r\n"
    drive.wait(0.001)
    assert drive.read(0) == 0
    assert drive.console("d jump 3") == "ERR unknown command\r\n"


def test_numbered_packets_of_the_stream_are_repeated_until_they_are_acknowledged() -> None:
    drive = Moteus()
    drive.send(bytes((0x40, 1, 9)) + b"conf get ", 0x0001)
    drive.send(bytes((0x40, 1, 6)) + b"id.id\n", 0x0001)
    first = drive.send(bytes((0x44, 1, 0, 40)))
    assert first == bytes((0x43, 1, 1, 3)) + b"1\r\n"
    assert drive.send(bytes((0x44, 1, 0, 40))) == first
    assert drive.send(bytes((0x44, 1, 1, 40))) == bytes((0x43, 1, 2, 0))


# ---------------------------------------------------------------------- time


def test_how_time_is_cut_changes_no_bit() -> None:
    def ran(steps: list[int]) -> list[float]:
        drive = Moteus(drive_rig(coulomb=0.001))
        drive.start()
        drive.torque(0.03)
        for step in steps:
            drive.drive.run(drive.drive.ticks + step)
        return [drive.read(register) for register in (1, 2, 3)]

    assert ran([300]) == ran([1] * 300) == ran([7] * 42 + [6])


def test_nan_torque_moves_nothing() -> None:
    drive = Moteus()
    drive.start()
    drive.torque(NAN)
    drive.wait(0.01)
    assert (drive.command, drive.read(2)) == (0.0, 0.0)


def test_a_linear_rig_and_an_unknown_setting_are_refused() -> None:
    with pytest.raises(ConfigError, match="linear"):
        Moteus(linear_rig())
    with pytest.raises(ConfigError, match=r"servo\.nothing"):
        Moteus(settings={"servo.nothing": "1"})
