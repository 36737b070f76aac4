"""A sweep gives the same results to the last bit however it was interrupted, and keeps all finished tasks.

Clusters are tested in `tests/extras/cluster/test_sweep_cluster.py`.
"""

import io
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.cli.progress import SweepBar
from rig.core.errors import ConfigError, RecordingError, StoppedError
from rig.experiments import sweep
from rig.experiments.sweep import Progress, SweepStoppedError, Task, TaskError
from rig.experiments.sweep import _journal as journals
from rig.experiments.sweep._executors import Threads, as_json
from rig.recording import lines
from tests.conformance import sweep_work
from tests.conformance.started import started
from tests.conformance.sweep_work import keys_in, lines_of, sines_of, text

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("error", [OSError("the sources cannot be read"), SystemExit(3)])
def test_a_thread_returns_what_a_call_raises_and_serves_the_next_call(error: BaseException) -> None:
    """Otherwise the coordinator would wait for the result forever."""

    def fail() -> None:
        raise error

    threads = Threads(1)
    failed, good = threads.submit(fail), threads.submit(int, "7")
    assert failed.exception(timeout=60.0) is error
    assert good.result(timeout=60.0) == 7
    threads.close()


def marks(number: Any, log: Any, **payload: Any) -> Any:
    work = sweep_work.leave_a_mark
    return [Task(f"{name}", work, {"name": f"{name}", "log": str(log), **payload}) for name in range(number)]


def numbered_tasks(number: int, *payloads: dict[str, Any]) -> list[Task]:
    """Return tasks of `raise_as_given`; `payloads` are added to the payloads of the first ones."""
    more = [*payloads, *({} for _ in range(number - len(payloads)))]
    work = sweep_work.raise_as_given
    return [Task(f"number {i}", work, {"number": i, **one}) for i, one in enumerate(more)]


# Order and bits --------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 2, 4])
@pytest.mark.parametrize("kept", ["in memory", "in a journal"])
def test_results_are_those_of_a_plain_loop_in_its_order(workers: int, kept: str, tmp_path: Path) -> None:
    tasks = sines_of(16, wait_s=0.004)
    journal = tmp_path / "j" if kept == "in a journal" else None
    results = sweep.run(tasks, workers=workers, journal=journal)
    assert text(results) == text(sweep_work.sines(dict(task.payload)) for task in tasks)
    assert results.tasks == tasks
    assert [len(results), text(results[7:9]), results[-1]] == [16, text(results)[7:9], list(results)[-1]]


def test_values_that_json_cannot_hold_have_one_form_from_memory_and_journal(tmp_path: Path) -> None:
    payload = {"pair": (1, 2.5), "none": None, "sorted": {"b": 1, "a": math.inf}}
    tasks = [Task("odd", sweep_work.odd_values, payload)]
    (fresh,) = sweep.run(tasks)
    (kept,) = sweep.run(tasks, journal=tmp_path / "j")
    (resumed,) = sweep.run(tasks, journal=tmp_path / "j")
    assert as_json(fresh) == as_json(kept) == as_json(resumed)
    assert math.isnan(fresh["not a number"])
    assert math.copysign(1.0, fresh["zero"]) == -1.0
    assert [fresh["smallest"], fresh["infinite"]] == [5e-324, [math.inf, -math.inf]]
    assert [fresh["tuple"], fresh["whole"], fresh["text"]] == [[1, 2], 2**53 + 1, "µ\u2028\ud800"]
    assert fresh["given"] == {"pair": [1, 2.5], "none": None, "sorted": {"a": math.inf, "b": 1}}


def test_heavy_tasks_go_first_and_the_order_of_results_stays(tmp_path: Path) -> None:
    log = tmp_path / "log"
    tasks = [replace(task, weight=weight) for task, weight in zip(marks(3, log), (1, 9, 3), strict=True)]
    assert list(sweep.run(tasks, workers=1)) == ["0", "1", "2"]
    assert log.read_text().split() == ["1", "2", "0"]


