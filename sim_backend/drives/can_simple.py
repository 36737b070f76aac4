"""Define the messages of ODrive's protocol CAN Simple (firmware 0.6) and the layout of their fields (little-endian).

Source: docs.odriverobotics.com, manual/can-protocol, read in part; the fields are those of the maker's library for
Arduino (odriverobotics/ODriveArduino at f52eef5, src/can_simple_messages.hpp). `odrive` and `odrive_law` use it. The
numbers are the maker's and must not change.
"""

import struct
from enum import IntEnum

# An identifier is ``node << 5 | command``.
COMMAND_BITS = 5


class CanSimpleCommand(IntEnum):
    """Command of a CAN Simple message: the lower five bits of its CAN identifier."""

    GET_VERSION = 0x00
    HEARTBEAT = 0x01
    ESTOP = 0x02
    GET_ERROR = 0x03
    RX_SDO = 0x04
    TX_SDO = 0x05
    ADDRESS = 0x06
    SET_AXIS_STATE = 0x07
    GET_ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_POS = 0x0C
    SET_INPUT_VEL = 0x0D
    SET_INPUT_TORQUE = 0x0E
    SET_LIMITS = 0x0F
    SET_TRAJ_VEL_LIMIT = 0x11
    SET_TRAJ_ACCEL_LIMITS = 0x12
    SET_TRAJ_INERTIA = 0x13
    GET_IQ = 0x14
    GET_TEMPERATURE = 0x15
    REBOOT = 0x16
    GET_BUS_VOLTAGE_CURRENT = 0x17
    CLEAR_ERRORS = 0x18
    SET_ABSOLUTE_POSITION = 0x19
    SET_POS_GAIN = 0x1A
    SET_VEL_GAINS = 0x1B
    GET_TORQUES = 0x1C
    GET_POWERS = 0x1D


class AxisState(IntEnum):
    """State of an ODrive's axis (only the simulated states); numbers of ODriveArduino, src/ODriveEnums.h."""

    UNDEFINED = 0
    IDLE = 1
    CLOSED_LOOP_CONTROL = 8


class Error(IntEnum):
    """Error bit of an ODrive, for active errors and for the disarm reason; ODriveArduino, src/ODriveEnums.h."""

    INITIALIZING = 0x00000001
    MISSING_ESTIMATE = 0x00000008
    DRV_FAULT = 0x00000020
    DC_BUS_OVER_VOLTAGE = 0x00000100
    DC_BUS_UNDER_VOLTAGE = 0x00000200
    INVERTER_OVER_TEMP = 0x00004000
    VELOCITY_LIMIT_VIOLATION = 0x00008000
    WATCHDOG_TIMER_EXPIRED = 0x01000000
    ESTOP_REQUESTED = 0x02000000


class Result(IntEnum):
    """Result of the host's last request for an axis state; ODriveArduino, src/ODriveEnums.h."""

    SUCCESS = 0
    DISARMED = 3
    INVALID_STATE = 13


FORMS = {
    CanSimpleCommand.SET_AXIS_STATE: struct.Struct("<I"),
    CanSimpleCommand.SET_CONTROLLER_MODE: struct.Struct("<II"),
    CanSimpleCommand.SET_INPUT_POS: struct.Struct("<fhh"),
    CanSimpleCommand.SET_INPUT_VEL: struct.Struct("<ff"),
    CanSimpleCommand.SET_INPUT_TORQUE: struct.Struct("<f"),
    CanSimpleCommand.SET_LIMITS: struct.Struct("<ff"),
    CanSimpleCommand.SET_TRAJ_INERTIA: struct.Struct("<f"),
    CanSimpleCommand.REBOOT: struct.Struct("<B"),
    CanSimpleCommand.SET_ABSOLUTE_POSITION: struct.Struct("<f"),
    CanSimpleCommand.SET_POS_GAIN: struct.Struct("<f"),
    CanSimpleCommand.SET_VEL_GAINS: struct.Struct("<ff"),
}
FEED_FORWARD_STEP = 0.001  # of Vel_FF (rev/s) and Torque_FF (N·m)
ERRORS, FLOATS = struct.Struct("<II"), struct.Struct("<ff")
HEARTBEAT = struct.Struct("<IBBBx")  # error, state, result, trajectory done
SDO = struct.Struct("<BHB")  # opcode, endpoint, reserved; then a value
ADDRESS = struct.Struct("<B6sB")
READ, WRITE = 0, 1  # opcodes: odriverobotics/ODriveResources, examples/can_param_access.py
