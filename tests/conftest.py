"""Settings of all tests, and checks on every run of them.

Property tests draw the same inputs in every run, on every machine and in every worker; `python -m tests.explore` draws
new ones. Ctrl-C interrupts a run, also one that a shell started with Ctrl-C ignored (`nohup … &`), and whatever the
tests start. A process that a test leaves behind fails the run.
"""

import ctypes
import functools
import gc
import mmap
import os
import random
import shutil
import signal
import sys
import uuid
from collections.abc import Generator
from contextlib import suppress
from multiprocessing import forkserver, resource_tracker
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
from hypothesis.internal.constants_ast import Constants

from rig.core import program
from rig.core.errors import ConfigError
from tests.conformance.census import still_there

RUN = "HAPTIC_RIG_TEST_RUN"  # in the environment of whatever a run of the tests starts

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: as the command line does
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # before pyarrow, whose own keeps all memory
# Some images of containers set it: then some hundred processes compile the package, and each worker rewrites the
# asserts of every file, in every run.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
program.begin()

collect_ignore = ["lab_package"]  # a package of its own, whose tests run where it is installed

# No deadline and no check of speed: the first call of a kernel may compile, and another machine is slower.
EVERYWHERE = {
    "deadline": None,
    "database": None,
    "print_blob": True,
    "suppress_health_check": [HealthCheck.too_slow],
}
# 25 examples in every run of the tests, a hundred with each seed of `python -m tests.explore`.
settings.register_profile("repeatable", derandomize=True, max_examples=25, **EVERYWHERE)
settings.register_profile("explore", derandomize=False, **EVERYWHERE)
settings.load_profile("repeatable")
# Hypothesis also draws constants that it finds in the local modules that are loaded, and each worker has loaded others.
# `derandomize` does not cover them (6.170), and no setting switches them off.
providers._get_local_constants = Constants

signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)  # the guest's tests run without the plug-in
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """Return 0 for a single file: starting workers takes longer than most files do."""
    files = {argument.partition("::")[0] for argument in config.args}
    return 0 if len(files) == 1 and files.pop().endswith(".py") else None


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the seed of another order."""
    parser.addoption(
        "--shuffle",
        type=int,
        metavar="SEED",
        help="run the files, and the tests of each, in an order drawn from this",
    )


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Shuffle the files if requested; tests of a file stay together, because they share slow fixtures."""
    if (seed := config.getoption("shuffle")) is None:
        return
    drawn = random.Random(seed)
    files: dict[Path, list[pytest.Item]] = {item.path: [] for item in items}
    for item in items:
        files[item.path].append(item)
    together = list(files.values())
    drawn.shuffle(together)
    for tests in together:
        drawn.shuffle(tests)
    items[:] = [item for tests in together for item in tests]


class LastFirst:
    """A plug-in that imports the files of a directory from the last one on, but collects them in the usual order.

    In a fresh clone half the time of collecting goes into rewriting asserts, which pytest keeps beside the file. One
    worker begins at each end, rewrites half of them, and finds the others done.
    """

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(
        self, collector: pytest.Collector
    ) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
        report = yield
        if isinstance(collector, pytest.Directory):
            for file in reversed(report.result):
                with suppress(Exception, pytest.skip.Exception):  # reported when it is collected
                    _ = getattr(file, "obj", None)
        return report


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(ctypes.CDLL(None), "malloc_trim"):  # glibc
        config.pluginmanager.register(Memory())
    if not hasattr(config, "workerinput"):
        os.environ[RUN] = uuid.uuid4().hex
    elif config.workerinput["workerid"] == "gw1":
        config.pluginmanager.register(LastFirst())


def pytest_collection_finish() -> None:
    """Exclude modules and tests from garbage collection, because they live as long as the process.

    Recordings name one revision of a checkout all along: git takes longer than many a hit that a test makes.
    """
    gc.freeze()
    if header := sys.modules.get("rig.recording.header"):
        header.git_revision = functools.cache(header.git_revision)


class Memory:
    """A plug-in that frees memory after a test that has used much: two workers run thousands of tests side by side.

    Recordings and frames that refer to each other stay until a collection, and Python starts one for the number of
    objects, not for their size: the faults at every frame left 360 MB. Not after each test: a collection looks at a
    hundred thousand objects.
    """

    MUCH_BYTES = 50_000_000

    M_ARENA_MAX = -8  # of mallopt: else each thread of a test leaves an arena of its own behind

    def __init__(self) -> None:
        libc = ctypes.CDLL(None)
        libc.mallopt(self.M_ARENA_MAX, 1)
        self._trim = libc.malloc_trim
        self._statm = os.open("/proc/self/statm", os.O_RDONLY)  # once for thousands of readings
        self._kept = self._resident_bytes()

    def _resident_bytes(self) -> int:
        return int(os.pread(self._statm, 100, 0).split()[1]) * mmap.PAGESIZE

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> Generator[None, object, object]:
        done = yield
        if self._resident_bytes() > self._kept + self.MUCH_BYTES:
            gc.collect()
            # What is frozen is never collected: within a file, also the recordings that its fixtures hold. Between
            # files only modules and kernels remain, which the next collection need not look at.
            if nextitem is None or nextitem.path != item.path:
                gc.freeze()
            self._trim(0)
            self._kept = self._resident_bytes()
        return done


@pytest.fixture(autouse=True, scope="session")
def _no_disk_is_waited_for() -> Generator[None]:
    """Replace fsync by a check of the descriptor; tests that need syncs count them themselves.

    Else a run would sync nine thousand times, for 2 to 3 ms each.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", os.fstat)  # as it is, an error where nothing is open
        yield


@pytest.hookimpl(trylast=True)  # when the workers have ended
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Collect garbage once; fail a run that leaves processes behind, and name and kill them."""
    gc.collect()
    gc.freeze()
    if hasattr(session.config, "workerinput"):
        return
    forkserver._forkserver._stop()
    resource_tracker._resource_tracker._stop()
    left = still_there(os.environ[RUN], RUN)
    for number in left:
        with suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
    if left:
        session.shouldfail = f"left running, and killed: {'; '.join(left.values())}"
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, object, object]:
    """Skip a test whose fixtures need a missing C compiler."""
    return (yield from _skipping_without_compiler())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    """Skip a test that needs a missing C compiler."""
    return (yield from _skipping_without_compiler())


def _skipping_without_compiler() -> Generator[None, object, object]:
    try:
        return (yield)
    except ConfigError as error:
        has_one = "CC" in os.environ or any(map(shutil.which, ("cc", "gcc", "clang")))
        if has_one or not error.message.startswith("there is no C compiler"):
            raise
        return pytest.skip("no C compiler is installed (package gcc)")