def test_two_threads_run_two_tasks_at_the_same_time() -> None:
    # Each can end only when the other has begun.
    work = sweep_work.open_one_and_wait_for_another
    tasks = [Task(a, work, {"opens": f"pair {a}", "waits_for": f"pair {b}"}) for a, b in ["xy", "yx"]]
    assert list(sweep.run(tasks, workers=2)) == ["pair x", "pair y"]


def test_a_sweep_of_nothing_and_one_outside_the_main_thread() -> None:
    assert list(sweep.run([])) == []
    with ThreadPoolExecutor(1) as thread:
        assert len(thread.submit(sweep.run, sines_of(3)).result()) == 3


# The journal -----------------------------------------------------------------------------------------


@pytest.mark.exhaustive("::test_a_damaged_journal_is_completed_or_refused_not_trusted")
def test_kill_9_loses_at_most_the_tasks_in_flight(tmp_path: Path) -> None:
    journal, log, workers = tmp_path / "j", tmp_path / "log", 2
    program = (
        "from pathlib import Path; from rig.experiments import sweep\n"
        "from tests.rig.experiments.test_sweep import marks\n"
        f"sweep.run(marks(80, {str(log)!r}, wait_s=0.01), workers={workers}, journal=Path({str(journal)!r}))"
    )
    tasks = marks(80, log, wait_s=0.01)
    ended = False
    for _ in range(2):
        before = len(keys_in(journal)) if journal.exists() else 0
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        with started(sys.executable, "-c", program, cwd=ROOT, env=environment) as process:
            while not ended and (not journal.exists() or len(keys_in(journal)) < before + 20):
                ended = process.poll() is not None
                time.sleep(0.005)
    assert not ended, "it should have been killed in the middle each time"
    kept = keys_in(journal)
    assert 40 <= len(kept) < 80
    assert list(sweep.run(tasks, journal=journal)) == [task.key for task in tasks]
    assert sorted(keys_in(journal)) == sorted(task.key for task in tasks)
    assert 80 <= len(log.read_text().split()) <= 80 + 2 * workers


FEW = sines_of(6)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("sweep") / "j"
    return path, text(sweep.run(FEW, journal=path)), path.read_bytes()


