"""Start-up, as ratios measured side by side in one run; absolute times are printed.

pytest tests/benchmarks -o addopts="" -s
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest


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
