"""Checks of a machine, on trees of /proc, /sys, /dev and /etc made for each case."""

from __future__ import annotations

import errno
import gzip
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.cli.doctor import doctor
from rig.config._sections import Host
from rig.core.check import Check, Outcome
from rig.core.present import plain
from rig.doctor import _access as access
from rig.doctor import _kernel as kernel
from rig.doctor import _limits as limits
from rig.doctor import _wake_up as wake_up
from rig.doctor._machine import CHECKS, machine_checks
from rig.doctor._subject import Machine
from rig.doctor._udev import RIGS, udev_rules
from rig.realtime.scheduling import Rights, ThreadState, facts, name_of_group, refusals

OK, WARNING, REFUSED = Outcome.OK, Outcome.WARNING, Outcome.REFUSED
CPU = "sys/devices/system/cpu"
CLOCKS = "sys/devices/system/clocksource/clocksource0"
ORDINARY = Rights(user="ada", groups=frozenset({"ada"}), priority_limit=0, locked_limit=8 * 2**20)
ALLOWED = Rights(user="ada", groups=frozenset({"ada", "dialout"}), priority_limit=98, locked_limit=None)


class Tree:
    """A fake machine: its files by path, and the rights of its user."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.refusals: list[Check] = []

    def with_files(self, files: dict[str, str]) -> Tree:
        for name, text in files.items():
            path = self.root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return self

    def machine(self, rights: Rights = ALLOWED, *, may_open: bool = True, **host: object) -> Machine:
        return Machine(
            request=Host(**host),
            root=self.root,
            rights=rights,
            openable=lambda path: path.exists() and may_open,
            tried=lambda priority, cpu: (None, self.refusals),
        )


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    return Tree(tmp_path)


def group_of(path: Path) -> str:
    return name_of_group(path.stat().st_gid)


# ---------------------------------------------------------------------- all of them


def test_a_machine_of_which_nothing_can_be_read_gives_findings_and_no_traceback(tree: Tree) -> None:
    findings = machine_checks(machine=tree.machine(ORDINARY), seconds=0)
    assert len(findings) == len(CHECKS)
    assert len({finding.name for finding in findings}) == len(CHECKS)
    for finding in findings:
        assert finding.text
        assert finding.why
        assert isinstance(json.dumps(plain(finding)), str)


READ = f"""
proc/swaps proc/self/cgroup proc/self/status proc/timer_list proc/cpuinfo proc/sys/kernel/sched_rt_runtime_us
proc/sys/kernel/version proc/cmdline proc/1/comm proc/config.gz etc/group {CPU}/online {CPU}/isolated
{CPU}/cpu0/cpufreq/scaling_governor {CLOCKS}/current_clocksource sys/kernel/debug/sched/preempt
"""


@settings(max_examples=8)
@given(st.text(max_size=200))
def test_any_text_in_any_file_gives_findings(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    tree = Tree(tmp_path_factory.mktemp("machine"))
    for name in READ.split():
        path = tree.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.replace("-", " ").encode(errors="surrogatepass"))
    assert len(machine_checks(machine=tree.machine(ORDINARY), seconds=0)) == len(CHECKS)


def test_this_machine_is_checked_without_a_change() -> None:
    before = facts.status_kilobytes("VmLck"), ThreadState.here()
    assert len(machine_checks(seconds=0)) == len(CHECKS)
    assert (facts.status_kilobytes("VmLck"), ThreadState.here()) == before


# ---------------------------------------------------------------------- what the process may have


@pytest.mark.parametrize(("realtime", "outcome"), [("enforce", REFUSED), ("try", WARNING), ("off", WARNING)])
def test_a_refusal_is_as_bad_as_the_experiment_takes_it(tree: Tree, realtime: str, outcome: Any) -> None:
    machine = tree.machine(ORDINARY, realtime=realtime)
    for check in (limits.priority, limits.memory):
        finding = check(machine)
        assert finding.outcome == outcome
        assert finding.remedy == f"{refusals.LOG_IN_AGAIN}{refusals.LIMITS_COMMAND}"


GROUP = {"proc/self/cgroup": "8:cpu,cpuacct:/user.slice\n0::/\n"}
SHARE = "sys/fs/cgroup/cpu,cpuacct/user.slice/cpu.rt_runtime_us"


def test_a_refusal_that_neither_limits_nor_groups_explain_is_found_by_trying(tree: Tree) -> None:
    tree.refusals = [refusals.of_policy(80, ALLOWED, errno.EPERM, tree.root)]
    finding = limits.priority(tree.machine())
    assert finding.outcome == WARNING
    assert "a container or a control group" in finding.text
    assert finding.remedy


SWAPS = "Filename Type Size Used Priority\n/dev/sda2 partition 2097148 20480 -2\n/swap file 1024 2048 -3\n"
SHARE_COMMAND = f"run: echo 100000 | sudo tee /{SHARE}"
RT_SHARE = "proc/sys/kernel/sched_rt_runtime_us"
CONTAINER = {"proc/self/cgroup": "4:cpu:/docker/0123\n", "sys/fs/cgroup/cpu/cpu.rt_runtime_us": "0"}
IDLE = {f"{CPU}/cpuidle/current_driver": "intel_idle"}
LATENCY = IDLE | {"dev/cpu_dma_latency": ""}
RULES = refusals.LOG_IN_AGAIN + refusals.RULES_COMMAND
ADD_TO_GROUP = f"{refusals.LOG_IN_AGAIN}sudo usermod -aG dialout ada"
OTHERS = {"rights": ORDINARY}
POWERSAVE = {
    f"{CPU}/cpu{n}/cpufreq/scaling_governor": f"{'powersave' if n % 2 else 'performance'}\n" for n in range(4)
}
ISOLATED = {f"{CPU}/online": "0-3", f"{CPU}/isolated": "3"}
INFO, DMI = "proc/cpuinfo", "sys/class/dmi/id"
is_virtual = kernel.virtual_machine


def clocks(current: str, available: str) -> dict[str, str]:
    return {f"{CLOCKS}/current_clocksource": current, f"{CLOCKS}/available_clocksource": available}


@pytest.mark.parametrize(
    ("check", "files", "given", "outcome", "text", "remedy"),
    [
        (limits.priority, {}, {}, OK, "", ""),
        (limits.memory, {}, {}, OK, "", ""),
        (limits.priority, GROUP | {SHARE: "0\n"}, {}, WARNING, "", SHARE_COMMAND),
        (limits.priority, GROUP | {SHARE: "100000\n"}, {}, OK, "", ""),
        # Then groups have no shares.
        (limits.priority, GROUP | {SHARE: "0\n", RT_SHARE: "-1"}, {}, OK, "", ""),
        (limits.priority, CONTAINER, {}, WARNING, "", "/sys/fs/cgroup/cpu/cpu.rt_runtime_us"),
        (limits.idle_states, {}, {}, OK, "", ""),
        (limits.idle_states, IDLE, {}, WARNING, "", ""),
        (limits.idle_states, LATENCY, {}, OK, "", ""),
        (limits.idle_states, LATENCY, {"may_open": False}, WARNING, "", RULES),
        (limits.swap, {}, OTHERS, OK, "none", ""),
        (limits.swap, {"proc/swaps": SWAPS}, {}, OK, "", ""),
        (limits.swap, {"proc/swaps": SWAPS}, OTHERS, WARNING, "22 MiB", "sudo swapoff -a"),
        (limits.real_time_share, {RT_SHARE: "950000"}, {}, OK, "95% of each 1 s", ""),
        (limits.real_time_share, {RT_SHARE: "-1"}, {}, WARNING, "", "sched_rt_runtime_us"),
        (limits.real_time_share, {RT_SHARE: "0"}, {}, WARNING, "may not run at all", "sched_rt_runtime_us"),
        (kernel.timer, {"proc/timer_list": "  .resolution: 1 nsecs\n"}, {}, OK, "", ""),
        (kernel.timer, {"proc/timer_list": "  .resolution: 4000000 nsecs\n"}, {}, REFUSED, "4 ms", ""),
        (kernel.clock, clocks("tsc", "tsc hpet acpi_pm"), {}, OK, "", ""),
        (kernel.clock, clocks("kvm-clock", "kvm-clock tsc"), {}, OK, "", ""),
        (
            kernel.clock,
            clocks("hpet", "tsc hpet"),
            {},
            WARNING,
            "",
            f"echo tsc | sudo tee {kernel.CLOCK_FILE}",
        ),
        (kernel.clock, clocks("acpi_pm", "hpet acpi_pm"), {}, WARNING, "", ""),
        (kernel.governor, {}, {}, OK, "", ""),
        (kernel.governor, POWERSAVE, {}, WARNING, "powersave on 2 of 4 processors", ""),
        (kernel.isolation, ISOLATED, {}, OK, "isolated processors for host.cpu: 3", ""),
        (kernel.isolation, ISOLATED, {"cpu": 3}, OK, "is isolated", ""),
        (kernel.isolation, ISOLATED, {"cpu": 2}, WARNING, "not isolated", "isolcpus=2"),
        (kernel.isolation, ISOLATED, {"cpu": 7}, REFUSED, "this computer has 0, 1, 2, 3", ""),
        (is_virtual, {}, {}, OK, "", ""),
        (is_virtual, {INFO: "processor : 0\nflags\t\t: fpu hypervisor lahf_lm\n"}, {}, WARNING, "", ""),
        (is_virtual, {INFO: "flags\t\t: fpu vme\nbugs\t: no_hypervisor hypervisor_x\n"}, {}, OK, "", ""),
        (is_virtual, {"sys/hypervisor/type": "xen\n"}, {}, WARNING, "", ""),
        (is_virtual, {f"{DMI}/sys_vendor": "QEMU\n"}, {}, WARNING, "", ""),
        (is_virtual, {f"{DMI}/sys_vendor": "LENOVO\n", f"{DMI}/product_name": "20XW"}, {}, OK, "", ""),
        (is_virtual, {"proc/device-tree/hypervisor/compatible": "linux,kvm\0"}, {}, WARNING, "", ""),
        (access.serial_ports, {"etc/group": "dialout:x:20:\n"}, OTHERS, WARNING, "", ADD_TO_GROUP),
        (access.serial_ports, {"etc/group": "wheel:x:10:\n"}, OTHERS, OK, "", ""),
        (access.serial_ports, {"etc/group": "dialout:x:20:ada\n"}, {}, OK, "", ""),
    ],
)
def test_a_check_finds_what_the_files_of_the_machine_show(
    tree: Tree, check: Any, files: dict[str, str], given: Any, outcome: Outcome, text: str, remedy: str
) -> None:
    finding = check(tree.with_files(files).machine(**given))
    assert finding.outcome == outcome
    assert text in finding.text
    assert remedy in finding.remedy
    assert outcome != OK or not finding.remedy


# ---------------------------------------------------------------------- kernel and processors


@pytest.mark.parametrize(
    ("version", "config", "outcome"),
    [
        ("#1 SMP PREEMPT_RT", "", OK),
        ("#1 SMP PREEMPT", "", OK),
        ("#1 SMP PREEMPT_DYNAMIC", "", OK),
        ("#1 SMP PREEMPT_DYNAMIC", "CONFIG_PREEMPT=y", OK),
        ("#1 SMP PREEMPT_DYNAMIC", "CONFIG_PREEMPT_NONE=y", WARNING),
        ("#1 SMP PREEMPT_DYNAMIC", "CONFIG_PREEMPT_VOLUNTARY=y", WARNING),
        ("#1 SMP", "", WARNING),
    ],
)
def test_kernels_and_how_they_give_way(tree: Tree, version: str, config: str, outcome: Any) -> None:
    tree.with_files({"proc/sys/kernel/version": version})
    (tree.root / "proc/config.gz").write_bytes(gzip.compress(f"{config}\nCONFIG_X=m\n".encode()))
    finding = kernel.preemption(tree.machine())
    assert finding.outcome == outcome
    assert bool(finding.remedy) == (outcome != OK)


# ---------------------------------------------------------------------- ports


def test_ports_that_do_not_open_name_the_group_that_owns_them(tree: Tree) -> None:
    tree.with_files({"dev/ttyACM0": "", "dev/ttyUSB1": "", "dev/ttyS0": ""})
    assert access.serial_ports(tree.machine()).text == "ttyACM0, ttyUSB1 can be opened"
    finding = access.serial_ports(tree.machine(may_open=False))
    assert finding.outcome == REFUSED
    group = group_of(tree.root / "dev/ttyACM0")
    add = refusals.RULES_COMMAND if group == "root" else f": sudo usermod -aG {group} ada"
    assert finding.remedy.endswith(add)


def test_a_port_of_a_group(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access, "name_of_group", lambda number: "uucp")
    tree.with_files({"dev/ttyACM0": "", "etc/group": "uucp:x:14:bob\n"})
    finding = access.serial_ports(tree.machine(ORDINARY, may_open=False))
    assert (finding.outcome, finding.remedy) == (REFUSED, f"{refusals.LOG_IN_AGAIN}sudo usermod -aG uucp ada")
    tree.with_files({"etc/group": "uucp:x:14:bob,ada\n"})
    finding = access.serial_ports(tree.machine(ORDINARY, may_open=False))
    assert finding.remedy == "log in again"


def test_modem_manager_is_harmless_once_the_rules_are_there(tree: Tree) -> None:
    assert access.modem_manager(tree.machine()).outcome == OK
    tree.with_files({"proc/17/comm": "ModemManager\n", "proc/self/comm": "rig\n"})
    finding = access.modem_manager(tree.machine())
    assert (finding.outcome, finding.remedy) == (WARNING, refusals.RULES_COMMAND)
    assert access.udev_rules_present(tree.machine()).outcome == WARNING
    tree.with_files({refusals.RULES_FILE.lstrip("/"): udev_rules()})
    assert access.modem_manager(tree.machine()).outcome == OK
    assert access.udev_rules_present(tree.machine()).outcome == OK


def test_brltty_is_found_running_or_waiting_for_an_adapter(tree: Tree) -> None:
    assert access.brltty(tree.machine()).outcome == OK
    rules = tree.root / "usr/lib/udev/rules.d/85-brltty.rules"
    tree.with_files({"usr/lib/udev/rules.d/85-brltty.rules": ""})
    assert access.brltty(tree.machine()).outcome == WARNING
    rules.unlink()
    rules.symlink_to("/dev/null")  # masked
    assert access.brltty(tree.machine()).outcome == OK
    tree.with_files({"proc/99/comm": "brltty\n"})
    assert access.brltty(tree.machine()).outcome == WARNING


# ---------------------------------------------------------------------- rules

RULE = re.compile(r'[A-Z]+(\{[A-Za-z_]+\})?(==|\+=|=)"[^"]*"')


@settings(max_examples=20)
@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF)), max_size=5))
def test_rules_are_well_formed_and_match_before_they_assign(rigs: Any) -> None:
    text = udev_rules(rigs)
    for line in text.splitlines():
        if line and not line.startswith("#"):
            parts = line.split(", ")
            assert all(RULE.fullmatch(part) for part in parts), line
            matches = ["==" in part for part in parts]
            assert matches == sorted(matches, reverse=True)
            assert True in matches
    for vendor, product in rigs:
        assert f'"{vendor:04x}", ATTR{{idProduct}}=="{product:04x}"' in text
    assert text.count("haptic-rig-$env{ID_SERIAL_SHORT}") == len(set(rigs))


def test_rules_do_what_rigs_want() -> None:
    text = udev_rules()
    for part in ('ID_MM_DEVICE_IGNORE}="1"', 'TAG+="uaccess"', 'ATTR{latency_timer}="1"', "cpu_dma_latency"):
        assert part in text
    assert udev_rules([*RIGS, *RIGS]) == text


# ---------------------------------------------------------------------- wake-ups


@pytest.mark.parametrize("realtime", ["enforce", "try", "off"])
def test_wake_ups_are_measured_as_far_as_granted(realtime: str) -> None:
    before = facts.status_kilobytes("VmLck"), ThreadState.here()
    woken = wake_up.measure(Host(realtime=realtime), 0.05)
    assert (facts.status_kilobytes("VmLck"), ThreadState.here()) == before
    assert woken.count == 50
    assert 0 < woken.p50_s <= woken.p99_s <= woken.worst_s
    assert woken.skipped >= 0
    refused = any("SCHED_FIFO" in text for text in woken.refusals)
    assert woken.thread.is_fifo == (realtime != "off" and not refused)
    finding = wake_up.judge(woken)
    assert "50 at 1 kHz as SCHED_" in finding.text
    assert finding.numbers["worst_s"] == woken.worst_s


def test_the_kernel_sleeps_to_a_grid_and_skips_what_it_missed() -> None:
    late = np.full(20, -1, np.int64)
    assert wake_up.wake_ups(200_000, late) >= 0
    assert (late >= 0).all()


def test_late_wake_ups_are_a_warning_with_what_was_refused() -> None:
    thread = ThreadState(policy=0, priority=0, cpus=(0,), timer_slack_ns=1)
    woken = wake_up.WakeUps(
        rate_hz=1000, count=1000, p50_s=25e-6, p99_s=2.5e-3, worst_s=8e-3, skipped=3, thread=thread,
        refusals=("SCHED_FIFO 80 is refused",),
    )  # fmt: skip
    finding = wake_up.judge(woken)
    assert finding.outcome == WARNING
    assert finding.text.endswith("longest 8000 µs; 3 periods missed; SCHED_FIFO 80 is refused")


def test_the_command_prints_the_rules_and_nothing_else() -> None:
    result = CliRunner().invoke(doctor, ["--print-udev"])
    assert (result.exit_code, result.stdout) == (0, udev_rules())
