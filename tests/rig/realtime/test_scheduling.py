"""Real-time scheduling: rights that are granted, rights refused with a remedy, and settings restored afterwards.

The cases of an ordinary user run in child processes that give up their rights.
"""

import errno
import json
import mmap
import os
import re
import resource
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.core.errors import RealtimeError
from rig.realtime.scheduling import Realtime, Rights, ThreadState, facts, obtained, refusals
from rig.realtime.scheduling import _calls as calls
from rig.realtime.scheduling import _memory as memory
from tests.conformance.scheduled import (
    CHILD_S,
    Asked,
    all_threads,
    in_thread,
    latency_requests,
    locked,
    state,
)

KIB = 1024


@pytest.fixture(scope="module")
def realtime_rights() -> None:
    """Skip the test unless the machine grants real-time scheduling to this process."""
    with obtained(Asked()) as realtime:
        refused = realtime.refusals
    if refused:
        pytest.skip(f"this process may not schedule in real time: {refused[0].text}")


@pytest.fixture(autouse=True)
def as_before() -> Iterator[Any]:
    before = state()
    yield
    assert state() == before


@pytest.mark.usefixtures("realtime_rights")
def test_the_loop_s_thread_gets_policy_priority_and_processor_and_its_children_do_not() -> None:
    cpu = max(os.sched_getaffinity(0))
    with obtained(Asked("enforce", priority=42, cpu=cpu)) as realtime:

        def body() -> tuple[ThreadState | None, ThreadState]:
            return realtime.enter_thread(), in_thread(ThreadState.here)

        mine, childs = in_thread(body)
        assert mine.is_fifo
        assert (mine.priority, mine.cpus) == (42, (cpu,))
        assert childs.name == "SCHED_OTHER"


@pytest.mark.usefixtures("realtime_rights")
def test_a_thread_that_lives_on_gets_back_what_it_had() -> None:
    def body() -> tuple[ThreadState, ThreadState | None, ThreadState]:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        calls.set_timer_slack(12_345)
        before = ThreadState.here()
        with obtained(Asked(cpu=min(os.sched_getaffinity(0)))) as realtime:
            entered = realtime.enter_thread()
            in_thread(realtime.leave_thread)  # another thread, which never entered, changes nothing
            assert ThreadState.here() == entered
            realtime.leave_thread()
            after = ThreadState.here()
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            realtime.leave_thread()  # a second time changes nothing
            assert ThreadState.here().name == "SCHED_OTHER"
        return before, entered, after

    before, entered, after = in_thread(body)
    assert entered.is_fifo
    assert after == before
    assert after.timer_slack_ns == 12_345


@pytest.mark.usefixtures("realtime_rights")
def test_contexts_within_each_other_give_back_in_turn() -> None:
    def body() -> list[tuple[str, int]]:
        seen = []
        with obtained(Asked(priority=30)) as outer, obtained(Asked(priority=40)) as inner:
            for step in (outer.enter_thread, inner.enter_thread, inner.leave_thread, outer.leave_thread):
                step()
                now = ThreadState.here()
                seen.append((now.name, now.priority))
        return seen

    fifo = "SCHED_FIFO"
    assert in_thread(body) == [(fifo, 30), (fifo, 40), (fifo, 30), ("SCHED_OTHER", 0)]


@pytest.mark.usefixtures("realtime_rights")
def test_an_exception_and_a_refusal_undo_everything() -> None:
    before = state()
    with pytest.raises(ZeroDivisionError), obtained(Asked("enforce")):
        raise ZeroDivisionError
    assert state() == before
    with pytest.raises(RealtimeError, match="processor 4095"), obtained(Asked("enforce", cpu=4095)):
        pytest.fail("a context that is refused must not run")
    assert state() == before


