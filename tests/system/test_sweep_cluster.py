"""A sweep on a Dask cluster: the same bits as in one process, and a worker that dies takes nothing with it.

Scheduler and workers are processes of their own, as on a real cluster; this one is only a client.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from rig.core.errors import ConfigError, RigError
from rig.experiments import sweep
from rig.experiments.sweep import SweepStoppedError, Task, TaskError, executors
from rig.experiments.sweep import cluster as clusters
from rig.experiments.sweep.executors import as_json
from tests.conformance import sweep_work
from tests.conformance.started import LEASH

HERE = sweep_work.__name__
SINES, KILLS = f"{HERE}:sines", f"{HERE}:kill_the_worker"
ROOT = Path(__file__).parents[2]
START_S = 30.0


needs_distributed = pytest.mark.skipif(not find_spec("distributed"), reason="distributed is not installed")


class Cluster:
    """A scheduler and workers with one thread each, all on this machine; they end with the block."""

    def __init__(self, directory: Any, **environment: Any) -> None:
        self._directory = directory
        self._environment = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
        self._processes = []
        self.scheduler = None
        self.workers = []

    def __enter__(self) -> Any:
        facts = self._directory / "scheduler.json"
        self.scheduler = self._start(
            "dask_scheduler", "--port", "0", "--scheduler-file", str(facts), "--no-jupyter"
        )
        until = time.monotonic() + START_S
        while not facts.exists() or not facts.read_text().endswith("}"):
            assert time.monotonic() < until, "the scheduler did not start"
            time.sleep(0.02)
        self.address = json.loads(facts.read_text())["address"]
        return self

    def __exit__(self, *error: Any) -> None:
        # The group, since a nanny's worker would outlive it.
        for process in self._processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def add_worker(self, *, nanny: bool = False) -> None:
        options = [
            "--nthreads",
            "1",
            "--local-directory",
            str(self._directory),
            "--nanny" if nanny else "--no-nanny",
        ]
        self.workers.append(self._start("dask_worker", self.address, *options))

    def wait_for_workers(self) -> None:
        """Return when the scheduler knows them all."""
        from distributed import Client  # noqa: PLC0415

        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), timeout=START_S)

    def _start(self, command: Any, *arguments: Any) -> Any:
        log = (self._directory / f"log-{len(self._processes)}").open("wb")
        with log:
            process = subprocess.Popen(
                [
                    *LEASH,
                    sys.executable,
                    "-m",
                    f"distributed.cli.{command}",
                    "--host",
                    "127.0.0.1",
                    "--no-dashboard",
                    *arguments,
                ],
                cwd=self._directory,
                env=self._environment,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self._processes.append(process)
        return process


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Any]:
    with Cluster(tmp_path) as started:
        yield started


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Two workers that no test harms."""
    with Cluster(tmp_path_factory.mktemp("cluster")) as started:
        started.add_worker()
        started.add_worker()
        started.wait_for_workers()
        yield started


def sines(number: Any, **payload: Any) -> Any:
    return [Task(f"seed {seed}", {"seed": seed, **payload}) for seed in range(number)]


def text(results: Any) -> Any:
    return [as_json(result) for result in results]


def keys_in(journal: Any) -> Any:
    return [json.loads(line.partition(b" ")[2])["key"] for line in journal.read_bytes().splitlines()[1:]]


def assert_nothing_lost_and_nothing_twice(results: Any, journal: Any, tasks: Any) -> None:
    at_once = [Task(task.key, {"seed": task.payload["seed"]}) for task in tasks]
    assert text(results) == text(sweep.run(SINES, at_once, workers=1))
    assert sorted(keys_in(journal)) == sorted(task.key for task in tasks)


@needs_distributed
def test_two_workers_give_the_bits_of_one_process_and_small_tasks_travel_together(
    shared: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    batches, submit = [], clusters.Cluster.submit
    monkeypatch.setattr(
        clusters.Cluster, "submit", lambda self, batch: (batches.append(len(batch)), submit(self, batch))[1]
    )
    tasks, seen = sines(400), []
    options = {"journal": tmp_path / "j", "scheduler": shared.address, "unit": "trials", "watch": seen.append}
    results = sweep.run(SINES, tasks, **options)
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)
    assert [seen[-1].workers, seen[-1].units] == [2, 4000]
    assert sum(batches) == 400
    assert len(batches) < 40, "a task of 0.1 ms must not travel alone"


@needs_distributed
def test_a_worker_killed_in_the_middle_loses_nothing_and_duplicates_nothing(
    cluster: Any, tmp_path: Path
) -> None:
    cluster.add_worker()
    cluster.add_worker()
    cluster.wait_for_workers()
    tasks = sines(60, wait_s=0.05)

    def watch(progress: Any) -> None:
        if progress.done >= 10 and cluster.workers[0].poll() is None:
            assert progress.workers == 2
            cluster.workers[0].kill()

    results = sweep.run(SINES, tasks, journal=tmp_path / "j", scheduler=cluster.address, watch=watch)
    assert cluster.workers[0].wait() == -signal.SIGKILL
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)


