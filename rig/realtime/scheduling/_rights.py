"""Rights of this process to real-time scheduling: user, groups, limits and capabilities."""

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
    """Rights of this process. A limit of None means no limit; `groups` are those now active, without later changes."""

    user: str
    groups: frozenset[str]
    priority_limit: int | None  # RLIMIT_RTPRIO
    locked_limit: int | None  # RLIMIT_MEMLOCK, bytes
    capabilities: int = 0  # effective, one bit each

    if sys.platform == "linux":

        @classmethod
        def here(cls, root: Path = ROOT) -> Rights:
            """Return the present rights of this process."""
            return cls(
                user=_name_of_user(os.geteuid()),
                groups=frozenset(name_of_group(number) for number in {*os.getgroups(), os.getegid()}),
                priority_limit=_limit(resource.RLIMIT_RTPRIO),
                locked_limit=_limit(resource.RLIMIT_MEMLOCK),
                capabilities=_capabilities(root),
            )

    def may_schedule(self, priority: int) -> bool:
        """Return True if limits allow SCHED_FIFO at this priority; a control group or container may still refuse it."""
        allowed = self.priority_limit is None or self.priority_limit >= priority
        return allowed or self.has(CAP_SYS_NICE)

    def may_lock(self, size: int) -> bool:
        """Return True if the limits allow to lock `size` bytes of memory."""
        return self.locked_limit is None or self.locked_limit >= size or self.has(CAP_IPC_LOCK)

    def has(self, capability: int) -> bool:
        """Return True if a capability is active in this process."""
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
        """Return the name of a group, or its number as a text if it has no name."""
        try:
            return grp.getgrgid(number).gr_name
        except KeyError:
            return str(number)
