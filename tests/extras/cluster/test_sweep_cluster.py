"""A sweep on a Dask cluster gives the same bits as in one process, and survives the death of a worker.

Scheduler and workers are processes of their own where workers come, go or are killed, as on a real cluster; for the
other tests they share one. The process of the tests is only a client.
"""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from rig.core.errors import ConfigError, RigError
from rig.experiments import sweep
from rig.experiments.sweep import Task, TaskError, code_version
from rig.extras.cluster import cluster as clusters
from tests.conformance import sweep_work
from tests.conformance.started import LEASH
from tests.conformance.sweep_work import keys_in, sines_of, text

ROOT = Path(__file__).parents[3]
START_S = 30.0


pytestmark = pytest.mark.skipif(not find_spec("distributed"), reason="distributed is not installed")


class Cluster:
    """A scheduler and workers, shared by all tests: each test requests its number of workers (`have`)."""

    def __init__(self, directory: Any) -> None:
        self._directory = directory
        self._numbers = itertools.count()
        self.scheduler = None
        self.workers = []

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process is not None:
                _end(process)

    def have(self, number: int) -> None:
        """Wait until the scheduler has this number of workers."""
        self._have_a_scheduler()
        alive = [worker for worker in self.workers if worker.poll() is None]
        for worker in alive[number:]:
            _end(worker)
        self.workers = alive[:number]
        while len(self.workers) < number:
            self.add_worker()
        until = time.monotonic() + START_S
        while self.ask(lambda dask_scheduler: len(dask_scheduler.workers)) != number:
            assert time.monotonic() < until, "the workers did not come, or did not go"
            time.sleep(0.02)

    def ask(self, question: Any) -> Any:
        """Run a function on the scheduler and return its result."""
        from distributed import Client  # noqa: PLC0415

        with Client(self.address, set_as_default=False) as client:
            return client.run_on_scheduler(question)

    def add_worker(self) -> None:
        options = ["--nthreads", "1", "--local-directory", str(self._directory), "--no-nanny"]
        self.workers.append(self._start_dask("worker", self.address, *options))

    def _have_a_scheduler(self) -> None:
        if self.scheduler is not None and self.scheduler.poll() is None:
            return
        while self.workers:
            _end(self.workers.pop())
        facts = self._directory / f"scheduler-{next(self._numbers)}.json"
        self.scheduler = self._start_scheduler(facts)
        until = time.monotonic() + START_S
        while not facts.exists() or not facts.read_text().endswith("}"):
            assert time.monotonic() < until, "the scheduler did not start"
            time.sleep(0.02)
        self.address = json.loads(facts.read_text())["address"]

    def _start_scheduler(self, facts: Path) -> Any:
        return self._start_dask("scheduler", "--port", "0", "--scheduler-file", str(facts), "--no-jupyter")

    def _start_dask(self, command: str, *options: str) -> Any:
        module = f"distributed.cli.dask_{command}"
        return self._start("-m", module, "--host", "127.0.0.1", "--no-dashboard", *options)

    def _start(self, *arguments: str) -> Any:
        options: Any = {"cwd": self._directory, "env": {**os.environ, "PYTHONPATH": str(ROOT)}}
        with (self._directory / f"log-{next(self._numbers)}").open("wb") as log:
            return subprocess.Popen([*LEASH, sys.executable, *arguments], stdout=log, stderr=log, **options)


def _end(process: Any) -> None:
    process.kill()
    process.wait()


IN_ONE_PROCESS = """
import json, sys, threading
from distributed import LocalCluster
options = {"n_workers": 2, "threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None}
with LocalCluster(processes=False, protocol="tcp://", local_directory=".", **options) as cluster:
    with open(sys.argv[1], "w") as file:
        json.dump({"address": cluster.scheduler_address}, file)
    threading.Event().wait()
"""


class SmallCluster(Cluster):
    """A scheduler with two workers in one process: starting one takes a third of the time that three take."""

    def have(self, number: int) -> None:
        assert number == 2
        self._have_a_scheduler()

    def _start_scheduler(self, facts: Path) -> Any:
        return self._start("-c", IN_ONE_PROCESS, str(facts))


@pytest.fixture(scope="module")
def small_cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    started = SmallCluster(tmp_path_factory.mktemp("small-cluster"))
    yield started
    started.end()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    started = Cluster(tmp_path_factory.mktemp("cluster"))
    yield started
    started.end()


def assert_nothing_lost_and_nothing_twice(results: Any, journal: Any, tasks: Any) -> None:
    at_once = [Task(task.key, sweep_work.sines, {"seed": task.payload["seed"]}) for task in tasks]
    assert text(results) == text(sweep.run(at_once, workers=1))
    assert sorted(keys_in(journal)) == sorted(task.key for task in tasks)


