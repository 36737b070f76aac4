"""Faults, limits, refusals and inputs: each code once, with its text and its remedy.

The codes are part of the wire and never reused. The device's dictionary carries the texts, so that a host can
explain a code that is younger than itself.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag


class Described(IntEnum):
    """A code with its meaning (`text`) and what to do about it (`remedy`)."""

    text: str
    remedy: str

    def __new__(cls, code: int, text: str = "", remedy: str = "") -> Described:
        """Make a member of which `code` is the value."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        member.remedy = remedy
        return member


class DescribedFlag(IntFlag):
    """A bit with its meaning (`text`) and what to do about it (`remedy`); for a sum of bits see `texts`."""

    text: str
    remedy: str

    def __new__(cls, code: int, text: str = "", remedy: str = "") -> DescribedFlag:
        """Make a member of which `code` is the value."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        member.remedy = remedy
        return member

    def texts(self) -> list[str]:
        """Return the meaning of each set bit; bits that this version does not know are skipped."""
        return [bit.text for bit in type(self) if bit in self]


class Fault(Described):
    """Why the device latched FAULT. The first one is kept; later ones set bit ``1 << code`` of a mask."""

    NONE = 0, "no fault", ""
    LINK_LOST = (
        1,
        "the host fell silent: no valid command within its lifetime, the effort was ramped to zero",
        "look for a busy host, a cable, a hub that delays, or a lower rate; then clear the fault",
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
        "the law on the device gave a value that is not finite",
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
        "lower position_rate, or take a law in integers (estimator fdm-butterworth-fixed), which is faster than "
        "float32 on a board without floating point; behind a bridge to a drive, close other programs; then "
        "clear the fault",
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
        "large effort with motion along it, or no encoder edge where motion must be",
        "check the signs of motor and encoder and the encoder cable, verify again; then clear the fault",
    )
    WATCHDOG_RESET = (
        11,
        "the device's hardware watchdog reset it",
        "configure, home and verify again; report it",
    )
    INTERNAL = (
        12,
        "the device found itself inconsistent, or its main loop stood still for 20 ms",
        "restart the device; report it with its fault log",
    )
    BATCH_OVERFLOW = (
        13,
        "a count difference did not fit its batch layout",
        "choose a wider layout or a higher rate; then clear the fault",
    )
    CURRENT_MISMATCH = (
        14,
        "the measured current is not the one that was set",
        "check, in this order, rig.amplifier.set_point_delay_s and lag_s against the amplifier, current_quantum_a "
        "against the steps of its set-point, motor leads, supply, and the current sensor with its sign and scale; "
        "then clear the fault",
    )
    PROCESSOR_STOPPED = (
        15,
        "the processor met an instruction or an address that it cannot use, and was reset",
        "configure, home and verify again; report it with the place that rig firmware selftest shows",
    )
    OUTPUT_STALLED = (
        16,
        "a set-point did not leave the board: its transfer to the converter stalled",
        "configure, home and verify again; report it if it comes back",
    )


# Faults that a port finds by itself and explains in its dictionary, such as those of a drive behind a bridge. Beyond 31
# there is no bit for one that comes later.
PORT_FAULTS = range(20, 32)

# Names of faults that a moment without processor or link makes: another time the same run may end as usual. The last
# is a port's own: what is behind it did not answer.
OUT_OF_TIME = frozenset({Fault.TICK_OVERRUN.name, Fault.LINK_LOST.name, "DRIVE_SILENT"})


class LimitFlag(DescribedFlag):
    """Limits that changed the effort of a tick. Not faults: the device continues."""

    CURRENT = 1, "current clipped to current_limit", "ask for less effort"
    SLEW = 2, "change of current clipped to slew_limit", "a trial with this flag is invalid; raise slew_limit"
    SPEED = 4, "speed within 10 % of speed_limit", "lower the effort or raise the limit"
    POSITION = 8, "position within 5 % of the edge of its window", "check the wall position and the window"
    THERMAL = 16, "current reduced to continuous_current by the thermal model", "let the motor cool"
    RAMPING = (
        32,
        "link silence: the effort is being ramped to zero",
        "LINK_LOST follows unless the host returns",
    )
    HOLD_TO_RUN_RELEASED = 64, "hold-to-run is required and not held: effort zero", "hold the switch"
    NOT_CONFIRMED = (
        128,
        "position not confirmed: the count stayed on two neighbours for longer than confirm_ms under effort, which "
        "fades out",
        "leave the wall; if it does not come back, check the encoder and its cable",
    )
    MISSED_TICKS = (
        256,
        "more than ten ticks missed within a second",
        "lower position_rate, or find what keeps the board's processor",
    )
    COMMAND_TOO_OLD = (
        512,
        "a command came that was older than its lifetime: it was not activated",
        "LINK_LOST follows unless younger ones come; look for a hub or a cable that delays (rig doctor)",
    )


class Status(Described):
    """How a transaction ended: the status of an ACK."""

    OK = 0, "done", ""
    UNSUPPORTED = 1, "this device does not know the request", "use a newer firmware, or do without"
    BAD_STATE = (
        2,
        "the request is not allowed in the device's state (detail)",
        "bring it into another state first",
    )
    UNKNOWN_PARAMETER = 3, "no parameter has this id (detail)", "compare with the device's dictionary"
    OUT_OF_RANGE = (
        4,
        "the value of a parameter (detail) is outside its range",
        "see its range in the dictionary; rig.limits, controller.position_rate and homing give most of them",
    )
    BAD_LENGTH = 5, "the request or the block has an impossible length", "resend; report it if it persists"
    BAD_CRC = 6, "the assembled block does not have the announced CRC", "send the block again from BEGIN"
    HASH_MISMATCH = (
        7,
        "dictionary hash or parameter CRC differ from the device's",
        "read them again, then arm",
    )
    STALE_SESSION = 8, "session 0, or the session used last", "arm with another session number"
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
    BAD_ORDER = 13, "parameters must rise by id, each at most once (detail)", "sort the block"
    FAULT_PRESENT = (
        14,
        "the cause of a fault is still there (detail: fault)",
        "remove the cause, then try again",
    )
    INCONSISTENT = (
        15,
        "parameters that contradict each other (detail)",
        "see the rule in the parameter's meaning",
    )
    NOT_LIVE = (
        16,
        "this parameter (detail) does not change while the device is armed",
        "disarm first, or send live parameters alone",
    )
    INSIDE_WALL = (
        17,
        "the handle is inside the wall that is, or inside the one that would be",
        "send it again when the handle is in free space",
    )
    NOT_READY = (
        18,
        "the device is not ready: it works out an excitation, or its amplifier is being switched on",
        "arm a little later",
    )


class Input(DescribedFlag):
    """Pins as STATE reports them; 1 means active. The two of the sync outputs are the device's own."""

    EMERGENCY_STOP = 1, "the wired emergency stop is pressed", "release it when the rig is safe"
    HOLD_TO_RUN = 2, "the hold-to-run switch is held", ""
    SYNC = 4, "the sync input is high", ""
    SYNC_TRIAL = 8, "the sync output of the trial was high up to the sample", ""
    SYNC_INSIDE = 16, "the sync output of the wall was high up to the sample", ""
    LIMIT_SWITCH = (
        32,
        "the limit switch is pressed, or its wire is broken",
        "move the handle back into its travel; if that changes nothing, mend the wire",
    )