@given(data=st.data())
def test_a_damaged_journal_is_completed_or_refused_not_trusted(finished: Any, data: st.DataObject) -> None:
    path, results, whole = finished
    path = path.with_name("damaged")
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)), label="cut at")])
    for place in data.draw(st.lists(st.integers(0, max(0, len(damaged) - 1)), max_size=3), label="flipped"):
        if damaged:
            damaged[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(damaged)
    header = whole.index(b"\n") + 1
    good = set(lines_of(damaged)[1:]) & set(lines_of(whole))
    seen = []
    if bytes(damaged[:header]) != whole[:header] and not whole.startswith(damaged):
        with pytest.raises(RecordingError, match="first line is damaged"):
            sweep.run(FEW, journal=path, workers=1)
        assert path.read_bytes() == damaged
        return
    found = sweep.run(FEW, journal=path, workers=1, watch=seen.append)
    assert text(found) == results
    assert seen[-1].kept == len(good)
    lines = lines_of(path.read_bytes())
    assert all(lines.count(line) == 1 for line in lines_of(whole))
    assert len(lines) == len(FEW) + 1 + seen[-1].damaged


def test_a_finished_journal_needs_neither_work_nor_cluster(finished: Any) -> None:
    path, results, whole = finished
    seen = []
    again = sweep.run(FEW, journal=path, scheduler="tcp://127.0.0.1:1", watch=seen.append)
    assert text(again) == results
    assert [(p.done, p.kept, p.fraction, p.seconds_left) for p in seen] == [(6, 6, 1.0, 0.0)]
    assert path.read_bytes() == whole


@pytest.mark.parametrize(
    ("tasks", "differs"),
    [
        ([replace(task, work=sweep_work.large) for task in FEW], "work: "),
        (FEW[:5], "tasks: 6 in the file, 5 now"),
        ([*FEW[:3], replace(FEW[3], payload={"seed": 33}), *FEW[4:]], "a task after the first"),
        ([replace(FEW[0], payload={"wait_s": 0.5}), *FEW[1:]], "first.payload.seed: 0 in the file, null now"),
        ([replace(FEW[0], key="first"), *FEW[1:]], 'first.key: "seed 0" in the file, "first" now'),
    ],
)
def test_the_journal_of_another_plan_is_refused_by_name(finished: Any, tasks: Any, differs: str) -> None:
    path, _, whole = finished
    with pytest.raises(ConfigError) as caught:
        sweep.run(tasks, journal=path)
    assert f"{path} belongs to another plan: {differs}" in str(caught.value)
    assert path.read_bytes() == whole


def test_a_journal_of_other_code_names_both_versions(finished: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.experiments.sweep._tasks.code_version", lambda: "9.9.9+0123456789ab")
    with pytest.raises(ConfigError, match=r'version: "0\.\d.*" in the file, "9\.9\.9\+0123456789ab" now'):
        sweep.run(FEW, journal=finished[0])


def test_a_file_that_is_no_journal_is_refused_and_left_alone(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="make the directory first"):
        sweep.run(FEW, journal=tmp_path / "none" / "j")
    path = tmp_path / "experiment.toml"
    path.write_text("[wall]\nstiffness = 300.0\n")
    with pytest.raises(RecordingError, match="not a file of task results"):
        sweep.run(FEW, journal=path)
    assert path.read_text() == "[wall]\nstiffness = 300.0\n"


def test_one_process_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "j"
    sweep.run(FEW, journal=path)
    header = json.loads(path.read_bytes().splitlines()[0].partition(b" ")[2])
    held = journals.Journal(path, header, [task.key for task in FEW])
    with pytest.raises(RecordingError, match="another process is writing"):
        sweep.run(FEW, journal=path)
    held.close()
    assert len(sweep.run(FEW, journal=path)) == 6


def test_the_disk_is_synced_at_times_and_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(lines.os, "fsync", synced.append)
    started = time.monotonic()
    sweep.run(sines_of(300), journal=tmp_path / "j")
    assert 3 <= len(synced) <= 4 + (time.monotonic() - started) / lines.SYNC_S


def test_memory_does_not_grow_with_the_results(tmp_path: Path) -> None:
    def peak(number: Any) -> Any:
        tasks = [Task(str(i), sweep_work.large, {"letters": 20_000}) for i in range(number)]
        tracemalloc.start()
        results = sweep.run(tasks, journal=tmp_path / f"j{number}", workers=2)
        assert sum(len(result) for result in results) == 20_000 * number
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(10)
    assert peak(250) - peak(50) < 1_000_000  # of 4 MB


# Ctrl-C ----------------------------------------------------------------------------------------------


def interrupt_at(done: Any) -> Any:
    """Return a progress callback that sends Ctrl-C once, after `done` tasks."""
    pressed = []

    def watch(progress: Progress) -> None:
        if progress.done >= done and not pressed:
            pressed.append(progress)
            os.kill(os.getpid(), signal.SIGINT)

    return watch


@pytest.mark.signals
def test_ctrl_c_after_the_last_task_is_reported_too() -> None:
    with pytest.raises(SweepStoppedError, match="3 of 3 tasks are done"):
        sweep.run(sines_of(3), workers=1, watch=interrupt_at(3))


@pytest.mark.parametrize("kept", ["in memory", "in a journal"])
@pytest.mark.signals
def test_ctrl_c_keeps_finished_and_running_tasks_and_a_command_resumes(kept: str, tmp_path: Path) -> None:
    journal, log = tmp_path / "j" if kept == "in a journal" else None, tmp_path / "log"
    tasks = marks(12, log, wait_s=0.02)
    with pytest.raises(SweepStoppedError) as caught:
        sweep.run(tasks, journal=journal, workers=2, watch=interrupt_at(3))
    error = caught.value
    assert isinstance(error, StoppedError)
    assert 3 <= error.done < error.total == 12
    keys = sorted(task.key for task in error.results.tasks)
    assert sorted(error.results) == sorted(log.read_text().split()) == keys
    assert f"{error.done} of 12 tasks are done" in error.message
    if journal is not None:
        assert "run the same command again" in error.remedy
        assert list(sweep.run(tasks, journal=journal, workers=2)) == [task.key for task in tasks]
        assert sorted(log.read_text().split()) == sorted(task.key for task in tasks)  # none twice


@pytest.mark.signals
def test_a_second_ctrl_c_does_not_wait_for_what_is_running_and_neither_does_the_program() -> None:
    program = (
        "import sys; from rig.experiments import sweep; from tests.conformance.sweep_work import wait_for_ever\n"
        "sweep.run([sweep.Task('slow', wait_for_ever, {})], watch=lambda p: print(p.stopping, flush=True))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    options: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": environment}
    with started(sys.executable, "-c", program, cwd=ROOT, **options) as process:
        for stopping in ("False", "True"):
            while process.stdout.readline().strip() != stopping:
                assert process.poll() is None
            process.send_signal(signal.SIGINT)
        assert "SweepStoppedError: stopped; 0 of 1 tasks are done" in process.communicate(timeout=60.0)[1]


@pytest.mark.signals
def test_ctrl_c_ends_a_watcher_that_blocks_as_a_stopped_terminal_does(tmp_path: Path) -> None:
    ended = []

    def watch(progress: Progress) -> None:
        for _ in range(2):  # the first is only noted: nothing looks for it while this runs
            signal.raise_signal(signal.SIGINT)
        ended.append(threading.Event().wait(10.0))

    with pytest.raises(SweepStoppedError, match="tasks are done and stored in"):
        sweep.run(sines_of(3), journal=tmp_path / "j", watch=watch)
    assert not ended
    assert len(sweep.run(sines_of(3), journal=tmp_path / "j")) == 3


def test_an_error_of_the_watcher_comes_through_and_what_is_done_is_kept(tmp_path: Path) -> None:
    def watch(progress: Any) -> None:
        if progress.done >= 3:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        sweep.run(sines_of(8, wait_s=0.01), journal=tmp_path / "j", workers=2, watch=watch)
    assert len(keys_in(tmp_path / "j")) >= 3


# Tasks that fail, and what cannot be meant -----------------------------------------------------------


@pytest.mark.parametrize(
    ("raises", "message", "remedy"),
    [
        ("ours", "this wall is out of reach", "lower the stiffness"),
        ("theirs", "ZeroDivisionError", ""),
        ("exit", "SystemExit: enough", ""),
        ("not JSON", "a object cannot be written as JSON", ""),
    ],
)
def test_a_task_that_raises_is_named_and_the_others_are_kept(
    raises: str, message: str, remedy: str, tmp_path: Path
) -> None:
    tasks = numbered_tasks(20)
    tasks[7] = replace(tasks[7], payload={"number": 7, "raises": raises})
    with pytest.raises(TaskError, match=f"task number 7 failed: .*{message}") as caught:
        sweep.run(tasks, journal=tmp_path / "j", workers=1)
    error = caught.value
    assert [error.key, error.remedy, error.exit_code] == ["number 7", remedy, 11]
    assert list(error.results) == [0, 1, 2, 3, 4, 5, 6]
    assert keys_in(tmp_path / "j") == [f"number {i}" for i in range(7)]
    assert "Traceback" in error.__notes__[0]
    assert "sweep_work.py" in error.__notes__[0] or raises == "not JSON"


def test_the_task_that_runs_beside_a_failing_one_is_kept() -> None:
    tasks = numbered_tasks(2, {"raises": "theirs"}, {"wait_s": 0.05})
    with pytest.raises(TaskError, match="1 of 2 tasks are done") as caught:
        sweep.run(tasks, workers=2)
    assert list(caught.value.results) == [1]


def test_of_two_failures_the_first_in_order_is_reported() -> None:
    # The later one fails at once, the earlier one while it is being waited for.
    tasks = numbered_tasks(2, {"wait_s": 0.05, "raises": "ours"}, {"raises": "theirs"})
    with pytest.raises(TaskError, match="task number 0 failed"):
        sweep.run(tasks, workers=2)


def test_impossible_arguments_are_refused() -> None:
    with pytest.raises(ConfigError, match="give 1 or more"):
        sweep.run(FEW, workers=0)
    with pytest.raises(ConfigError, match="a scheduler chooses"):
        sweep.run(FEW, workers=2, scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ValueError, match="same key"):
        sweep.run([FEW[0], FEW[0]])
    with pytest.raises(ValueError, match="weight"):
        sweep.run([replace(FEW[0], weight=0.0)])
    with pytest.raises(ValueError, match="is not defined at the top level of a module"):
        sweep.run([replace(FEW[0], work=lambda payload: payload)])
    with pytest.raises(TypeError, match="cannot be written as JSON"):
        sweep.run([replace(FEW[0], payload={"seed": object()})])


# Progress --------------------------------------------------------------------------------------------


def test_progress_counts_tasks_weights_and_units(tmp_path: Path) -> None:
    tasks, journal = [replace(task, weight=1.0 + i) for i, task in enumerate(sines_of(12))], tmp_path / "j"
    sweep.run(tasks, journal=journal)
    kept = 5
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[: 1 + kept]))
    seen: list[Progress] = []
    sweep.run(tasks, journal=journal, workers=2, unit="trials", watch=seen.append)
    first, last = seen[0], seen[-1]
    assert first.kept == last.kept == kept
    assert [last.done, last.running, last.fraction, last.seconds_left, last.workers] == [12, 0, 1.0, 0.0, 2]
    assert last.units == 10 * (12 - kept)  # five rows a task, two trials a row
    assert last.weight_done == pytest.approx(last.weight_total) == sum(range(1, 13))
    assert [p.fraction for p in seen] == sorted(p.fraction for p in seen)
    assert all(p.running <= 2 for p in seen)
    assert last.units_per_s == pytest.approx(last.units / last.elapsed_s)


