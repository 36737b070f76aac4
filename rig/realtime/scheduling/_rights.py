"""Rights of this process to real-time scheduling: user, groups, limits and capabilities.

Refusals and `rig.doctor` report them. It only reads: it must not change a right.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from rig.realtime.scheduling.facts import ROOT, text_of

if sys.platform == "linux":
    import grp
    import pwd
    import resource

CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23  # linux/capability.h


@dataclass(frozen=True, slots=True, kw_only=True)
class Rights:
    """Rights of this process to scheduling and locked memory; a limit of None means no limit."""

    user: str
    groups: frozenset[str]
    priority_limit: int | None  # RLIMIT_RTPRIO
    locked_limit: int | None  # RLIMIT_MEMLOCK, bytes
    capabilities: int = 0  # effective, one bit each

    if sys.platform == "linux":

        @classmethod
        def here(cls, root: Path = ROOT) -> Rights:
            """Return the present rights of this process; `root` is the directory that contains proc."""
            return cls(
                user=_name_of_user(os.geteuid()),
                groups=frozenset(name_of_group(number) for number in {*os.getgroups(), os.getegid()}),
                priority_limit=_limit(resource.RLIMIT_RTPRIO),
                locked_limit=_limit(resource.RLIMIT_MEMLOCK),
                capabilities=_capabilities(root),
            )

    def may_schedule(self, priority: int) -> bool:
        """Return True if limits or capabilities allow SCHED_FIFO at `priority`; a control group may still refuse it."""
        allowed = self.priority_limit is None or self.priority_limit >= priority
        return allowed or self.has(CAP_SYS_NICE)

    def may_lock(self, size: int) -> bool:
        """Return True if this process's limits or capabilities allow to lock `size` bytes of memory."""
        return self.locked_limit is None or self.locked_limit >= size or self.has(CAP_IPC_LOCK)

    def has(self, capability: int) -> bool:
        """Return True if a Linux capability, given by its number in linux/capability.h, is active in this process."""
        return bool(self.capabilities >> capability & 1)


def _capabilities(root: Path) -> int:
    match = re.search(r"^CapEff:\s*([0-9a-fA-F]+)", text_of(root / "proc/self/status"), re.MULTILINE)
    return int(match[1], 16) if match else 0


if sys.platform == "linux":

    def _limit(which: int) -> int | None:
        soft, _ = resource.getrlimit(which)
        return None if soft == resource.RLIM_INFINITY else soft

    def _name_of_user(number: int) -> str:
        try:
            return pwd.getpwuid(number).pw_name
        except KeyError:
            return str(number)

    def name_of_group(number: int) -> str:
        """Return the name of the user group with this number; the number as a text if the group has no name."""
        try:
            return grp.getgrgid(number).gr_name
        except KeyError:
            return str(number)
