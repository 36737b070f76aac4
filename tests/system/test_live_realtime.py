"""A hit in real time, while another process changes its wall, stops it, or recovers its capture."""

import gc
import json
import os
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import rig.experiments.hits.hit  # noqa: F401  (compiles the loop)
from rig.config import experiment_from_mapping
from rig.core.errors import StoppedError
from rig.experiments.trials.live import change_wall, parameter_set
from rig.experiments.trials.recover import CaptureState, recover
from rig.realtime._anonymous_memory import LINK
from rig.realtime.running import RunningLoop, running, stop
from rig.recording.reader import open_recording
from tests.conformance.census import MARK, marked, still_there
from tests.conformance.started import WAIT_S, started

ROOT = Path(__file__).parents[2]


@contextmanager
def hit(
    directory: Path, *more: str, ticks: int = 100, **environment: str
) -> Iterator[tuple[subprocess.Popen[str], RunningLoop]]:
    """Start a real-time hit of a simulated rig with a long homing phase; yield it once its loop steps."""
    options = ["--set", "homing.settle_s=30", "--set", "homing.timeout_s=60", "--json", *more]
    command = [sys.executable, "-m", "rig", "hit", "--realtime", "-o", str(directory), *options]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": os.environ | environment}
    with started(*command, cwd=ROOT, text=True, **pipes) as process:
        yield process, wait_until_stepping(process, ticks)


def wait_until_stepping(process: subprocess.Popen[str], ticks: int) -> RunningLoop:
    """Wait until the loop of a process has made more than `ticks` steps, and return that loop."""
    deadline = time.monotonic() + WAIT_S
    while process.poll() is None and time.monotonic() < deadline:
        for loop in running():
            if loop.pid == process.pid and loop.ticks > ticks:
                return loop
        time.sleep(0.02)
    process.kill()
    raise AssertionError(f"no loop: {process.communicate()}")


# The longest lifetime: a busy machine may delay the supervising loop.
ON_DEVICE = (
    "--rig=koul-rigid --loop=device --rate=5k/500 -K60 -B0.05 --set=controller.supervise_lifetime_s=0.1"
)


@pytest.mark.parametrize("options", ["", ON_DEVICE], ids=["host", "device"])
@pytest.mark.quiet
def test_another_terminal_changes_the_wall_and_stops_the_loop(options: str, tmp_path: Path) -> None:
    with hit(tmp_path, "--no-plot", *options.split()) as (process, loop):
        assert Path(loop.info["recording"]).parent == tmp_path
        done = change_wall({"stiffness": 120.0, "damping": 0.3}, process.pid, patience_s=WAIT_S)
        stopped = stop(process.pid, patience_s=WAIT_S)
        out, err = process.communicate(timeout=WAIT_S)
        assert process.returncode == StoppedError.exit_code, err
        assert [one.ended for one in stopped] == [True]
        assert done.active
        assert json.loads(out)["error"]["kind"] == "StoppedError"
        assert not any(other.pid == process.pid for other in running(done=True))
    (path,) = tmp_path.glob("*.parquet")
    recording = open_recording(path)
    assert recording.trailer is not None
    (taken,) = recording.trailer["parameter_sets"]
    before = experiment_from_mapping(recording.experiment, "the header")
    assert before.wall.stiffness != 120.0
    assert done.wall["stiffness"] == 120.0
    changed = experiment_from_mapping({**recording.experiment, "wall": done.wall}, "changed")
    quantum = recording.header["identity"]["current_quantum_a"]
    expected = parameter_set(changed, current_quantum_a=quantum, reference_count=0)
    assert [taken["wall_position"], *taken["parameters"]] == expected
    sets = recording.column("parameter_set")
    assert set(sets[recording.column("tick") < taken["tick"]]) <= {0}
    assert set(sets[recording.column("tick") >= taken["tick"]]) <= {1}
    assert sets[-1] == 1


@pytest.mark.quiet
def test_the_capture_of_a_killed_hit_is_recovered_and_its_processes_end(tmp_path: Path) -> None:
    mark, before = uuid.uuid4().hex, set(os.listdir("/dev/shm"))
    links_before = list(links_of_this_process()).count(LINK)
    with hit(tmp_path, ticks=1000, **{MARK: mark}) as (process, _):
        (capture,) = tmp_path.glob("*.rigcap")
        (result,) = recover([tmp_path])
        if process.poll() is None:
            assert result.outcome == CaptureState.IN_USE  # by its lock, or as a loop's own
        assert len(marked(mark)) >= 3 or process.poll() is not None, "host, device and who draws at least"
        process.kill()
        process.wait()
        assert not any(other.pid == process.pid for other in running(done=True))
    assert not still_there(mark)
    assert not [name for name in set(os.listdir("/dev/shm")) - before if "haptic" in name or "rig" in name]
    (result,) = recover([tmp_path]) if capture.exists() else (result,)
    assert result.outcome == CaptureState.SEALED
    assert not capture.exists()
    (path,) = tmp_path.glob("*.parquet")
    recording = open_recording(path)
    assert len(recording) == result.rows
    ticks = recording.column("tick")
    assert (ticks[1:] > ticks[:-1]).all()
    gc.collect()
    assert list(links_of_this_process()).count(LINK) <= links_before, (
        "a test that failed before may keep its own"
    )


def links_of_this_process() -> Iterator[str]:
    for link in Path("/proc/self/fd").iterdir():
        try:
            yield str(link.readlink())
        except OSError:
            continue