@pytest.mark.usefixtures("realtime_rights")
def test_contexts_in_any_order_hold_until_the_last_one_ends() -> None:
    """Only the number of open contexts counts: try each change between none and three, in both directions."""
    held: list[ExitStack] = []
    per_context = 1 if Path("/dev/cpu_dma_latency").exists() else 0
    with ExitStack() as rest:
        for change in "++-++---+-":
            if change == "+":
                held.append(rest.enter_context(ExitStack()))
                held[-1].enter_context(obtained(Asked()))
            else:
                held.pop(0).close()  # not the latest: contexts of several threads do not nest
            assert (locked() > 0) == bool(held)
            assert latency_requests() == per_context * len(held)
            assert ThreadState.here().name == "SCHED_OTHER"  # only a loop's thread changes
    assert locked() == 0


@pytest.mark.usefixtures("realtime_rights")
def test_pages_locked_by_other_code_stay_locked() -> None:
    with mmap.mmap(-1, 4 * mmap.PAGESIZE) as region:
        word = np.frombuffer(region, np.uint8)
        address = word.ctypes.data
        assert calls.lock_range(address, 4 * mmap.PAGESIZE, on_fault=True) == 0
        before = locked()
        with obtained(Asked()):
            assert locked() > before
        assert locked() == before
        ranges = memory.locked_before()
        assert any(pages.start <= address < pages.end and pages.on_fault for pages in ranges)
        del word


@pytest.mark.usefixtures("realtime_rights")
def test_a_program_that_had_locked_everything_keeps_it() -> None:
    try:
        assert calls.lock_all() == 0
        with obtained(Asked()) as realtime:
            assert realtime.report["obtained"]["locked_bytes"] > 0
        assert locked() > 0
        assert memory.locked_before() is None
    finally:
        calls.unlock_all()


@pytest.mark.usefixtures("realtime_rights")
def test_a_thread_that_comes_after_the_end_stays_as_it_is() -> None:
    with obtained(Asked()) as realtime:
        pass
    assert not in_thread(realtime.enter_thread).is_fifo


@pytest.mark.parametrize("kernel", ["this", "before 5.14"])
@pytest.mark.parametrize("order", ["whole", "reversed", "column"])
def test_prefault_loads_all_pages_and_keeps_the_content(
    monkeypatch: pytest.MonkeyPatch, kernel: str, order: str
) -> None:
    if kernel != "this":
        monkeypatch.setattr(calls, "MADV_POPULATE_WRITE", 9999)
    pages = 256
    with mmap.mmap(-1, pages * mmap.PAGESIZE) as region:
        whole = np.frombuffer(region, np.uint8)
        whole[mmap.PAGESIZE * 7 + 5] = 77
        table = whole.reshape(pages, mmap.PAGESIZE)
        view = {"whole": whole, "reversed": whole[::-1], "column": table[:, 1]}[order]
        Realtime(Asked(), active=True).prefault(view, np.zeros(0))
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
        whole[:: mmap.PAGESIZE] += 1
        faults = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before
        assert faults < pages // 4
        assert whole.sum() == pages + 77
        del whole, table, view


def test_the_stack_of_an_entered_thread_is_there() -> None:
    def body() -> int:
        with obtained(Asked()) as realtime:
            realtime.enter_thread()
            below = calls.stack_top() - 400 * KIB
        smaps = Path("/proc/self/smaps").read_text()
        mappings = re.findall(r"^([0-9a-f]+)-([0-9a-f]+) (?:.*\n)+?Rss: +(\d+)", smaps, re.M)
        return next(int(kib) for start, end, kib in mappings if int(start, 16) <= below < int(end, 16))

    assert in_thread(body) >= 256


@pytest.mark.parametrize(
    ("asked", "virtual"), [("off", False), ("enforce", True), ("try", True), ("off", True)]
)
def test_off_and_virtual_time_touch_nothing(asked: str, virtual: bool) -> None:
    before, threads = state(), all_threads()
    with obtained(Asked(asked, priority=99, cpu=4095), virtual=virtual) as realtime:
        realtime.enter_thread()
        realtime.prefault(np.zeros(10))
        assert state() == before
        assert all_threads() <= threads
        realtime.leave_thread()
        assert realtime.messages == []
        assert (realtime.report == {}) == virtual
    assert state() == before
    assert all_threads() <= threads


