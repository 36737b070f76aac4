"""What this process may have: priority, locked memory, processors that stay awake."""

from __future__ import annotations

import errno

from rig.bench.doctor.finding import Finding, Outcome
from rig.bench.doctor.subject import Machine, ok, warning
from rig.realtime.scheduling import idle, refusals
from rig.realtime.scheduling.facts import rt_period_us, rt_runtime_us, status_kilobytes, text_of


def priority(machine: Machine) -> Finding:
    """Whether SCHED_FIFO is granted: limits and control group say why not, and a thread that ends at once tries it."""
    name = "real-time priority"
    why = "an ordinary thread waits behind other programs, for milliseconds when the machine is busy"
    wanted = machine.request.priority
    if not machine.rights.may_schedule(wanted):
        refusal = refusals.of_policy(wanted, machine.rights, errno.EPERM, machine.root)
        return machine.refused(name, refusal, why)
    group = refusals.group_refusal(f"SCHED_FIFO {wanted} is refused", machine.root)
    refused = [group] if group else machine.tried(wanted, None)[1]
    return (
        machine.refused(name, refused[0], why)
        if refused
        else ok(name, f"SCHED_FIFO {wanted} is granted", why)
    )


def memory(machine: Machine) -> Finding:
    """Whether all of the program's memory may be locked."""
    why = "a page that has to be read back from a disk stops the loop for milliseconds"
    if machine.rights.may_lock(status_kilobytes("VmSize", machine.root) * 1024 + refusals.ROOM):
        return ok("locked memory", "the program may lock its memory", why)
    return machine.refused("locked memory", refusals.of_memory(machine.rights, root=machine.root), why)


def idle_states(machine: Machine) -> Finding:
    """Whether processors can be kept from deep sleep."""
    name, why = "idle processors", "waking from deep sleep takes 0.1 ms and more"
    device = machine.root / idle.DEVICE
    if device.exists() and machine.openable(device):
        return ok(name, "they can be kept from deep sleep (/dev/cpu_dma_latency)", why)
    refusal = refusals.of_idle(errno.EACCES if device.exists() else errno.ENOENT, machine.root)
    return machine.refused(name, refusal, why) if refusal else ok(name, "they do not sleep deeply here", why)


def swap(machine: Machine) -> Finding:
    """Whether memory may be moved to a disk."""
    why = "what was moved to a disk has to be read back before the loop goes on"
    areas = [line.split() for line in text_of(machine.root / "proc/swaps").splitlines()[1:]]
    used = sum(int(area[3]) for area in areas if len(area) > 3 and area[3].isdecimal()) // 1024
    if not areas:
        return ok("swap", "there is none", why)
    if memory(machine).outcome == Outcome.OK:
        return ok("swap", f"{used} MiB are in use; the loop's memory is locked and stays", why)
    return warning("swap", f"{used} MiB are in use, and memory cannot be locked", why, "sudo swapoff -a")


def real_time_share(machine: Machine) -> Finding:
    """Return how much of a second real-time threads may run."""
    name, command = "real-time share", "sudo sysctl -w kernel.sched_rt_runtime_us=950000"
    why = "the share that is kept back is what saves a processor from a loop that never waits"
    runtime, period = rt_runtime_us(machine.root), rt_period_us(machine.root) or 1_000_000
    if runtime is None:
        return ok(name, "the kernel keeps nothing back that it tells of", why)
    if runtime < 0:
        return warning(name, "real-time threads may run without end", why, command)
    if runtime == 0:
        return machine.refused(name, refusals.Refusal("real-time threads may not run at all", command), why)
    return ok(name, f"real-time threads may run {runtime / period:.0%} of each {period / 1e6:g} s", why)
