"""Errors of the package, named after what the caller does next.

An error has a message (what is wrong) and a remedy (what to do about it); commands print both on one line and exit
with `exit_code`.

Every room raises them, and commands and pages show them. This file must not import another module of the package, so
that any module can import it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


class RigError(Exception):
    """Root of all errors that a user can see.

    `recording` is the file that a failed run left, `messages` the warnings of that run, each with its remedy: often the
    cause.
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
        """Return message, kind, remedy and recording as plain values, for JSON."""
        return {
            "error": self.message,
            "kind": type(self).__name__,
            "remedy": self.remedy,
            "recording": None if self.recording is None else str(self.recording),
            "messages": list(self.messages),
            "exit_code": self.exit_code,
        }


class ConfigError(RigError):
    """An invalid file, key or value: correct it and start again."""

    exit_code = 2


class PlanError(ConfigError):
    """A valid experiment that must not run: a limit, a rate or a wall is out of reach."""


class DeviceNotFoundError(RigError):
    """No such port or backend, or it is busy: plug it in, free it, or name another."""

    exit_code = 3


class IncompatibleDeviceError(RigError):
    """The device speaks another protocol version or lacks a capability: flash it, or change this package."""

    exit_code = 4


class DeviceRefusedError(RigError):
    """The device answered a request with a refusal; `status` is its code (`firmware_protocol.faults.Status`)."""

    exit_code = 5

    def __init__(self, message: str, *, remedy: str = "", status: int = 0) -> None:
        super().__init__(message, remedy=remedy)
        self.status = status


class LinkLostError(RigError):
    """The device stopped answering or vanished. Its own watchdog has set the effort to zero.

    `statistics` holds the counters of the link, `rows` the last rows of the loop (`rig.core.sample.ROW`) or None.
    """

    exit_code = 6

    def __init__(self, message: str, *, remedy: str = "", statistics: Any = None, rows: Any = None) -> None:
        super().__init__(message, remedy=remedy)
        self.statistics = statistics
        self.rows = rows


class UnpluggedError(LinkLostError):
    """The device is gone from the bus, or its port hung up."""


class StalledError(LinkLostError):
    """The device halted its endpoint until it is opened again."""


class BlockedError(LinkLostError):
    """The line is up but accepts no more bytes."""


class OverflowedError(LinkLostError):
    """More bytes arrived at once than were requested, or than there was room for."""


class CutShortError(LinkLostError):
    """The device accepted only part of what was sent."""


class BrokenLineError(LinkLostError):
    """Bits are corrupted in transit: the line itself reports errors."""


class DeviceFaultError(LinkLostError):
    """The device latched a fault and cut the effort; `statistics` and `rows` as in `LinkLostError`."""

    exit_code = 7


class GuardError(RigError):
    """The guard ended the run: window, speed, energy or homing; the effort was set to zero first."""

    exit_code = 10


class LawError(RigError):
    """An estimator or a law raised, or returned a value that is not finite; the effort was set to zero first."""

    exit_code = 8


class RecordingError(RigError):
    """A recording that cannot be written or read; what was written before stays on disk."""

    exit_code = 9


class RealtimeError(RigError):
    """Scheduling that ``host.realtime = "enforce"`` requires is not granted by this machine; nothing has moved."""

    exit_code = 13


class OverrunError(RigError):
    """A tick was more than one period late where ``host.overrun`` ends the run; the effort was set to zero first."""

    exit_code = 14


class ToolchainError(RigError):
    """There is no usable cross compiler, or it rejects the firmware: install it, or report its output."""

    exit_code = 15


class RunEndedError(RigError):
    """The run that was to be changed has ended: the change has no effect."""

    exit_code = 16


class UnexpectedVerdictError(RigError):
    """A verdict is not among those that were expected. What was measured is whole: this is for scripts."""

    exit_code = 17


class NoStableWallError(RigError):
    """A design found no scheme that has a stable wall whose damping is rendered; it recommends none."""

    exit_code = 18


class StoppedError(RigError):
    """A person stopped the run; the effort is zero and the recording closed.

    `signal` is the number of the signal that did it; None for `rig stop`, `rig.stop`, a silent program.
    """

    exit_code = 130
    signal: int | None = None
