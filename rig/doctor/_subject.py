"""The computer that the checks examine, as an object that a test replaces by a made-up file tree."""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from rig.config import Host
from rig.core.check import Check, Outcome
from rig.realtime.scheduling import RealtimeRequest, Rights
from rig.realtime.scheduling.facts import ROOT

if sys.platform == "linux":
    from rig.realtime.scheduling import tried

# `rig.doctor.interface` imports this file on Linux only; elsewhere mypy skips it from here on.
assert sys.platform == "linux"


def openable(path: Path) -> bool:
    """Return True if this process may read and write the device file `path`."""
    return os.access(path, os.R_OK | os.W_OK)


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A computer to examine: its directory tree (`root`), the rights of this process, and the requested scheduling."""

    request: RealtimeRequest = field(default_factory=Host)
    root: Path = ROOT  # where /proc, /sys, /dev and /etc are
    rights: Rights = field(default_factory=Rights.here)
    openable: Callable[[Path], bool] = openable
    tried: Callable[[int, int | None], tuple[object, list[Check]]] = tried  # with a priority and a processor

    def judged(self, refusal: Check) -> Check:
        """Return a refused check unchanged if the experiment requires real-time scheduling, otherwise as a warning."""
        demanded = self.request.realtime == "enforce"
        return refusal if demanded else replace(refusal, outcome=Outcome.WARNING)