@needs_distributed
def test_workers_that_die_under_a_task_and_are_started_again_by_their_nannies(
    cluster: Any, tmp_path: Path
) -> None:
    cluster.add_worker(nanny=True)
    cluster.add_worker(nanny=True)
    tasks = sines(30, wait_s=0.02)
    for number in (5, 20):
        tasks[number] = Task(f"dies {number}", {"seed": number, "dies": str(tmp_path / f"died {number}")})
    results = sweep.run(KILLS, tasks, journal=tmp_path / "j", scheduler=cluster.address)
    assert all((tmp_path / f"died {number}").exists() for number in (5, 20))
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)


@needs_distributed
def test_a_result_that_died_with_its_worker_before_it_was_fetched_is_computed_again(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.add_worker()
    fetch, fetched = clusters.Cluster._report, []

    def kill_before_the_first(self: Any, future: Any, batch: Any) -> Any:
        if not fetched:
            cluster.workers[0].kill()
            cluster.workers[0].wait()
            cluster.add_worker()
        fetched.append(fetch(self, future, batch))
        return fetched[-1]

    monkeypatch.setattr(clusters.Cluster, "_report", kill_before_the_first)
    monkeypatch.setattr(clusters, "GATHER_S", 0.2)
    tasks = sines(20)
    results = sweep.run(SINES, tasks, journal=tmp_path / "j", scheduler=cluster.address)
    assert fetched[0] is None, "the case was not met"
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)


@needs_distributed
@pytest.mark.signals
def test_ctrl_c_on_a_cluster_and_the_rest_in_this_process(shared: Any, tmp_path: Path) -> None:
    tasks = sines(60, wait_s=0.02)

    def watch(progress: Any) -> None:
        if progress.done >= 6 and not progress.stopping:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(SweepStoppedError) as caught:
        sweep.run(SINES, tasks, journal=tmp_path / "j", scheduler=shared.address, watch=watch)
    assert 6 <= caught.value.done < 60
    seen = []
    results = sweep.run(SINES, tasks, journal=tmp_path / "j", workers=2, watch=seen.append)
    assert seen[-1].kept == caught.value.done
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)


@needs_distributed
def test_a_task_that_fails_there_is_named_here(shared: Any) -> None:
    tasks = [Task(f"number {i}", {"number": i}) for i in range(20)]
    tasks[7] = Task("number 7", {"number": 7, "raises": "ours"})
    with pytest.raises(TaskError, match="task number 7 failed: this wall is out of reach") as caught:
        sweep.run(f"{HERE}:raise_when_told", tasks, scheduler=shared.address)
    assert caught.value.remedy == "lower the stiffness"
    assert "sweep_work.py" in caught.value.__notes__[0]
    assert 7 not in list(caught.value.results)


@needs_distributed
def test_another_haptic_rig_on_the_workers_is_refused_with_both_versions(
    shared: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = executors.code_version()
    monkeypatch.setattr("rig.experiments.sweep.tasks.code_version", lambda: "9.9.9+0123456789ab")
    with pytest.raises(ConfigError) as caught:
        sweep.run(SINES, sines(4), scheduler=shared.address)
    assert f"runs haptic-rig {ours}, this is 9.9.9+0123456789ab" in caught.value.message


@needs_distributed
def test_work_that_the_workers_do_not_have_is_refused(shared: Any) -> None:
    with pytest.raises(ConfigError, match="'nowhere:work' cannot be imported"):
        sweep.run("nowhere:work", sines(4), scheduler=shared.address)


@needs_distributed
def test_a_task_that_kills_every_worker_is_named(tmp_path: Path) -> None:
    with Cluster(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0") as cluster:
        cluster.add_worker()
        with pytest.raises(
            TaskError, match="task murder failed: it ended every worker that tried it, 1 in all"
        ):
            sweep.run(
                f"{HERE}:always_kill_the_worker",
                [Task("murder", {})],
                scheduler=cluster.address,
                journal=tmp_path / "j",
            )
    assert keys_in(tmp_path / "j") == []


@needs_distributed
def test_a_sweep_waits_for_workers_and_says_so(cluster: Any, tmp_path: Path) -> None:
    tasks, waited = sines(4), []

    def watch(progress: Any) -> None:
        if not progress.workers and not cluster.workers:
            waited.append(progress)
            cluster.add_worker()

    results = sweep.run(SINES, tasks, journal=tmp_path / "j", scheduler=cluster.address, watch=watch)
    assert waited
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)


@needs_distributed
def test_a_scheduler_that_dies_ends_the_sweep_with_what_is_done(cluster: Any, tmp_path: Path) -> None:
    cluster.add_worker()

    def watch(progress: Any) -> None:
        if progress.done >= 3:
            cluster.scheduler.kill()

    with pytest.raises(RigError, match=f"the Dask scheduler at {cluster.address} is gone"):
        sweep.run(
            SINES, sines(200, wait_s=0.05), journal=tmp_path / "j", scheduler=cluster.address, watch=watch
        )
    assert 3 <= len(keys_in(tmp_path / "j")) < 200


@needs_distributed
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x"])
def test_no_scheduler_there_is_said_with_the_remedy(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "CONNECT_S", 0.5)
    with pytest.raises(ConfigError, match=r"no Dask scheduler answers at .*start one with `dask scheduler`"):
        sweep.run(SINES, sines(2), scheduler=address)


def test_without_distributed_the_remedy_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"install it: pip install 'haptic-rig\[cluster\]'"):
        sweep.run(SINES, sines(2), scheduler="tcp://127.0.0.1:1")
