"""What the checks of a machine look at; all of it can be replaced, so that they run on trees made up for a test."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from rig.bench.doctor.finding import Finding, Outcome
from rig.config.sections import Host
from rig.realtime.scheduling import Refusal, Request, Rights
from rig.realtime.scheduling.facts import ROOT
from rig.realtime.scheduling.thread import tried


def openable(path: Path) -> bool:
    """Whether this process may read and write a device, by owner, group or access list."""
    return os.access(path, os.R_OK | os.W_OK)


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A machine as this process sees it, and what an experiment asks of it (``experiment.host``)."""

    request: Request = field(default_factory=Host)
    root: Path = ROOT  # where /proc, /sys, /dev and /etc hang
    rights: Rights = field(default_factory=Rights.here)
    openable: Callable[[Path], bool] = openable
    tried: Callable[[int, int | None], tuple[object, list[Refusal]]] = (
        tried  # with a priority and a processor
    )

    @property
    def severity(self) -> Outcome:
        """How bad it is when scheduling is refused: the run does not start, or runs less well."""
        return Outcome.PROBLEM if self.request.realtime == "enforce" else Outcome.WARNING

    def refused(self, name: str, refusal: Refusal, why: str, outcome: Outcome | None = None) -> Finding:
        """Make a finding of what the kernel refuses."""
        text = (
            f"{refusal.text} (after the command: {refusal.afterwards})"
            if refusal.afterwards
            else refusal.text
        )
        return Finding(
            name=name, outcome=outcome or self.severity, text=text, why=why, command=refusal.command
        )


def ok(name: str, text: str, why: str) -> Finding:
    """Nothing to mend."""
    return Finding(name=name, outcome=Outcome.OK, text=text, why=why)


def warning(name: str, text: str, why: str, command: str = "") -> Finding:
    """Something that may be mended."""
    return Finding(name=name, outcome=Outcome.WARNING, text=text, why=why, command=command)


def problem(name: str, text: str, why: str, command: str = "") -> Finding:
    """Something that must be mended."""
    return Finding(name=name, outcome=Outcome.PROBLEM, text=text, why=why, command=command)
