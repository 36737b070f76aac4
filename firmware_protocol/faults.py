"""List the codes of faults, limits, request statuses and inputs, with text and remedy.

The codes are part of the protocol and are never reused. The device's dictionary contains the texts, so a host can
explain codes of a newer firmware. Device, host and the generated pages use the list. A code must not change its number
or its meaning.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag


class Described(IntEnum):
    """Code with its meaning (`text`) and what to do about it (`remedy`); base of fault codes and request statuses."""

    text: str
    remedy: str

    def __new__(cls, code: int, text: str = "", remedy: str = "") -> Described:
        """Create the member of the enumeration with the value `code`."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        member.remedy = remedy
        return member


class DescribedFlag(IntFlag):
    """Bit of a field with its meaning (`text`) and what to do about it (`remedy`); base of limits and of inputs."""

    text: str
    remedy: str

    def __new__(cls, code: int, text: str = "", remedy: str = "") -> DescribedFlag:
        """Create the member of the enumeration with the value `code`."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        member.remedy = remedy
        return member

    def texts(self) -> list[str]:
        """Return the meaning of each bit that is set in this value; skip bits that this version does not define."""
        return [bit.text for bit in type(self) if bit in self]


class Fault(Described):
    """Code of a fault: the device latches the first; each later one sets bit ``1 << code`` in a FAULT_LOG message."""

    NONE = 0, "no fault", ""
    LINK_LOST = (
        1,
        "no valid command arrived within the lifetime of the last one; the effort was ramped to zero",
        "check the load of the host, the cable, and hubs that delay, or lower the rate; then clear the fault",
    )
    OVER_SPEED = (
        2,
        "speed above speed_limit",
        "check stiffness, damping and the sign of the motor; then clear the fault",
    )
    OVER_CURRENT = (
        3,
        "measured current above the amplifier's limit",
        "check motor wiring and the amplifier; then clear the fault",
    )
    NON_FINITE = (
        4,
        "the law on the device computed a value that is not finite",
        "check the parameters; then clear the fault",
    )
    ENCODER = (
        5,
        "illegal quadrature transition or a broken line: the count can no longer be trusted",
        "check encoder cable and supply, home again; then clear the fault",
    )
    TICK_OVERRUN = (
        6,
        "the device did not finish a tick within its period, or missed two in succession (behind a bridge: four)",
        "lower position_rate, or choose a law in integers (estimator fdm-butterworth-fixed), which "
        "is faster than float32 on a board without floating point; behind a bridge to a drive, close "
        "other programs; then clear the fault",
    )
    EMERGENCY_STOP = (
        7,
        "the emergency stop is pressed",
        "make the rig safe, release the stop, then clear the fault",
    )
    POSITION_WINDOW = (
        8,
        "position left window_minimum … window_maximum",
        "move the handle back, check homing and window; then clear the fault",
    )
    THERMAL = 9, "the motor's thermal model exceeds its budget", "let the motor cool; then clear the fault"
    RUNAWAY = (
        10,
        "large effort with motion in its direction, or no encoder edge although the model predicts motion",
        "check the signs of motor and encoder and the encoder cable, verify again; then clear the fault",
    )
    WATCHDOG_RESET = (
        11,
        "the device's hardware watchdog reset it",
        "configure, home and verify again; report it",
    )
    INTERNAL = (
        12,
        "the device found an inconsistent state, or its main loop hung for 20 ms",
        "restart the device; report it with its fault log",
    )
    BATCH_OVERFLOW = (
        13,
        "a count difference did not fit its batch layout",
        "choose a wider layout or a higher rate; then clear the fault",
    )
    CURRENT_MISMATCH = (
        14,
        "the measured current differs from the set current",
        "check, in this order, rig.amplifier.set_point_delay_s and lag_s against the amplifier, current_quantum_a "
        "against the steps of its set-point, motor leads, supply, and the current sensor with its sign and scale; "
        "then clear the fault",
    )
    PROCESSOR_STOPPED = (
        15,
        "the processor executed an invalid instruction or accessed an invalid address, and was reset",
        "configure, home and verify again; report it with the place that rig firmware selftest shows",
    )
    OUTPUT_STALLED = (
        16,
        "a set-point did not leave the board: its transfer to the converter stalled",
        "configure, home and verify again; report it if it comes back",
    )


# Faults that a port detects and explains in its dictionary, such as those of a drive behind a bridge. The mask of later
# faults has no bit beyond 31.
PORT_FAULTS = range(20, 32)

# Names of faults that a short pause of processor or link causes: repeated, the same run may end as usual. The last is
# a fault of a port: the drive behind it did not reply.
OUT_OF_TIME = frozenset({Fault.TICK_OVERRUN.name, Fault.LINK_LOST.name, "DRIVE_SILENT"})


class LimitFlag(DescribedFlag):
    """Bit of STATE.limits: a limit that changed the effort, or a value near its limit. It is not a fault."""

    CURRENT = 1, "current clipped to current_limit", "command less effort"
    SLEW = 2, "change of current clipped to slew_limit", "a trial with this flag is invalid; raise slew_limit"
    SPEED = 4, "speed within 10 % of speed_limit", "lower the effort or raise the limit"
    POSITION = 8, "position within 5 % of the edge of its window", "check the wall position and the window"
    THERMAL = 16, "current reduced to continuous_current by the thermal model", "let the motor cool"
    RAMPING = (
        32,
        "no commands from the host: the effort is being ramped to zero",
        "restore the link: without commands from the host, LINK_LOST follows",
    )
    HOLD_TO_RUN_RELEASED = (
        64,
        "hold-to-run is required and its switch is not held: the effort is zero",
        "hold the hold-to-run switch",
    )
    NOT_CONFIRMED = (
        128,
        "position not confirmed: the count stayed on two neighbouring values under effort for longer "
        "than confirm_ms; the effort fades out",
        "move the handle out of the wall; if the effort does not return, check the encoder and its cable",
    )
    MISSED_TICKS = (
        256,
        "more than ten ticks missed within a second",
        "lower position_rate, or find what occupies the board's processor",
    )
    COMMAND_TOO_OLD = (
        512,
        "a command was older than its lifetime when it arrived, and was not activated",
        "check for a hub or cable that delays (rig doctor); LINK_LOST follows unless a command "
        "arrives in time",
    )


class Status(Described):
    """Result of a request; the device sends it in the field `status` of an ACK."""

    OK = 0, "done", ""
    UNSUPPORTED = (
        1,
        "the device does not support this request",
        "update the firmware, or do not use this request",
    )
    BAD_STATE = (
        2,
        "the request is not allowed in the state of the device (detail)",
        "bring the device into an allowed state first (states: PROTOCOL.md)",
    )
    UNKNOWN_PARAMETER = (
        3,
        "there is no parameter with this id (detail)",
        "compare with the device's dictionary",
    )
    OUT_OF_RANGE = (
        4,
        "the value of a parameter (detail) is outside its range",
        "see its range in the dictionary; rig.limits, controller.position_rate and homing give most of them",
    )
    BAD_LENGTH = (
        5,
        "the request or the block has a length that is not allowed",
        "resend; report it if it persists",
    )
    BAD_CRC = 6, "the assembled block does not have the announced CRC", "send the block again from BEGIN"
    HASH_MISMATCH = (
        7,
        "dictionary hash or parameter CRC differ from the device's",
        "read them again, then arm",
    )
    STALE_SESSION = (
        8,
        "the session number is 0, or that of the last session",
        "arm with another session number",
    )
    NOT_HOMED = 9, "reference_count was not set since the device started", "home the rig"
    NOT_VERIFIED = (
        10,
        "signs and scale were not verified for this configuration",
        "run the check and set verified",
    )
    FAULT_LATCHED = (
        11,
        "a fault is latched and the request did not clear it",
        "read the fault log, then clear it",
    )
    INCOMPLETE = (
        12,
        "the block has missing bytes, or was never begun",
        "send the missing chunks, or begin again",
    )
    BAD_ORDER = (
        13,
        "parameters must be in ascending order of id, each at most once (detail)",
        "sort the block",
    )
    FAULT_PRESENT = (
        14,
        "the cause of a fault is still there (detail: fault)",
        "remove the cause, then try again",
    )
    INCONSISTENT = (
        15,
        "parameters contradict each other (detail)",
        "see the rule in the parameter's meaning",
    )
    NOT_LIVE = (
        16,
        "this parameter (detail) does not change while the device is armed",
        "disarm first, or send only parameters that may change while armed",
    )
    INSIDE_WALL = (
        17,
        "the handle is inside the present wall or inside the new one",
        "send it again when the handle is in free space",
    )
    NOT_READY = (
        18,
        "the device is not ready: it is computing an excitation, or its amplifier is being switched on",
        "arm a little later",
    )


class Input(DescribedFlag):
    """Bit of the field `inputs` of a STATE message, 1: the pin is active. `SYNC_TRIAL`, `SYNC_INSIDE` are outputs."""

    EMERGENCY_STOP = 1, "the wired emergency stop is pressed", "release it when the rig is safe"
    HOLD_TO_RUN = 2, "the hold-to-run switch is held", ""
    SYNC = 4, "the sync input is high", ""
    SYNC_TRIAL = 8, "the sync output of the trial was high up to the sample", ""
    SYNC_INSIDE = 16, "the sync output of the wall was high up to the sample", ""
    LIMIT_SWITCH = (
        32,
        "the limit switch is pressed, or its wire is broken",
        "move the handle back into its travel; if the switch still shows pressed, repair the wire",
    )
