"""A bridge rejects an unsuitable moteus with a message that gives reason and remedy, and nothing moves."""

import math
from dataclasses import replace
from typing import Any

import pytest

from firmware_protocol.faults import Status
from firmware_protocol.parameters import BY_NAME
from rig.core import errors
from rig.core.model import Encoder, Reference, RigModel
from rig.extras.drives.bus import CanFrame
from rig.extras.drives.moteus import MoteusConversation, find, fit, switches_of
from sim_backend.drives.moteus import MoteusOptions, SimulatedMoteus
from tests.conformance.bridged import MOTEUS_SETUP, Bridged, MemoryBus, bridged_rig, find_moteus
from tests.conformance.host import RUN_PARAMETERS, Host

TURN = 4 * 4096  # counts


def moteus(**settings: str) -> SimulatedMoteus:
    named = {name.replace("__", "."): text for name, text in settings.items()}
    return SimulatedMoteus(bridged_rig(), MoteusOptions(settings={**MOTEUS_SETUP, **named}))


def other(**parts: Any) -> RigModel:
    """Return the rig of the tests with changed parts, by their keys or whole."""
    model = bridged_rig()
    for name, changed in parts.items():
        part = replace(getattr(model, name), **changed) if isinstance(changed, dict) else changed
        model = replace(model, **{name: part})
    return model


def refusal(drive: SimulatedMoteus, model: Any = None, kind: Any = errors.DeviceRefusedError) -> str:
    with pytest.raises(kind) as caught:
        find_moteus(drive, model or bridged_rig())
    assert caught.value.remedy
    return str(caught.value)


def test_a_drive_that_fits_is_described() -> None:
    drive = find_moteus(moteus(), bridged_rig())
    assert drive.firmware == "moteus 1.0.0"
    assert drive.counts_per_turn == TURN
    assert drive.transmission == pytest.approx(2.0)  # turns of its output for one of the link
    assert drive.settings["torque_constant"] == pytest.approx(0.05)  # 0.1 N·m/A at the link


@pytest.mark.parametrize(
    ("setting", "value", "says"),
    [
        ("servo__timeout_mode", "12", "servo.timeout_mode = 12"),
        ("servo__timeout_mode", "15", "brake or hold"),
        ("servo__voltage_mode_control", "1", "would not apply the commanded torque"),
        ("servo__fixed_voltage_mode", "1", "would not apply the commanded torque"),
        ("servo__inertia_feedforward", "0.1", "would add torque to the commanded one"),
        ("servo__fault_position_error", "0.5", "when the handle moves"),
        ("servo__fault_velocity_error", "0.5", "when the handle moves"),
        ("motor__poles", "0", "not calibrated"),
        ("motor__Kv", "0", "not calibrated"),
        ("motor_position__sources__0__cpr", "8192", "8192 counts per turn, but the experiment has 16384"),
        ("motor__Kv", "500", "N·m/A at the handle, but the experiment has 0.1"),
        ("motor_position__rotor_to_output_ratio", "0.2", "65536 steps per turn"),
    ],
)
def test_a_drive_that_is_set_up_otherwise(setting: str, value: str, says: str) -> None:
    assert says in refusal(moteus(**{setting: value}))


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (
            other(amplifier={"effort_per_ampere": 0.05}),
            "0.1 N·m/A at the handle, but the experiment has 0.05",
        ),
        (other(encoder={"ratio": 2.0 * math.tau}), "the experiment has 0.1"),  # radians for revolutions
        (other(encoder=Encoder(counts_per_revolution=16384, ratio=2.0)), "the experiment has 65536"),
        (other(amplifier={"drive": "voltage"}), "controls the current"),
        (other(amplifier={"current_monitor": False}), "measures its current"),
        (other(reference=Reference(index=True, travel=1.0)), "neither an encoder index"),
    ],
)
def test_an_experiment_that_is_about_another_rig(model: RigModel, says: str) -> None:
    assert says in refusal(moteus(), model)


def test_another_generation_of_firmware() -> None:
    drive = moteus()
    drive._integer_registers[0x102] = 4
    assert "register map 4" in refusal(drive, kind=errors.IncompatibleDeviceError)


def test_a_firmware_without_a_setting() -> None:
    drive = moteus()
    del drive.settings.values["servo.inertia_feedforward"]
    assert "no setting servo.inertia_feedforward" in refusal(drive, kind=errors.IncompatibleDeviceError)


def test_another_id_on_the_bus() -> None:
    with pytest.raises(errors.DeviceNotFoundError, match="no reply from the moteus 7 at memory"):
        find_moteus(moteus(), bridged_rig(), number=7)


def test_a_second_master_is_found_before_the_first_frame_is_sent() -> None:
    bus = MemoryBus(moteus())
    bus.waiting.append(CanFrame(0x8001, b"\x11\x00"))
    with pytest.raises(errors.DeviceRefusedError, match="second bus master"):
        find(MoteusConversation(bus, 1), 1)
    assert bus.sent == 0


@pytest.mark.parametrize(("mode", "says"), [(10, "position"), (12, "zero velocity"), (15, "brake")])
def test_a_drive_under_another_host_is_refused(mode: int, says: str) -> None:
    drive = moteus()
    drive.happen("mode", mode)
    drive.run(drive.ticks + 3000)
    assert says in refusal(drive)


def test_a_drive_that_has_stopped_with_a_fault() -> None:
    drive = moteus()
    drive.happen("mode", 10)
    drive.run(drive.ticks + 3000)
    drive.happen("fault", 34)
    drive.run(drive.ticks + 30)
    assert "fault 34" in refusal(drive)


def test_a_drive_after_a_killed_bridge_is_accepted() -> None:
    drive = moteus()
    drive.happen("mode", 10)
    drive.run(drive.ticks + 3000)
    drive.happen("expire", 0.0)
    drive.run(drive.ticks + 30)
    assert find_moteus(drive, bridged_rig()).id == 1


@pytest.mark.parametrize(
    "texts", [{"hold": "aux3.1"}, {"stop": "pin 2"}, {"hold": "aux1.1", "stop": "aux2.1"}]
)
def test_a_switch_is_a_pin_of_one_port(texts: dict[str, str]) -> None:
    with pytest.raises(errors.ConfigError):
        switches_of(texts)


def test_its_limits_are_those_of_the_device() -> None:
    """A window, speed or effort beyond the drive's limits is refused when the host configures it."""
    limits = {"servopos.position_min": "-0.25", "servopos.position_max": "0.5", "servo.max_velocity": "2"}
    world = Bridged(settings={**limits, "servo.max_current_A": "4"})
    host = Host(world)
    ranges = {info.name: (info.minimum, info.maximum) for info in host.identify().parameters}
    assert ranges["window_minimum"] == (-TURN // 4, TURN // 2)
    assert ranges["speed_limit"] == (0, 2 * TURN)
    assert ranges["current_limit"] == (0, 4000)
    ack = host.configure(**{**RUN_PARAMETERS, "speed_limit": 2 * TURN, "window_minimum": -TURN})
    assert ack.status == Status.OUT_OF_RANGE
    assert ack.detail == BY_NAME["window_minimum"].id


def test_a_transmission_between_output_and_handle_is_part_of_the_torque() -> None:
    """An encoder on the rotor behind the drive's gear of 2:1 gives the same rig, with half of the ratio inside."""
    drive = moteus(motor_position__rotor_to_output_ratio="0.5")
    within = fit(find(MoteusConversation(MemoryBus(drive), 1), 1), bridged_rig())
    assert within.counts_per_turn == 2 * TURN
    assert within.transmission == pytest.approx(1.0)
