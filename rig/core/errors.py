"""What can go wrong, named by what the caller does next.

Every error says what happened, and `remedy` what to do about it; commands print both on one line and exit
with `exit_code`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


class RigError(Exception):
    """Root of all errors that a user can meet.

    `recording` is the file that a run left before it failed, `messages` what that run was not granted, each with its
    remedy: often the cause.
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


class ConfigError(RigError):
    """A file, key or value that cannot be meant: mend the file and start again."""

    exit_code = 2


class PlanError(ConfigError):
    """An experiment that is well formed but must not run: a limit, a rate or a wall out of reach."""


class DeviceNotFoundError(RigError):
    """No such port or backend, or it is busy: plug it in, free it, or name another."""

    exit_code = 3


class IncompatibleDeviceError(RigError):
    """The far end speaks another protocol or lacks a capability: flash it, or change this package."""

    exit_code = 4


class DeviceRefusedError(RigError):
    """The device answered a request with a refusal; `status` is its code (`firmware_protocol.faults.Status`)."""

    exit_code = 5

    def __init__(self, message: str, *, remedy: str = "", status: int = 0) -> None:
        super().__init__(message, remedy=remedy)
        self.status = status


class LinkLostError(RigError):
    """The far end fell silent or vanished. Its own watchdog has taken the effort to zero.

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
    """The device halted its endpoint: it refuses to go on until somebody opens it anew."""


class BlockedError(LinkLostError):
    """The line is there, but takes no more bytes."""


class OverflowedError(LinkLostError):
    """More bytes came at once than had been asked for, or than there was room for."""


class CutShortError(LinkLostError):
    """The device took only a part of what was sent."""


class BrokenLineError(LinkLostError):
    """Bits are damaged on the way: the line itself reports errors."""


class DeviceFaultError(LinkLostError):
    """The device latched a fault and cut the effort; `statistics` and `rows` as in `LinkLostError`."""

    exit_code = 7


class GuardError(RigError):
    """The handle left its window or went too fast, or the start was not reached; the effort went to zero first."""

    exit_code = 10


class LawError(RigError):
    """An estimator or a law raised, or gave a value that is not finite; the effort went to zero first."""

    exit_code = 8


class RecordingError(RigError):
    """A recording that cannot be written or read; what was written before stays on disk."""

    exit_code = 9


class RealtimeError(RigError):
    """Scheduling that ``host.realtime = "enforce"`` demands and this machine does not grant; nothing has moved."""

    exit_code = 13


class OverrunError(RigError):
    """The loop came more than one period late, and was told to end then; the effort went to zero first."""

    exit_code = 14


class ToolchainError(RigError):
    """There is no usable cross compiler, or it refuses the firmware: install it, or report what it said."""

    exit_code = 15


class StoppedError(RigError):
    """A person stopped the run; the effort is zero and the recording closed.

    `signal` is the number of the signal that did it; None for `rig stop`, or a program that fell silent.
    """

    exit_code = 130
    signal: int | None = None