CHILD = """
import json, os, resource, sys, threading
from rig.core.errors import RealtimeError
from rig.realtime.scheduling import _calls as calls, facts, obtained
from rig.realtime.scheduling._thread import ThreadState
from tests.conformance.scheduled import Asked, all_threads, in_thread, state, wait_for_state

user = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
if user:
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    os.setgroups([])
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)
calls._call("prctl", 4, 1, 0, 0, 0)  # PR_SET_DUMPABLE, for /proc/self/fd
def now():
    return state(), all_threads(), len(os.listdir("/proc/self/fd"))
before = now()
found = {}
"""


def run_in_child(body: str, user: int = 65534) -> dict[str, Any]:
    """Run lines that fill `found` in a process of a user; its state must be restored at the end."""
    if os.geteuid() != 0:
        pytest.skip("only root can give up rights")
    check = "assert wait_for_state(before, now), (before, now())\nprint(json.dumps(found))\n"
    command = [sys.executable, "-c", f"{CHILD}{textwrap.dedent(body)}\n{check}", str(user)]
    cwd = Path(__file__).parents[3]
    done = subprocess.run(command, capture_output=True, text=True, timeout=CHILD_S, check=False, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


TRY = """
with obtained(Asked("try", cpu=0)) as realtime:
    found["entered"] = in_thread(realtime.enter_thread).as_mapping()
    found["messages"] = realtime.messages
    found["report"] = realtime.report
    found["locked"] = facts.status_kilobytes("VmLck")
"""
ENFORCE = """
try:
    with obtained(Asked("enforce")):
        found["error"] = None
except RealtimeError as error:
    found["error"] = str(error)
    found["as before"] = wait_for_state(before, now)
"""


@pytest.fixture(scope="module")
def ordinary_user() -> dict[str, Any]:
    return run_in_child(TRY + ENFORCE)


def test_ordinary_user_runs_with_every_refusal_reported(ordinary_user: dict[str, Any]) -> None:
    found = ordinary_user
    assert found["entered"]["policy"] == "SCHED_OTHER"
    assert found["entered"]["timer_slack_ns"] == 1
    assert found["entered"]["cpus"] == [0]
    assert found["locked"] == 0
    policy, memory_refused, *rest = found["messages"]
    assert policy.startswith("SCHED_FIFO 70 is refused: the limit of real-time priorities is 0")
    assert "rtprio 98" in policy
    assert memory_refused.startswith("memory is not locked: the limit is 0 MiB")
    assert "memlock unlimited" in memory_refused
    assert len(rest) <= 1
    assert len(found["report"]["refusals"]) == len(found["messages"])
    assert found["report"]["obtained"]["policy"] == "SCHED_OTHER"


def test_enforce_names_all_that_is_missing_and_changes_nothing(ordinary_user: dict[str, Any]) -> None:
    found = ordinary_user
    for text in ("SCHED_FIFO 70", "memory is not locked", "limits.d", 'host.realtime = "try"'):
        assert text in found["error"]
    assert found["error"].count(refusals.LIMITS_COMMAND) == 1  # one command for both limits
    assert found["as before"]


def test_rights_that_went_meanwhile_leave_an_ordinary_thread() -> None:
    """Without rights the kernel keeps the flag "children do not inherit", which has no effect on such a thread."""
    found = run_in_child(
        """
        def body():
            with obtained(Asked("try")) as realtime:
                found["entered"] = realtime.enter_thread().as_mapping()
                os.setresuid(65534, 65534, 65534)
                realtime.leave_thread()
            return ThreadState.here().as_mapping()
        found["after"] = in_thread(body)
        """,
        user=0,
    )
    if found["entered"]["policy"] != "SCHED_FIFO":
        pytest.skip("this process may not schedule in real time")
    assert (found["after"]["policy"], found["after"]["priority"]) == ("SCHED_OTHER", 0)


def test_memory_is_not_locked_near_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the limit the kernel would refuse every further allocation, in the middle of a trial."""
    size = facts.status_kilobytes("VmSize") * KIB
    monkeypatch.setattr(Rights, "here", lambda: rights(locked_limit=size + 2**20))
    monkeypatch.setattr(calls, "lock_all", lambda: pytest.fail("it was tried"))
    refusal = memory.take()
    assert "memory is not locked: the limit is" in str(refusal)
    assert "memlock unlimited" in refusal.remedy


def rights(**changes: Any) -> Rights:
    known: dict[str, Any] = dict.fromkeys(("priority_limit", "capabilities"), 0)
    return Rights(**{**known, "user": "ada", "groups": frozenset(), "locked_limit": 65536, **changes})


def tree(root: Path, **files: str) -> Path:
    for name, text in files.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    return root


def test_rights_follow_limits_and_capabilities() -> None:
    assert rights(priority_limit=None).may_schedule(98)
    assert rights(priority_limit=98).may_schedule(98)
    assert not rights(priority_limit=97).may_schedule(98)
    assert rights(capabilities=1 << 23).may_schedule(98)
    assert rights(capabilities=1 << 14).may_lock(2**40)
    assert not rights().may_lock(2**20)


def test_a_limit_below_the_priority_is_named() -> None:
    refusal = refusals.of_policy(80, rights(priority_limit=79), errno.EPERM)
    assert "the limit of real-time priorities is 79" in str(refusal)
    assert refusal.remedy.endswith(f": {refusals.LIMITS_COMMAND}")


def test_a_refusal_that_no_limit_explains_points_at_containers_and_groups(tmp_path: Path) -> None:
    refusal = refusals.of_policy(80, rights(priority_limit=98), errno.EPERM, tmp_path)
    assert "Operation not permitted" in str(refusal)
    assert "--cap-add=SYS_NICE" in str(refusal)


def test_idle_states_are_missed_only_where_there_are_any(tmp_path: Path) -> None:
    assert refusals.of_idle(errno.ENOENT, tmp_path) is None
    tree(tmp_path, sys__devices__system__cpu__cpuidle__current_driver="intel_idle")
    assert refusals.of_idle(errno.ENOENT, tmp_path) is not None
    assert "--print-udev" in str(refusals.of_idle(errno.EACCES, tmp_path))


def test_a_processor_that_does_not_run_is_named_with_those_that_do(tmp_path: Path) -> None:
    tree(tmp_path, sys__devices__system__cpu__online="0-1,4")
    assert "this computer has 0, 1, 4" in str(refusals.of_processor(2, errno.EINVAL, tmp_path))
    assert "Invalid argument" in str(refusals.of_processor(4, errno.EINVAL, tmp_path))


@pytest.mark.parametrize(
    ("version", "extra", "kind"),
    [
        ("#1 SMP PREEMPT_RT Debian", {}, "PREEMPT_RT"),
        ("#1 SMP PREEMPT", {}, "PREEMPT"),
        ("#1 SMP", {}, "none"),
        ("#1 SMP", {"sys__kernel__realtime": "1"}, "PREEMPT_RT"),
        (
            "#1 SMP PREEMPT_DYNAMIC",
            {"sys__kernel__debug__sched__preempt": "none voluntary (full)"},
            "PREEMPT_DYNAMIC (full)",
        ),
        ("#1 SMP PREEMPT_DYNAMIC", {"proc__cmdline": "quiet preempt=none"}, "PREEMPT_DYNAMIC (none)"),
    ],
)
def test_kinds_of_preemption(tmp_path: Path, version: str, extra: Any, kind: str) -> None:
    assert facts.preemption(tree(tmp_path, proc__sys__kernel__version=version, **extra)) == kind
