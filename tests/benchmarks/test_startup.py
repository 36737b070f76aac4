"""Start-up, as ratios measured side by side in one run; absolute times are printed.

pytest tests/benchmarks -o addopts="" -s
"""

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from rig.realtime import ring as words
from rig.realtime.ring import Ring


def best_of(count: Any, command: Any, **options: Any) -> Any:
    """Shortest wall time of a command (s)."""
    times = []
    for _ in range(count):
        started = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, timeout=300, **options)
        times.append(time.perf_counter() - started)
    return min(times)


@pytest.fixture(scope="module")
def bare() -> Any:
    return best_of(7, [sys.executable, "-c", "pass"])


@pytest.mark.parametrize(
    ("name", "command", "most"),
    [
        ("import rig", ["-c", "import rig"], 3.0),
        ("import firmware_protocol", ["-c", "import firmware_protocol"], 3.0),
        ("rig --help", ["-m", "rig", "--help"], 15.0),
    ],
)
def test_what_must_be_quick_stays_near_a_bare_interpreter(
    name: str, command: list[str], most: float, bare: Any
) -> None:
    seconds = best_of(7, [sys.executable, *command])
    print(f"\n{name}: {1e3 * seconds:.0f} ms, {seconds / bare:.1f} × python -c pass ({1e3 * bare:.0f} ms)")
    assert seconds / bare < most


def test_the_second_hit_does_not_compile(tmp_path: Path, bare: Any) -> None:
    command = [sys.executable, "-m", "rig", "hit", "--output", str(tmp_path / "recordings")]
    options = {"cwd": tmp_path, "env": {**os.environ, "HAPTIC_RIG_CACHE": str(tmp_path / "cache")}}
    first = best_of(1, command, **options)
    second = best_of(3, command, **options)
    print(f"\nrig hit: first {first:.1f} s, then {second:.2f} s ({second / bare:.0f} × python -c pass)")
    assert second < 0.5 * first


def test_a_stop_reaches_the_loop_almost_as_soon_as_an_interpreter_starts() -> None:
    """From the exec to the stop word; the goal on an idle machine is 50 ms, on any 2.5 × a bare interpreter."""
    program = Path(sys.executable).with_name("rig")
    bare, stop = [], []
    with Ring.allocate(1, info={}, shared=True) as ring:
        for _ in range(50):
            bare.append(best_of(1, [sys.executable, "-c", "pass"]))
            ring.put(words.STOP, 0)
            ring.put(words.LOOP_DONE, 0)
            started = time.perf_counter()
            with subprocess.Popen([program, "stop", str(os.getpid())], stdout=subprocess.DEVNULL) as process:
                while ring.get(words.STOP) == 0 and process.poll() is None:
                    time.sleep(1e-4)
                stop.append(time.perf_counter() - started)
                ring.put(words.LOOP_DONE, 1)
            assert process.returncode == 0
    said, nothing = statistics.median(stop), statistics.median(bare)
    print(
        f"\nrig stop: {1e3 * said:.0f} ms to the stop word (goal 50), {said / nothing:.1f} × python -c pass (goal 2.5)"
    )
    assert said < 2.5 * nothing
