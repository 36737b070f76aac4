"""An ODrive under a bridge: unsuitable drives are rejected with a reason, and its separate clock is tracked."""

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.faults import Status
from firmware_protocol.parameters import BY_NAME
from rig import config
from rig.config import controller
from rig.core import errors
from rig.devices.device import DeviceUrl
from rig.extras.drives import describe, odrive
from rig.extras.drives.address import address_of
from rig.extras.drives.bus import CanFrame
from rig.extras.drives.faults import DriveFault
from sim_backend.drives.bus import Frame
from sim_backend.drives.can_simple import CanSimpleCommand, Error
from sim_backend.drives.odrive import OdriveOptions, SimulatedOdrive
from tests.conformance.bridged import (
    CURRENT,
    ODRIVE_SETUP,
    Bridged,
    MemoryBus,
    armed,
    bridged_rig,
    endpoints,
    find_odrive,
    push,
    push_until_fault,
    write_endpoints,
)
from tests.conformance.host import RUN_PARAMETERS, Host

TURN = 4 * 4096  # counts


def drive_with(settings: dict[str, str] | None = None, **options: Any) -> SimulatedOdrive:
    return SimulatedOdrive(bridged_rig(), OdriveOptions(settings=ODRIVE_SETUP | (settings or {}), **options))


def refusal(drive: SimulatedOdrive, model: Any = None, kind: Any = errors.DeviceRefusedError) -> str:
    """Return the message of a rejection; the drive stays at rest."""
    with pytest.raises(kind) as caught:
        find_odrive(drive, model or bridged_rig())
    assert caught.value.remedy
    assert drive.motor.torque == 0.0
    return str(caught.value)


def test_a_drive_that_fits_is_described() -> None:
    drive = find_odrive(drive_with(), bridged_rig())
    assert drive.firmware == "ODrive 0.6.11"
    assert (drive.counts_per_turn, drive.transmission) == (TURN, pytest.approx(2.0))
    assert drive.settings["torque_constant"] == pytest.approx(0.05)  # 0.1 N·m/A at the link, geared 1:2
    assert (drive.cycle_us, drive.beat_us, drive.rate_maximum) == (1000, 10_000, 1000)


def test_a_file_to_start_from_stays_within_the_limits_of_the_drive(tmp_path: Path) -> None:
    """This includes the speed that ends a run: the manufacturer's default is an error at 2.4 turns a second."""
    drive = drive_with({odrive.OVERSPEED: "1", "axis0.controller.config.vel_limit": "2.0"})
    facts = odrive.find(odrive.OdriveConversation(MemoryBus(drive), 0, endpoints()))
    (tmp_path / "mine.toml").write_text(describe.text(facts, "odrive://can0"))
    x = config.load_experiment(tmp_path / "mine.toml")
    run = controller.prepare_controller(x)
    for name, (low, high) in odrive.fit(facts, config.rig_model(x)).ranges.items():
        assert low <= run.parameters[name] <= high, name


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (odrive.WATCHDOG, "0", "the last torque would persist when this computer stops sending"),
        (odrive.WATCHDOG_S, "0.2", "the last torque would persist for this time"),
        (odrive.WATCHDOG_S, "0.0015", "less than 2 times encoder_msg_rate_ms"),
        (odrive.VELOCITY_LIMITED, "1", "would reduce the commanded torque"),
        (odrive.ENCODER_MS, "0", "sends its position too rarely"),
        (odrive.TORQUES_MS, "0", "a measured torque"),
        (odrive.HEARTBEAT_MS, "100", "heartbeats show that"),
        (odrive.ENCODER, "5", "this encoder is not supported"),
        (odrive.TORQUE_CONSTANT, "-0.05", "is not set up"),
        (odrive.TORQUE_CONSTANT, "0.1", "0.2 N·m/A at the handle, but the experiment has 0.1"),
    ],
)
def test_a_drive_that_is_set_up_otherwise(path: str, value: str, says: str) -> None:
    assert says in refusal(drive_with({path: value}))


