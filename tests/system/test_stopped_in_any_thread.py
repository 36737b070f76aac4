"""A signal, `rig.stop` and the end of the program stop a run in any thread, and its recording is complete.

Python calls signal handlers in the main thread only, which is busy with something else in these programs.
"""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import rig
from rig.core.errors import StoppedError
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.recording.reader import open_recording
from tests.conformance.started import started
from tests.conformance.tiers import first_by_default

PROGRAM = """
import asyncio, os, signal, sys, threading
import rig
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit

signal.signal(signal.SIGINT, signal.default_int_handler)
sent = threading.Event()

def watch(number, experiment):
    def progress(ticks, phase):
        if ticks > 200 and not sent.is_set():
            if SIGNAL:
                os.kill(os.getpid(), SIGNAL)
            sent.set()
    return progress

def run():
    twice = rig.load("koul-compliant", duration_s=60.0, changes={"trial.repeats": 2})
    list(hit(HitRequest(experiment=twice, realtime=REALTIME, output=OUTPUT), admit, watch))

"""
TO_THREAD = """
async def main():
    await asyncio.to_thread(run)
asyncio.run(main())
"""
JOINED = """
thread = threading.Thread(target=run)
thread.start()
thread.join()
"""
# The program ends while the thread runs. The interpreter aborts (code -6) where a daemon thread prints, as of an
# exception that nothing catches, at the moment in which it finalises standard error.
DAEMON = """
threading.excepthook = lambda of: None
threading.Thread(target=run, daemon=True).start()
sent.wait()
"""
HANDLED = """
called = []
signal.signal(signal.SIGINT, lambda number, frame: called.append(number))
try:
    run()
except rig.errors.StoppedError as error:
    assert error.signal == signal.SIGINT
assert called == [signal.SIGINT]
raise SystemExit(0)
"""
EXITS = """
signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(7))
run()
"""


@pytest.fixture
def handlers() -> Iterator[None]:
    """Restore the handlers of signals that a program sets."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.signals
@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize(
    ("program", "number", "ends", "realtime"),
    first_by_default(
        [
            pytest.param(TO_THREAD, signal.SIGINT, KeyboardInterrupt, False, id="to_thread"),
            pytest.param(HANDLED, signal.SIGINT, SystemExit, False, id="a handler of its own"),
            pytest.param(EXITS, signal.SIGTERM, SystemExit, False, id="a handler that exits"),
            pytest.param(TO_THREAD, signal.SIGINT, KeyboardInterrupt, True, id="in real time"),
        ],
        3,
    ),
)
def test_a_run_stops_in_any_thread(
    program: str, number: int, ends: type[BaseException], realtime: bool, tmp_path: Path
) -> None:
    """Run the program in this process: its signals arrive in the main thread, as they do in any other."""
    names = {"SIGNAL": int(number), "REALTIME": realtime, "OUTPUT": str(tmp_path)}
    with pytest.raises(ends) as ended:
        exec(PROGRAM + program, names)
    assert getattr(ended.value, "code", None) == {EXITS: 7, HANDLED: 0}.get(program)
    assert_stopped(tmp_path)


@pytest.mark.signals
@pytest.mark.exhaustive("::test_a_run_stops_in_any_thread")
@pytest.mark.parametrize(
    ("program", "number", "codes"),
    [
        pytest.param(JOINED, signal.SIGTERM, {-signal.SIGTERM}, id="default action"),
        # An interpreter that KeyboardInterrupt ends kills itself by SIGINT, unless a thread still runs code at its end.
        pytest.param(JOINED, signal.SIGINT, {1, -signal.SIGINT}, id="joined"),
        pytest.param(DAEMON, 0, {0}, id="the program ends"),
    ],
)
def test_a_run_stops_before_its_process_ends(
    program: str, number: int, codes: set[int], tmp_path: Path
) -> None:
    text = f"SIGNAL, REALTIME, OUTPUT = {int(number)}, False, {str(tmp_path)!r}\n{PROGRAM}{program}"
    with started(sys.executable, "-c", text, stderr=subprocess.PIPE, text=True) as process:
        error_output = process.communicate(timeout=90)[1]
    assert process.returncode in codes, error_output
    assert_stopped(tmp_path)


def assert_stopped(output: Path) -> None:
    (path,) = output.glob("*.*")  # sealed, and no second repeat
    recording = open_recording(path)
    assert (path.suffix, recording.complete, recording.trailer["reason"]) == (".parquet", True, "stopped")
    assert len(recording) > 0


def test_rig_stop_stops_every_run_and_its_repeats(tmp_path: Path) -> None:
    """It also stops the second repeat in one thread and a map between two trials; later runs may begin again."""
    ready = threading.Barrier(3)

    def begun(number: int, experiment: Any) -> Any:
        waits = [ready.wait]
        return lambda ticks, phase: waits.pop()(60) if waits and ticks > 200 else None

    twice = rig.load("koul-compliant", duration_s=600.0, changes={"trial.repeats": 2})

    def hits(name: str) -> None:
        list(hit(HitRequest(experiment=twice, output=tmp_path / name), admit, begun))

    with ThreadPoolExecutor() as threads:
        both = [threads.submit(hits, name) for name in "ab"]
        ready.wait(60)
        assert rig.stop() == 2
        for one in both:
            with pytest.raises(StoppedError) as caught:
                one.result(60)
            assert caught.value.signal is None
            recording = open_recording(caught.value.recording)
            assert (recording.complete, recording.trailer["reason"]) == (True, "stopped")
    assert len(list(tmp_path.glob("*/*"))) == 2

    coarse: Any = {"dampings": [0.1, 0.2, 0.3, 0.4], "ratio": 3.0}
    with pytest.raises(StoppedError, match="tasks are done"):
        rig.zwidth("koul-compliant", ["uniform:10k"], watch=lambda progress: rig.stop(), **coarse)
    assert rig.stop() == 0
    rig.hit("koul-compliant", duration_s=0.5, output=tmp_path / "c")
