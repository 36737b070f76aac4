"""Faults that a bridge to a drive reports: their codes, meanings and remedies.

The codes are those of `enum bridge_fault` in ``firmware/bridge/drive.h``; the bridge (firmware on this computer in
front of a drive) describes them to the host in its dictionary. The texts of a moteus are those of its register 0x00f
(mjbots/moteus, docs/protocol/registers.md); an ODrive's errors have the names of the maker's description of the
messages (DBC of 0.6.10).
"""

from enum import IntEnum

from firmware_protocol.dictionary import CodeInfo

AGAIN = "then clear the fault"


class DriveFault(IntEnum):
    """Fault codes of a bridge (firmware in front of a drive), numbered after the codes of the firmware."""

    DRIVE_SILENT = 20
    OTHER_MASTER = 21
    DRIVE_LEFT = 22
    OVER_VOLTAGE = 23
    UNDER_VOLTAGE = 24
    DRIVER = 25
    TEMPERATURE = 26
    NOT_CALIBRATED = 27
    OUTSIDE_LIMIT = 28
    CONTROL_ERROR = 29
    DRIVE_INTERNAL = 30
    BUS_LOST = 31


MOTEUS = {
    DriveFault.DRIVE_SILENT: (
        "no reply from the drive for four periods, or for 20 ms",
        f"check its power, the bus and its termination, and that this computer is not too busy; {AGAIN}",
    ),
    DriveFault.OTHER_MASTER: (
        "another program sends commands or requests to the drive: a second bus master",
        f"close tview, moteus_tool and other programs on this bus; {AGAIN}",
    ),
    DriveFault.DRIVE_LEFT: (
        "the drive left the commanded mode: its watchdog expired, its power failed, or another program stopped it",
        f"look for a busy computer, a loose supply or a second program on the bus; {AGAIN}",
    ),
    DriveFault.OVER_VOLTAGE: (
        "the drive stopped with its fault 34, over voltage: the bus voltage exceeded servo.max_voltage",
        f"use a supply that absorbs regenerated energy, or set up flux braking; {AGAIN}",
    ),
    DriveFault.UNDER_VOLTAGE: (
        "the drive stopped with its fault 40, under voltage: the voltage was too low",
        f"check its supply; {AGAIN}",
    ),
    DriveFault.DRIVER: (
        "the drive stopped with its fault 33 or 44, motor driver: most often the supply could not give the current",
        f"check supply and motor leads; {AGAIN}",
    ),
    DriveFault.TEMPERATURE: (
        "the drive stopped with its fault 38, over temperature: the maximum configured temperature was exceeded",
        f"let it cool; {AGAIN}",
    ),
    DriveFault.NOT_CALIBRATED: (
        "the drive stopped with its fault 36 or 32, motor not configured or calibration fault",
        f"run moteus_tool --calibrate with the motor free; {AGAIN}",
    ),
    DriveFault.OUTSIDE_LIMIT: (
        "the drive stopped with its fault 39 or 48, outside limit: servopos.position_min and position_max forbid this "
        "position",
        f"move the handle back, or change these limits; {AGAIN}",
    ),
    DriveFault.CONTROL_ERROR: (
        "the drive stopped with its fault 49 or 50, control error: servo.fault_position_error or fault_velocity_error",
        f"set both to nan; {AGAIN}",
    ),
    DriveFault.DRIVE_INTERNAL: (
        "the drive stopped with an internal fault",
        f"read register 0x00f with moteus_tool; {AGAIN}",
    ),
    DriveFault.BUS_LOST: (
        "the CAN adapter is disconnected, or bus-off after too many errors",
        "plug it in, check bit rate, wiring and termination, and start again",
    ),
}


ODRIVE = {
    DriveFault.DRIVE_SILENT: (
        "no position or no torque from the drive for four periods or 20 ms, or no heartbeat for five heartbeat periods",
        f"check its power, the bus and its termination, and that this computer is not too busy; {AGAIN}",
    ),
    DriveFault.OTHER_MASTER: (
        "another program sends commands to the drive on this bus: a second bus master",
        f"end that program; {AGAIN}",
    ),
    DriveFault.DRIVE_LEFT: (
        "the drive left closed loop, or applies a torque that was not commanded: its watchdog expired "
        "(WATCHDOG_TIMER_EXPIRED), its power failed, or another program stopped or commands it (possibly over USB)",
        f"look for a busy computer, a loose supply, odrivetool or a second program on the bus; {AGAIN}",
    ),
    DriveFault.OVER_VOLTAGE: (
        "the drive stopped with DC_BUS_OVER_VOLTAGE or BRAKE_RESISTOR_DISARMED",
        f"use a supply that absorbs regenerated energy, or a brake resistor; {AGAIN}",
    ),
    DriveFault.UNDER_VOLTAGE: (
        "the drive stopped with DC_BUS_UNDER_VOLTAGE: the voltage was too low",
        f"check its supply; {AGAIN}",
    ),
    DriveFault.DRIVER: (
        "the drive stopped with DRV_FAULT, DC_BUS_OVER_CURRENT, DC_BUS_OVER_REGEN_CURRENT or CURRENT_LIMIT_VIOLATION",
        f"check supply, its limits and motor leads; {AGAIN}",
    ),
    DriveFault.TEMPERATURE: (
        "the drive stopped with INVERTER_OVER_TEMP, MOTOR_OVER_TEMP or THERMISTOR_DISCONNECTED",
        f"let it cool; {AGAIN}",
    ),
    DriveFault.NOT_CALIBRATED: (
        "the drive is not calibrated, or its configuration is not valid (BAD_CONFIG, CALIBRATION_ERROR)",
        f"run its calibration with the motor free; {AGAIN}",
    ),
    DriveFault.OUTSIDE_LIMIT: (
        "the drive stopped with VELOCITY_LIMIT_VIOLATION or POSITION_LIMIT_VIOLATION",
        f"move the handle more slowly, or raise axis0.controller.config.vel_limit; {AGAIN}",
    ),
    DriveFault.CONTROL_ERROR: (
        "the drive stopped with TIMING_ERROR or MISSING_INPUT",
        f"update the drive's firmware, and disable its other features; {AGAIN}",
    ),
    DriveFault.DRIVE_INTERNAL: (
        "the drive stopped with another error",
        f"read it with odrivetool: dump_errors(odrv0); {AGAIN}",
    ),
    DriveFault.BUS_LOST: (
        "the CAN interface is disconnected, or bus-off after too many errors",
        "plug it in, check bit rate, wiring and termination, and start again",
    ),
}
TEXTS = {"moteus": MOTEUS, "odrive": ODRIVE}


def explain_faults(kind: str) -> tuple[CodeInfo, ...]:
    """Return code, name, meaning and remedy of each fault, for a kind of drive ("moteus" or "odrive")."""
    return tuple(CodeInfo(int(code), code.name, text, remedy) for code, (text, remedy) in TEXTS[kind].items())
