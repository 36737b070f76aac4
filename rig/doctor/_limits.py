"""Check whether this process may use real-time priority, lock its memory and keep processors awake (Linux only)."""

import errno
import sys

from rig.core.answers import ok, question, refused, warning
from rig.core.check import Check, Outcome
from rig.realtime.scheduling import refusals
from rig.realtime.scheduling.facts import rt_period_us, rt_runtime_us, status_kilobytes, text_of

if sys.platform == "linux":
    from rig.doctor._subject import Machine
    from rig.realtime.scheduling import IDLE_DEVICE

# `rig.doctor.interface` imports this file on Linux only; elsewhere mypy skips it from here on.
assert sys.platform == "linux"


@question(
    refusals.PRIORITY,
    "without real-time priority a thread waits for other programs, for milliseconds on a busy machine",
)
def priority(machine: Machine) -> Check:
    """Check whether the kernel grants the requested real-time priority (scheduling policy SCHED_FIFO)."""
    wanted = machine.request.priority
    if not machine.rights.may_schedule(wanted):
        return machine.judged(refusals.of_policy(wanted, machine.rights, errno.EPERM, machine.root))
    group = refusals.group_refusal(wanted, machine.root)
    found = [group] if group else machine.tried(wanted, None)[1]
    return machine.judged(found[0]) if found else ok(f"SCHED_FIFO {wanted} is granted")


@question(refusals.MEMORY, "reading a swapped memory page back from disk stops the loop for milliseconds")
def memory(machine: Machine) -> Check:
    """Check whether this process may lock all of its memory in RAM, so that no page is swapped to disk."""
    if machine.rights.may_lock(status_kilobytes("VmSize", machine.root) * 1024 + refusals.ROOM):
        return ok("the program may lock its memory")
    return machine.judged(refusals.of_memory(machine.rights, root=machine.root))


@question(refusals.IDLE, "waking from deep sleep takes 0.1 ms or more")
def idle_states(machine: Machine) -> Check:
    """Check whether this process may forbid the deep sleep of processors, from which waking takes 0.1 ms or more."""
    device = machine.root / IDLE_DEVICE
    if device.exists() and machine.openable(device):
        return ok("processors can be kept from deep sleep (/dev/cpu_dma_latency)")
    refusal = refusals.of_idle(errno.EACCES if device.exists() else errno.ENOENT, machine.root)
    return machine.judged(refusal) if refusal else ok("processors have no deep sleep on this machine")


@question("swap", "swapped memory must be read back from disk before the loop continues")
def swap(machine: Machine) -> Check:
    """Check whether the kernel may move the loop's memory to a swap area."""
    areas = [line.split() for line in text_of(machine.root / "proc/swaps").splitlines()[1:]]
    used = sum(int(area[3]) for area in areas if len(area) > 3 and area[3].isdecimal()) // 1024
    if not areas:
        return ok("none")
    if memory(machine).outcome == Outcome.OK:
        return ok(f"{used} MiB in use; the loop's memory is locked and not swapped")
    return warning(f"{used} MiB in use, and memory cannot be locked", "sudo swapoff -a")


@question(
    "real-time share",
    "the time that the kernel reserves keeps a processor usable if a real-time loop never waits",
)
def real_time_share(machine: Machine) -> Check:
    """Check which share of each period the kernel grants to real-time threads (kernel.sched_rt_runtime_us)."""
    remedy = "sudo sysctl -w kernel.sched_rt_runtime_us=950000"
    runtime, period = rt_runtime_us(machine.root), rt_period_us(machine.root) or 1_000_000
    if runtime is None:
        return ok("the kernel reports no limit")
    if runtime < 0:
        return warning("real-time threads may use all processor time", remedy)
    if runtime == 0:
        return machine.judged(refused("real-time threads may not run at all", remedy))
    return ok(f"real-time threads may run {runtime / period:.0%} of each {period / 1e6:g} s")
