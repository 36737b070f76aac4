"""Check the properties of the kernel and the processors that delay the wake-up of a thread."""

import re
import sys
import time

from rig.core.answers import ok, question, refused, warning
from rig.core.check import Check
from rig.realtime.scheduling import facts, refusals
from rig.realtime.scheduling.facts import text_of

if sys.platform == "linux":
    from rig.doctor._subject import Machine

# `rig.doctor.interface` imports this file on Linux only; elsewhere mypy skips it from here on.
assert sys.platform == "linux"

PREEMPT_FILE = "/sys/kernel/debug/sched/preempt"
CLOCK_FILE = "/sys/devices/system/clocksource/clocksource0/current_clocksource"
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit")
# High-resolution timers report 1 ns; the kernel's tick is 1 to 10 ms.
COARSE_NS = 1000
_HYPERVISORS = re.compile(
    r"QEMU|KVM|VMware|VirtualBox|Virtual Machine|Xen|Bochs|Parallels|Google|EC2", re.IGNORECASE
)


@question("kernel", "the loop must wait for kernel work that cannot be interrupted")
def preemption(machine: Machine) -> Check:
    """Check whether a real-time thread may interrupt the kernel's own work (the kernel's preemption model)."""
    kind = facts.preemption(machine.root)
    if kind == "PREEMPT_RT":
        return ok("PREEMPT_RT: almost everything can be interrupted")
    if kind in ("PREEMPT_DYNAMIC (none)", "PREEMPT_DYNAMIC (voluntary)"):
        text = f"{kind}: kernel work cannot be interrupted"
        return warning(text, f"echo full | sudo tee {PREEMPT_FILE}")
    if kind == "none":
        remedy = "on Debian, run, then reboot: sudo apt-get install linux-image-rt-amd64"
        return warning("kernel work cannot be interrupted", remedy)
    return ok(f"{kind}: most kernel work can be interrupted; PREEMPT_RT would shorten the longest waits")


@question("timers", "coarse timers wake the loop at multiples of 1 to 10 ms only")
def timer(machine: Machine) -> Check:
    """Check whether timers have a resolution of 0.001 ms or finer."""
    listed = re.search(r"\.resolution:\s*(\d+) nsecs", text_of(machine.root / "proc/timer_list"))
    resolution = int(listed[1]) if listed else round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9)
    if resolution <= COARSE_NS:
        return ok(f"high resolution ({resolution} ns)")
    return refused(
        f"resolution {resolution / 1e6:g} ms, needed are 0.001 ms or finer",
        "remove highres=off and nohz=off from the kernel's command line and reboot",
    )


@question(
    "clock", "the loop reads the clock several times a tick, and a slow counter costs microseconds each time"
)
def clock(machine: Machine) -> Check:
    """Check whether the kernel's clock source is fast to read."""
    source = facts.clock_source(machine.root)
    if source not in SLOW_CLOCKS:
        return ok(source or "not known")
    fast = [other for other in facts.clock_sources(machine.root) if other not in SLOW_CLOCKS]
    if fast:
        return warning(f"{source} is slow", f"echo {fast[0]} | sudo tee {CLOCK_FILE}")
    return warning(f"{source} is slow: the kernel found the processor's counter (TSC) unsteady")


@question("frequency", "a processor that lowers its clock between ticks computes the next tick late")
def governor(machine: Machine) -> Check:
    """Check whether all processors stay at their highest clock frequency (frequency governor ``performance``)."""
    chosen = facts.governors(machine.root)
    # Any other governor lowers the clock of a processor that sleeps most of a tick.
    others = sorted(by for by in chosen.values() if by != "performance")
    if not chosen:
        return ok("fixed, or not visible on this machine")
    if not others:
        return ok(f"performance on {len(chosen)} processors")
    text = ", ".join(f"{by} on {others.count(by)}" for by in dict.fromkeys(others))
    file = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
    return warning(f"{text} of {len(chosen)} processors", f"echo performance | sudo tee {file}")


@question(refusals.PROCESSOR, "on an isolated processor the loop shares neither time nor caches")
def isolation(machine: Machine) -> Check:
    """Check whether the processor with the number `host.cpu` is isolated, so that only the loop runs on it."""
    cpu, isolated = machine.request.cpu, sorted(facts.isolated_cpus(machine.root))
    online = sorted(facts.online_cpus(machine.root))
    if cpu is None:
        free = f"; isolated processors for host.cpu: {', '.join(map(str, isolated))}" if isolated else ""
        return ok(f"the loop may run on any of {len(online) or 'the'} processors{free}")
    if online and cpu not in online:
        return refusals.of_processor(cpu, 0, machine.root)
    if cpu in isolated:
        return ok(f"processor {cpu} is isolated")
    edit = f's/^GRUB_CMDLINE_LINUX="/&isolcpus={cpu} nohz_full={cpu} rcu_nocbs={cpu} /'
    return warning(
        f"processor {cpu} is not isolated: other programs run on it too",
        f"run, then reboot: sudo sed -i '{edit}' /etc/default/grub && sudo update-grub",
    )


@question(
    "virtual machine", "the hypervisor may stop this machine for milliseconds, which nothing here can prevent"
)
def virtual_machine(machine: Machine) -> Check:
    """Warn if this computer is a virtual machine."""
    flags = re.search(r"^flags\s*:.*\bhypervisor\b", text_of(machine.root / "proc/cpuinfo"), re.MULTILINE)
    below = text_of(machine.root / "sys/hypervisor/type") or text_of(
        machine.root / "proc/device-tree/hypervisor/compatible"
    )
    dmi = " ".join(
        text_of(machine.root / "sys/class/dmi/id" / part) for part in ("sys_vendor", "product_name")
    )
    if flags or below or _HYPERVISORS.search(dmi):
        return warning(f"this machine is virtual ({below or dmi.strip() or 'by its processor flags'})")
    return ok("no sign of virtualisation")