def test_all_that_is_wrong_is_named_at_once_with_what_to_type() -> None:
    drive = SimulatedOdrive(bridged_rig(), OdriveOptions())  # as the maker delivers it
    with pytest.raises(errors.DeviceRefusedError) as caught:
        find_odrive(drive, bridged_rig())
    for path in (odrive.WATCHDOG, odrive.VELOCITY_LIMITED, odrive.TORQUES_MS, odrive.HEARTBEAT_MS):
        assert path in str(caught.value)
        assert f"odrv0.{path} = " in str(caught.value.remedy)


def test_another_version_of_firmware_or_of_the_file() -> None:
    assert "firmware 0.5.6" in refusal(drive_with(firmware=(0, 5, 6)), kind=errors.IncompatibleDeviceError)
    text = refusal(drive_with(firmware=(0, 6, 9)), kind=errors.IncompatibleDeviceError)
    assert "firmware 0.6.9, but flat_endpoints.json is for 0.6.11" in text
    numbers = replace(endpoints(), by_path={})
    with pytest.raises(errors.IncompatibleDeviceError, match=r"has no parameter axis0\.config"):
        find_odrive(drive_with(), bridged_rig(), numbers=numbers)


def test_another_node_on_the_bus() -> None:
    with pytest.raises(
        errors.DeviceNotFoundError, match="no reply from the ODrive 7 at memory; nodes seen on this bus: 0"
    ):
        find_odrive(drive_with(), bridged_rig(), node=7)


def test_a_second_master_is_found_before_the_first_frame_is_sent() -> None:
    bus = MemoryBus(drive_with())
    bus.waiting.append(CanFrame(CanSimpleCommand.SET_INPUT_TORQUE, bytes(4)))
    with pytest.raises(errors.DeviceRefusedError, match="second bus master"):
        odrive.find(odrive.OdriveConversation(bus, 0, endpoints()))
    assert bus.sent == 0


def test_a_drive_under_another_host_or_stopped_with_an_error_is_refused() -> None:
    driven = drive_with({odrive.WATCHDOG: "0"})
    driven.receive(Frame(CanSimpleCommand.SET_AXIS_STATE, struct.pack("<I", 8)))
    assert "closed loop: another program drives it" in refusal(driven)
    stopped = drive_with()
    stopped.happen("fault", Error.DRV_FAULT)
    assert "error 0x00000020" in refusal(stopped)


def test_a_drive_after_a_killed_bridge_is_accepted() -> None:
    left = drive_with()
    left.receive(Frame(CanSimpleCommand.SET_AXIS_STATE, struct.pack("<I", 8)))
    left.run(left.ticks + 80)  # its watchdog has ended it
    assert find_odrive(left, bridged_rig()).id == 0


def test_an_answer_that_takes_longer_than_half_a_period_is_a_slow_bus() -> None:
    found = odrive.find(odrive.OdriveConversation(MemoryBus(drive_with()), 0, endpoints()))
    with pytest.raises(errors.DeviceRefusedError, match=r"at most 0\.5 ms") as caught:
        odrive.fit(replace(found, quickest_s=0.9e-3), bridged_rig())
    assert "baud_rate = 1000000" in str(caught.value.remedy)


def test_a_url_names_the_makers_file(tmp_path: Path) -> None:
    with pytest.raises(errors.ConfigError, match="the URL has no endpoints file") as caught:
        address_of(DeviceUrl.parse("odrive://can0"))
    assert "docs.odriverobotics.com" in str(caught.value.remedy)
    (tmp_path / "list.json").write_text("[]")
    for invalid in (tmp_path, tmp_path / "list.json"):
        with pytest.raises(errors.ConfigError, match=r"is not an ODrive's flat_endpoints\.json"):
            address_of(DeviceUrl.parse(f"odrive://can0?endpoints={invalid}"))
    place = write_endpoints(tmp_path / "flat_endpoints.json")
    with pytest.raises(errors.ConfigError, match="id = '63'"):
        address_of(DeviceUrl.parse(f"odrive://can0?id=63&endpoints={place}"))
    address_of(DeviceUrl.parse(f"odrive://can0?id=62&endpoints={place}"))


