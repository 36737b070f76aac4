"""What the kernel and the processors are: how late they may wake a thread, whatever it may ask for."""

from __future__ import annotations

import re
import time

from rig.bench.doctor.finding import Finding
from rig.bench.doctor.subject import Machine, ok, problem, warning
from rig.realtime.scheduling import facts
from rig.realtime.scheduling.facts import text_of

PREEMPT_FILE = "/sys/kernel/debug/sched/preempt"
CLOCK_FILE = "/sys/devices/system/clocksource/clocksource0/current_clocksource"
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit")
COARSE_NS = 1000
_HYPERVISORS = re.compile(
    r"QEMU|KVM|VMware|VirtualBox|Virtual Machine|Xen|Bochs|Parallels|Google|EC2", re.IGNORECASE
)


def preemption(machine: Machine) -> Finding:
    """How the kernel lets a real-time thread interrupt what runs."""
    name, why = "kernel", "what the kernel does not interrupt, the loop waits for"
    kind = facts.preemption(machine.root)
    if kind == "PREEMPT_RT":
        return ok(name, "PREEMPT_RT: almost everything gives way", why)
    if kind in ("PREEMPT_DYNAMIC (none)", "PREEMPT_DYNAMIC (voluntary)"):
        text = f"{kind}: the kernel's own work does not give way"
        return warning(name, text, why, f"echo full | sudo tee {PREEMPT_FILE}")
    if kind == "none":
        command = "sudo apt-get install linux-image-rt-amd64"
        return warning(
            name, "it does not preempt its own work (on Debian, after the command: reboot)", why, command
        )
    return ok(
        name, f"{kind}: most of it gives way; the longest waits are those that PREEMPT_RT would shorten", why
    )


def timer(machine: Machine) -> Finding:
    """Whether timers are finer than the kernel's tick."""
    name, why = "timers", "coarse timers wake the loop at multiples of 1 to 10 ms only"
    listed = re.search(r"\.resolution:\s*(\d+) nsecs", text_of(machine.root / "proc/timer_list"))
    resolution = int(listed[1]) if listed else round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9)
    if resolution <= COARSE_NS:
        return ok(name, f"high resolution ({resolution} ns)", why)
    return problem(
        name, f"their resolution is {resolution / 1e6:g} ms (booted with highres=off or nohz=off?)", why
    )


def clock(machine: Machine) -> Finding:
    """Whether reading the clock is cheap."""
    name, why = (
        "clock",
        "the loop reads the clock several times a tick; a slow counter costs microseconds each time",
    )
    source = facts.clock_source(machine.root)
    if source not in SLOW_CLOCKS:
        return ok(name, source or "not told", why)
    fast = [other for other in facts.clock_sources(machine.root) if other not in SLOW_CLOCKS]
    text = f"{source} is slow" + ("" if fast else ": the kernel found the processor's own counter not steady")
    return warning(name, text, why, f"echo {fast[0]} | sudo tee {CLOCK_FILE}" if fast else "")


def governor(machine: Machine) -> Finding:
    """Whether processors stay at their full frequency."""
    name, why = "frequency", "a processor that slows down between two ticks computes the next one late"
    chosen = facts.governors(machine.root)
    others = {cpu: by for cpu, by in chosen.items() if by != "performance"}
    if not chosen:
        return ok(name, "nothing here changes it", why)
    if not others:
        return ok(name, f"performance on {len(chosen)} processors", why)
    text = ", ".join(
        f"{by} on {sum(other == by for other in others.values())}" for by in sorted(set(others.values()))
    )
    file = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
    return warning(name, f"{text} of {len(chosen)} processors", why, f"echo performance | sudo tee {file}")


def isolation(machine: Machine) -> Finding:
    """Whether the loop's processor is its own."""
    name, why = "processor", "on a processor of its own the loop shares neither time nor caches"
    cpu, isolated = machine.request.cpu, sorted(facts.isolated_cpus(machine.root))
    online = sorted(facts.online_cpus(machine.root))
    if cpu is None:
        free = f"; isolated: {', '.join(map(str, isolated))}, which host.cpu could name" if isolated else ""
        return ok(name, f"the loop may run on any of {len(online) or 'the'} processors{free}", why)
    if online and cpu not in online:
        running = ", ".join(map(str, online))
        return problem(name, f"processor {cpu} of host.cpu is not running: this machine has {running}", why)
    if cpu in isolated:
        return ok(name, f"processor {cpu} is isolated", why)
    command = (
        f"""sudo sed -i 's/^GRUB_CMDLINE_LINUX="/&isolcpus={cpu} nohz_full={cpu} rcu_nocbs={cpu} /' /etc/default/grub"""
        " && sudo update-grub"
    )
    text = f"processor {cpu} is not isolated: other programs run there too (after the command: reboot)"
    return warning(name, text, why, command)


def virtual_machine(machine: Machine) -> Finding:
    """Whether there is another kernel below this one."""
    name, why = (
        "virtual machine",
        "the machine below may stop this one for milliseconds, and nobody here can forbid it",
    )
    flags = re.search(r"^flags\s*:.*\bhypervisor\b", text_of(machine.root / "proc/cpuinfo"), re.MULTILINE)
    below = text_of(machine.root / "sys/hypervisor/type") or text_of(
        machine.root / "proc/device-tree/hypervisor/compatible"
    )
    dmi = " ".join(
        text_of(machine.root / "sys/class/dmi/id" / part) for part in ("sys_vendor", "product_name")
    )
    if flags or below or _HYPERVISORS.search(dmi):
        return warning(name, f"this is one ({below or dmi.strip() or 'by its processor flags'})", why)
    return ok(name, "no sign of one", why)
