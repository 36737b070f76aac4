"""Explain why the kernel refused real-time scheduling: failed checks with reason and the command that grants it.

Scheduling and `rig.doctor` report these checks (`rig.core.check`). This file must not run the commands.
"""

import errno
import os
from pathlib import Path

from rig.core.check import Check, Outcome
from rig.realtime.scheduling._rights import Rights
from rig.realtime.scheduling.facts import (
    ROOT,
    idle_driver,
    number_of,
    online_cpus,
    rt_runtime_us,
    status_kilobytes,
    text_of,
)

GROUP = "realtime"
LIMITS_FILE = "/etc/security/limits.d/95-haptic-rig.conf"
LIMITS_COMMAND = (
    f"sudo groupadd -f {GROUP} && sudo usermod -aG {GROUP} $USER && "
    f"printf '@{GROUP} - rtprio 98\\n@{GROUP} - memlock unlimited\\n' | sudo tee {LIMITS_FILE}"
)
RULES_FILE = "/etc/udev/rules.d/70-haptic-rig.rules"
RULES_COMMAND = (
    f"sudo groupadd -f {GROUP} && rig doctor --print-udev | sudo tee {RULES_FILE}"
    " && sudo udevadm control --reload && sudo udevadm trigger"
)
LOG_IN_AGAIN = "run, then log in again: "
# Bytes that a run may still map: at the limit of locked memory the kernel refuses every further allocation.
ROOM = 256 * 2**20
_MIB = 2**20
# Names of the checks, here and in `rig doctor`.
PRIORITY, PROCESSOR = "real-time priority", "processor"
MEMORY, IDLE = "locked memory", "idle processors"


def _refused(name: str, text: str, remedy: str = "") -> Check:
    return Check(name, Outcome.REFUSED, text, remedy)


def of_policy(priority: int, rights: Rights, number: int, root: Path = ROOT) -> Check:
    """Return a failed check that explains why SCHED_FIFO at `priority` (1 to 99) was refused; `number` is the errno."""
    what = f"SCHED_FIFO {priority} is refused"
    if not rights.may_schedule(priority):
        text = f"{what}: the limit of real-time priorities is {rights.priority_limit}"
        return _refused(PRIORITY, text, LOG_IN_AGAIN + LIMITS_COMMAND)
    return group_refusal(priority, root) or _refused(
        PRIORITY,
        f"{what}: {os.strerror(number)}, although the limits allow it; a container or a control group forbids it",
        "run in the shell that starts this program: echo $$ | sudo tee /sys/fs/cgroup/cgroup.procs; "
        "or start its container with --cap-add=SYS_NICE --ulimit rtprio=98",
    )


def group_refusal(priority: int, root: Path = ROOT) -> Check | None:
    """Return a failed check if this process's control group forbids real-time priorities; None if it allows them."""
    group = real_time_group(root)
    if group is None or (rt_runtime_us(root) or 0) < 0:
        return None
    name, share = group
    if number_of(root / share.lstrip("/")) != 0:
        return None
    return _refused(
        PRIORITY,
        f"SCHED_FIFO {priority} is refused: control group {name} may not run real-time tasks (cpu.rt_runtime_us is 0)",
        f"run: echo 100000 | sudo tee {share}",
    )


def real_time_group(root: Path = ROOT) -> tuple[str, str] | None:
    """Return the name of this process's control group, and the path of the file with its limit of real-time run time.

    The result is None without such a file: it exists only in version 1 of control groups. In version 2, real-time tasks
    of a kernel with RT_GROUP_SCHED must be in the root group.
    """
    for line in text_of(root / "proc/self/cgroup").splitlines():
        _, controllers, name = [*line.split(":", 2), "", ""][:3]
        if "cpu" in controllers.split(","):
            for place in (controllers, "cpu"):
                # Inside a container the group's own directory may be the root of the mount.
                for below in (name.strip("/"), ""):
                    file = Path("sys/fs/cgroup") / place / below / "cpu.rt_runtime_us"
                    if (root / file).exists():
                        return name, f"/{file}"
    return None


def of_processor(cpu: int, number: int, root: Path = ROOT) -> Check:
    """Return a failed check that explains why the loop may not run on processor `cpu`; `number` is the errno."""
    online = sorted(online_cpus(root))
    if online and cpu not in online:
        return _refused(
            PROCESSOR,
            f"processor {cpu} of host.cpu is not online: this computer has {', '.join(map(str, online))}",
            "set host.cpu to one of these processors",
        )
    return _refused(
        PROCESSOR,
        f"processor {cpu} of host.cpu is refused: {os.strerror(number)}",
        "set host.cpu to a processor that this program may use (taskset -p $$ shows them)",
    )


def of_memory(rights: Rights, number: int = 0, root: Path = ROOT) -> Check:
    """Return a failed check that explains why memory is not locked; `number` is the errno, 0: the limit is too low."""
    if rights.locked_limit is not None and (number in (0, errno.ENOMEM, errno.EPERM)):
        size = status_kilobytes("VmSize", root) // 1024
        limit = rights.locked_limit // _MIB
        text = f"memory is not locked: the limit is {limit} MiB, and the program needs more than {size} MiB"
        return _refused(MEMORY, text, LOG_IN_AGAIN + LIMITS_COMMAND)
    return _refused(MEMORY, f"memory is not locked: {os.strerror(number)}")


def of_idle(number: int, root: Path = ROOT) -> Check | None:
    """Return a failed check that explains why processors sleep deeply (`number`: errno); None if they cannot."""
    if number == errno.ENOENT:
        if not idle_driver(root):
            return None
        return _refused(
            IDLE, "idle processors sleep deeply: /dev/cpu_dma_latency does not exist (in a container?)"
        )
    return _refused(
        IDLE,
        f"idle processors sleep deeply: /dev/cpu_dma_latency cannot be opened ({os.strerror(number)})",
        LOG_IN_AGAIN + RULES_COMMAND,
    )