def test_time_left_is_by_weight_and_only_from_this_run() -> None:
    common = {"total": 10, "weight_total": 100.0, "kept": 2, "weight_kept": 40.0}
    nothing_yet = Progress(**common, done=2, weight_done=40.0, elapsed_s=3.0)
    assert nothing_yet.seconds_left is None
    later = Progress(**common, done=5, weight_done=60.0, elapsed_s=10.0)
    assert later.seconds_left == pytest.approx(20.0)
    assert later.fraction == pytest.approx(0.6)


class Terminal(io.StringIO):
    def isatty(self) -> Any:
        return True


def test_without_a_terminal_or_for_json_there_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = {"weight_total": 510.0, "weight_done": 120.0, "units": 2480, "elapsed_s": 2.0}
    underway = Progress(total=510, done=120, running=2, workers=2, **numbers)
    for plain, stream, kind in (
        (False, None, "xterm"),
        (True, Terminal(), "xterm"),
        (False, Terminal(), "dumb"),
    ):
        with monkeypatch.context() as patch:
            patch.setenv("TERM", kind)
            if stream is not None:
                patch.setattr(sys, "stderr", stream)
            clock = iter([100.0, 101.0, 109.9, 110.1, 115.0, 121.0])
            patch.setattr("rig.cli.progress.time.monotonic", lambda: next(clock))  # noqa: B023
            with SweepBar("Z-width", unit="trials", plain=plain) as bar:
                for _ in range(5):
                    bar.watch(underway)
        written = capsys.readouterr().err if stream is None else stream.getvalue()
        assert written == 2 * "Z-width: 120 of 510 tasks, 1,240 trials/s, 6 s left\n"


def test_the_bar_shows_a_stop_missing_workers_and_damage(capsys: pytest.CaptureFixture[str]) -> None:
    bar, nothing = SweepBar("map", plain=True), Progress(total=9, weight_total=9.0)
    stopping = replace(nothing, running=2, workers=2, stopping=True)
    assert bar.text(stopping) == "0 of 9 tasks, stopping: waiting for 2 more"
    assert bar.text(nothing) == "0 of 9 tasks, waiting for workers"
    for _ in range(2):
        bar.watch(replace(nothing, damaged=3))
    assert capsys.readouterr().err == "rig: the journal has 3 damaged lines; their tasks run again\n"
