"""Read facts about scheduling on this computer from the Linux kernel's files in /proc and /sys.

`root` is the directory that contains proc and sys. A fact that cannot be read is an empty text, None or an empty set.

A recording stores these facts and `rig.doctor` judges them. This file must not judge or change anything.
"""

import gzip
import platform
import re
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

ROOT = Path("/")
_CPUS = "sys/devices/system/cpu"


def text_of(path: Path) -> str:
    """Return the content of a small file without surrounding white space; "" if the file cannot be read."""
    try:
        return path.read_text("utf-8", errors="replace").strip()
    except OSError:
        return ""


def number_of(path: Path) -> int | None:
    """Return the integer in a file; None if the file cannot be read or contains anything else."""
    try:
        return int(text_of(path))
    except ValueError:
        return None


def preemption(root: Path = ROOT) -> str:
    """Return the kernel's preemption: "PREEMPT_RT", "PREEMPT_DYNAMIC" (with its mode if known), "PREEMPT" or "none"."""
    version = text_of(root / "proc/sys/kernel/version")
    if text_of(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return "PREEMPT_RT"
    if "PREEMPT_DYNAMIC" in version:
        mode = _dynamic_mode(root)
        return f"PREEMPT_DYNAMIC ({mode})" if mode else "PREEMPT_DYNAMIC"
    return "PREEMPT" if "PREEMPT" in version else "none"


def _dynamic_mode(root: Path) -> str:
    chosen = re.search(r"\((\w+)\)", text_of(root / "sys/kernel/debug/sched/preempt"))
    chosen = chosen or re.search(r"\bpreempt=(\w+)", text_of(root / "proc/cmdline"))
    return chosen[1] if chosen else _built_mode(root)


def _built_mode(root: Path) -> str:
    try:
        built = gzip.decompress((root / "proc/config.gz").read_bytes()).decode(errors="replace")
    except (OSError, EOFError, zlib.error):
        built = text_of(root / f"boot/config-{platform.release()}")
    lines = set(built.splitlines())
    modes = {"NONE": "none", "VOLUNTARY": "voluntary", "LAZY": "lazy"}
    found = next((mode for key, mode in modes.items() if f"CONFIG_PREEMPT_{key}=y" in lines), "")
    return found or ("full" if "CONFIG_PREEMPT=y" in lines else "")


def rt_runtime_us(root: Path = ROOT) -> int | None:
    """Return how long (µs) real-time tasks may run in each `rt_period_us`; -1 without a limit, None if unknown."""
    return number_of(root / "proc/sys/kernel/sched_rt_runtime_us")


def rt_period_us(root: Path = ROOT) -> int | None:
    """Return the period (µs) to which the limit `rt_runtime_us` of real-time tasks applies; None if unknown."""
    return number_of(root / "proc/sys/kernel/sched_rt_period_us")


def clock_source(root: Path = ROOT) -> str:
    """Return the name of the hardware counter that CLOCK_MONOTONIC uses, such as "tsc"; "" if unknown."""
    return text_of(root / "sys/devices/system/clocksource/clocksource0/current_clocksource")


def clock_sources(root: Path = ROOT) -> list[str]:
    """Return the names of the hardware counters that the kernel can use for CLOCK_MONOTONIC."""
    return text_of(root / "sys/devices/system/clocksource/clocksource0/available_clocksource").split()


def governors(root: Path = ROOT) -> dict[int, str]:
    """Return the frequency governor ("powersave", …) by processor number; empty if frequencies are fixed or hidden."""
    found = {}
    for path in (root / _CPUS).glob("cpu[0-9]*/cpufreq/scaling_governor"):
        found[int(path.parent.parent.name[3:])] = text_of(path)
    return dict(sorted(found.items()))


def idle_driver(root: Path = ROOT) -> str:
    """Return the name of the kernel's driver that puts idle processors to sleep; "" if no driver is active."""
    name = text_of(root / _CPUS / "cpuidle/current_driver")
    return "" if name == "none" else name


def online_cpus(root: Path = ROOT) -> set[int]:
    """Return the numbers of the processors that are online; empty if unknown."""
    return cpu_list(text_of(root / _CPUS / "online"))


def isolated_cpus(root: Path = ROOT) -> set[int]:
    """Return the numbers of the processors without ordinary tasks (``isolcpus`` on the kernel's command line)."""
    return cpu_list(text_of(root / _CPUS / "isolated"))


def cpu_list(text: str) -> set[int]:
    """Return the processor numbers in a list of the kernel such as ``0-3,8``; parts without numbers are skipped."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        with suppress(ValueError):
            found.update(range(int(first), int(last or first) + 1))
    return found


def status_kilobytes(name: str, root: Path = ROOT) -> int:
    """Return a memory size (kB) of this process by its name in /proc/self/status, such as "VmLck"; 0 if missing."""
    match = re.search(rf"^{name}:\s*(\d+) kB", text_of(root / "proc/self/status"), re.MULTILINE)
    return int(match[1]) if match else 0


def describe_scheduling(cpu: int | None, root: Path = ROOT) -> dict[str, Any]:
    """Return the kernel's facts about scheduling on processor `cpu` (None: any) as JSON types for a recording."""
    chosen = governors(root)
    of_cpu = [chosen[cpu]] if cpu in chosen else sorted(set(chosen.values()))
    return {
        "kernel": platform.release(),
        "preemption": preemption(root),
        "rt_runtime_us": rt_runtime_us(root),
        "rt_period_us": rt_period_us(root),
        "clock_source": clock_source(root),
        "governor": ", ".join(of_cpu),
    }