def test_its_limits_are_those_of_the_device() -> None:
    settings = {
        odrive.OVERSPEED: "1",
        odrive.VELOCITY: "2",
        odrive.TOLERANCE: "1.5",
        odrive.MOST_TORQUE: "0.02",
    }
    drive = find_odrive(drive_with(settings), bridged_rig())
    assert drive.ranges["speed_limit"] == (0, 3 * TURN)
    assert drive.ranges["current_limit"] == (0, 400)  # quanta of 1 mA: 0.02 N·m at 0.05 N·m/A
    assert drive.ranges["position_rate"] == (400, 1000)  # two periods at least within its watchdog's 5 ms


# ---------------------------------------------------------------------- its own clock


@pytest.mark.parametrize("drift", [-0.005, 0.005])
def test_a_drive_whose_clock_differs_is_followed(drift: float) -> None:
    """Half a message lies between a period and its sample, so none is duplicated or skipped."""
    world = Bridged(kind="odrive", drift=drift)
    world.run(0.02)
    before = world.bridge.facts.replies
    world.run(1.0)  # five periods more, or less
    facts = world.bridge.facts
    assert (facts.lost, facts.skipped) == (0, 0)
    assert facts.replies - before == pytest.approx(1000 * (1.0 + drift), abs=2)
    assert facts.quantile_us(0.5) == pytest.approx(500, rel=0.15)


def test_a_period_is_a_whole_number_of_messages() -> None:
    world = Bridged(kind="odrive", settings={odrive.WATCHDOG_S: "0.05"})
    host = Host(world)
    host.identify()
    assert host.configure(**{**RUN_PARAMETERS, "position_rate": 500}).status == Status.OK
    world.run(0.05)
    before = world.bridge.facts.replies
    world.run(0.1)
    assert world.bridge.facts.replies - before in (49, 50, 51)
    assert host.configure(**{**RUN_PARAMETERS, "position_rate": 300}).status != Status.OK
    ack = host.configure(**{**RUN_PARAMETERS, "position_rate": 1001})
    assert (ack.status, ack.detail) == (Status.OUT_OF_RANGE, BY_NAME["position_rate"].id)


def test_without_its_heartbeat_a_drive_may_have_stopped() -> None:
    world, host = armed(Bridged(kind="odrive"))
    push(host, 5)
    world.strike("from drive", lambda line: b"" if line[0] == CanSimpleCommand.HEARTBEAT else line)
    assert push_until_fault(host, 80).fault == DriveFault.DRIVE_SILENT
    world.run(0.01)
    assert world.torque == 0.0


def test_a_drive_that_changes_a_torque_is_counted_and_left() -> None:
    """The drive's USB port sets a limit that would be refused at the start."""
    world, host = armed(Bridged(kind="odrive"))
    push(host, 5)
    world.drive._write_parameter(odrive.MOST_TORQUE, 0.97 * CURRENT * 1e-3 * 0.05)  # less than measuring sees
    assert push_until_fault(host, 20).fault == DriveFault.DRIVE_LEFT
    assert world.bridge.facts.limited > 0
    world.run(0.01)
    assert world.torque == 0.0


def test_a_drive_that_is_armed_again_has_been_cleared() -> None:
    world, host = armed(Bridged(kind="odrive"))
    push(host, 5)
    world.happen("estop")
    push_until_fault(host, 15)
    world.run(0.05)
    host.disarm(clear_fault=True)
    host.begin(2)
    push(host, 20)
    assert world.torque == pytest.approx(CURRENT * 1e-3 * 0.05, rel=1e-6)