def test_two_workers_give_the_bits_of_one_process(small_cluster: Any, tmp_path: Path) -> None:
    small_cluster.have(2)
    tasks, seen = sines_of(30), []
    options: Any = {"scheduler": small_cluster.address, "unit": "trials", "watch": seen.append}
    results = sweep.run(tasks, journal=tmp_path / "j", **options)
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)
    assert [seen[-1].workers, seen[-1].units] == [2, 300]


def test_a_task_that_fails_there_is_named_here(small_cluster: Any) -> None:
    small_cluster.have(2)
    tasks = [Task(f"number {i}", sweep_work.raise_as_given, {"number": i}) for i in range(20)]
    tasks[7] = replace(tasks[7], payload={"number": 7, "raises": "ours"})
    with pytest.raises(TaskError, match="task number 7 failed: this wall is out of reach") as caught:
        sweep.run(tasks, scheduler=small_cluster.address)
    assert caught.value.remedy == "lower the stiffness"
    assert "sweep_work.py" in caught.value.__notes__[0]
    assert 7 not in list(caught.value.results)


def test_another_version_on_workers_is_refused(small_cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    small_cluster.have(2)
    ours = code_version()
    monkeypatch.setattr("rig.experiments.sweep._coordinator.code_version", lambda: "9.9.9+0123456789ab")
    with pytest.raises(ConfigError) as caught:
        sweep.run(sines_of(4), scheduler=small_cluster.address)
    assert f"runs haptic-rig {ours}, this is 9.9.9+0123456789ab" in caught.value.message


@pytest.mark.exhaustive("::test_another_version_on_workers_is_refused")
def test_work_that_the_workers_do_not_have_is_refused(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.have(2)
    (tmp_path / "only_here.py").write_text("def work(payload):\n    return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    task = Task("all", import_module("only_here").work, {})
    with pytest.raises(ConfigError, match=r"cannot run this .*install this version of haptic-rig"):
        sweep.run([task], scheduler=cluster.address)


@pytest.mark.exhaustive("::test_two_workers_give_the_bits_of_one_process")
def test_a_killed_worker_loses_nothing_and_duplicates_nothing(cluster: Any, tmp_path: Path) -> None:
    cluster.have(2)
    tasks = sines_of(40, wait_s=0.03)

    def watch(progress: Any) -> None:
        if progress.done >= 10 and cluster.workers[0].poll() is None:
            assert progress.workers == 2
            cluster.workers[0].kill()

    results = sweep.run(tasks, journal=tmp_path / "j", scheduler=cluster.address, watch=watch)
    assert cluster.workers[0].wait() == -signal.SIGKILL
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)


@pytest.mark.exhaustive("::test_a_task_that_fails_there_is_named_here")
def test_a_task_that_kills_every_worker_is_named(cluster: Any, tmp_path: Path) -> None:
    cluster.have(1)
    allowed = cluster.ask(lambda dask_scheduler: dask_scheduler.allowed_failures)
    cluster.ask(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0))
    tasks = [Task("murder", sweep_work.always_kill_the_worker, {})]
    try:
        with pytest.raises(TaskError, match=r"failed: it ended every worker that ran it \(1 workers\)"):
            sweep.run(tasks, scheduler=cluster.address, journal=tmp_path / "j")
    finally:
        cluster.ask(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", allowed))
    assert keys_in(tmp_path / "j") == []


@pytest.mark.exhaustive("::test_two_workers_give_the_bits_of_one_process")
def test_a_sweep_waits_for_workers(cluster: Any, tmp_path: Path) -> None:
    cluster.have(0)
    tasks, waited = sines_of(4), []

    def watch(progress: Any) -> None:
        if not progress.workers and not cluster.workers:
            waited.append(progress)
            cluster.add_worker()

    results = sweep.run(tasks, journal=tmp_path / "j", scheduler=cluster.address, watch=watch)
    assert waited
    assert_nothing_lost_and_nothing_twice(results, tmp_path / "j", tasks)


def test_a_scheduler_that_dies_ends_the_sweep_with_what_is_done(small_cluster: Any, tmp_path: Path) -> None:
    small_cluster.have(2)
    address = small_cluster.address

    def watch(progress: Any) -> None:
        if progress.done >= 3:
            small_cluster.scheduler.kill()

    with pytest.raises(RigError, match=f"the connection to the Dask scheduler at {address} was lost"):
        sweep.run(sines_of(200, wait_s=0.05), journal=tmp_path / "j", scheduler=address, watch=watch)
    assert 3 <= len(keys_in(tmp_path / "j")) < 200


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x"])
def test_without_a_scheduler_the_remedy_starts_one(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "CONNECT_S", 0.1)
    with pytest.raises(ConfigError, match=r"no reply from a Dask scheduler at .*with `dask scheduler`"):
        sweep.run(sines_of(2), scheduler=address)
