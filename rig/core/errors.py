"""Errors of the package; each class corresponds to one reaction of the user, and most have their own exit code.

An error has a message (what is wrong) and a remedy (what to do about it); commands print both on one line and exit with
`exit_code`.

Every package raises them, and commands and pages show them. This file must not import another module of the package, so
that any module can import it.
"""

from pathlib import Path
from typing import Any


class RigError(Exception):
    """Base class of all errors that a user can see.

    `recording` is the file of a failed run, or None; `messages` are the warnings of that run with remedies, which often
    name the cause.
    """

    exit_code = 1
    reported = False  # whether a command has already put it into its JSON

    def __init__(self, message: str, *, remedy: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy
        self.recording: Path | None = None
        self.messages: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}" if self.remedy else self.message

    def as_mapping(self) -> dict[str, Any]:
        """Return message, error class, remedy, recording, warnings and exit code as JSON types."""
        return {
            "error": self.message,
            "kind": type(self).__name__,
            "remedy": self.remedy,
            "recording": None if self.recording is None else str(self.recording),
            "messages": list(self.messages),
            "exit_code": self.exit_code,
        }


class ConfigError(RigError):
    """A file, key or value is invalid: correct it and start again."""

    exit_code = 2


class PlanError(ConfigError):
    """An experiment is valid but must not run, because a limit, a rate or a wall cannot be realised."""


class DeviceNotFoundError(RigError):
    """A port or backend does not exist, or is in use: plug the device in, free the port, or name another port."""

    exit_code = 3


class IncompatibleDeviceError(RigError):
    """The device has another protocol version or lacks a capability: flash it, or install another haptic-rig."""

    exit_code = 4


class DeviceRefusedError(RigError):
    """The device refused a request; `status` is its reason (`firmware_protocol.faults.Status`), 0 without a reason."""

    exit_code = 5

    def __init__(self, message: str, *, remedy: str = "", status: int = 0) -> None:
        super().__init__(message, remedy=remedy)
        self.status = status


class LinkLostError(RigError):
    """The device does not reply any more or is unplugged; its own watchdog has set the effort to zero.

    `statistics` holds the counters of the link, `rows` the recorded samples before the loss (`rig.core.sample.ROW`) or
    None.
    """

    exit_code = 6

    def __init__(self, message: str, *, remedy: str = "", statistics: Any = None, rows: Any = None) -> None:
        super().__init__(message, remedy=remedy)
        self.statistics = statistics
        self.rows = rows


class UnpluggedError(LinkLostError):
    """The device has disappeared from the USB bus, or the system has closed its serial port."""


class StalledError(LinkLostError):
    """The device has halted (stalled) its USB endpoint, until the device is opened again."""


class BlockedError(LinkLostError):
    """The link to the device is up but accepts no more bytes."""


class OverflowedError(LinkLostError):
    """The device sent more bytes at once than were requested or than the buffer could take."""


class CutShortError(LinkLostError):
    """The device accepted only a part of the bytes that were sent."""


class BrokenLineError(LinkLostError):
    """The link reports corrupted bits, for example parity or framing errors."""


class DeviceFaultError(LinkLostError):
    """The device detected a fault and set the effort to zero until it is armed again.

    `statistics` holds the counters of the link, `rows` the recorded samples before the fault or None.
    """

    exit_code = 7


class GuardError(RigError):
    """The run ended because a limit of position, speed, energy or homing time was exceeded; the effort is zero."""

    exit_code = 10


class LawError(RigError):
    """An estimator or a law raised, or returned a value that is not finite; the effort was set to zero first."""

    exit_code = 8


class RecordingError(RigError):
    """A recording cannot be written or read; rows that were written before remain on disk."""

    exit_code = 9


class RealtimeError(RigError):
    """The system does not grant the scheduling that ``host.realtime = "enforce"`` requires; nothing has moved."""

    exit_code = 13


class OverrunError(RigError):
    """A tick was more than one period late with ``host.overrun = "stop"``; the effort was set to zero first."""

    exit_code = 14


class ToolchainError(RigError):
    """The cross compiler is missing or rejects the firmware: install it, or report its output."""

    exit_code = 15


class RunEndedError(RigError):
    """A change of the wall came too late and has no effect, because the run has ended."""

    exit_code = 16


class UnexpectedVerdictError(RigError):
    """The judgement of a trial (stable, unstable, …) is not one that the user expects; the recording is valid."""

    exit_code = 17


class NoStableWallError(RigError):
    """The design found no sampling rates and estimator that render the wall's damping in a stable way."""

    exit_code = 18


class StoppedError(RigError):
    """A person stopped the run; the effort is zero and the recording is closed.

    `signal` is the number of the signal that stopped the run; None after `rig stop`, `rig.stop` or a missing heartbeat.
    """

    exit_code = 130
    signal: int | None = None
