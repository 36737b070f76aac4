"""Measure start-up times as ratios within one run; absolute times are printed.

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

from rig.cli._compiling import EXPECTED
from rig.realtime import control_words
from rig.realtime.ring import Ring
from tests.benchmarks.realtime.workbench import FULL


def shortest_time(count: Any, command: Any, **options: Any) -> Any:
    times = []
    for _ in range(count):
        started = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, timeout=300, **options)
        times.append(time.perf_counter() - started)
    return min(times)


PHASES = """
import os, sys, time
from rig.realtime import compiling

began, spent = [0.0], [0.0]

def note(at_work):
    if at_work:
        began[0] = time.process_time()
    else:
        spent[0] += time.process_time() - began[0]

compiling.listen(note)
import numpy, numba, rig.cli.hit
imports = time.process_time()
sys.argv = ["rig", *sys.argv[1:]]
from rig.__main__ import main
try:
    main()
finally:
    times = os.times()
    whole, c = time.process_time(), times.children_user + times.children_system
    print(f"PHASES {imports} {spent[0]} {c} {whole - imports - spent[0]} {whole + c} {compiling.kernels()}")
"""


def phases_s(*arguments: str, **options: Any) -> list[float]:
    """Return a command's CPU time (s) for imports, kernels, C compiler, rest and all, and the number of kernels."""
    done = subprocess.run(
        [sys.executable, "-c", PHASES, *arguments],
        check=True,
        capture_output=True,
        text=True,
        timeout=300,
        **options,
    )
    return [float(text) for text in done.stdout.partition("PHASES ")[2].split()]


@pytest.fixture(scope="module")
def private(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the options of commands that run with their own warm cache, and the cost of its first hit."""
    place = tmp_path_factory.mktemp("private")
    kept = {"HAPTIC_RIG_CACHE": str(place / "cache"), "PYTHONPYCACHEPREFIX": str(place / "bytecode")}
    env = {**os.environ, **kept}
    env.pop("PYTHONDONTWRITEBYTECODE", None)  # where it is set, each start compiles this project's sources
    options = {"cwd": place, "env": env}
    return options, phases_s("hit", "--no-plot", **options)


def test_the_first_hit_compiles_and_the_second_does_not(private: Any) -> None:
    options, first = private
    second = phases_s("hit", "--no-plot", **options)
    print("\nrig hit --no-plot, CPU seconds (goal 20, stretch 15; then 2)")
    for name, numbers in (("first", first), ("then", second)):
        imports, kernels, c, rest, whole, count = numbers
        print(
            f"  {name}: {whole:.1f}: imports {imports:.1f}, {count:.0f} kernels {kernels:.1f}, C {c:.1f}, {rest:.1f}"
        )
    assert abs(first[-1] / EXPECTED["hit"] - 1.0) < 0.3, "what the command says of the time that is left"
    assert second[1] == second[2] == second[-1] == 0.0
    assert second[-2] < 0.3 * first[-2]


def test_commands_that_check_and_show_take_a_few_bare_interpreters(private: Any) -> None:
    """The goal with a warm cache is one second each; on any machine it is at most some imports of numba."""
    options, _ = private
    run, place = [sys.executable, "-m", "rig"], Path(options["cwd"])
    subprocess.run([*run, "session", "new", "study.toml"], check=True, capture_output=True, **options)
    (place / "mine.toml").write_text('preset = "koul-compliant"\n')
    numba = shortest_time(3, [sys.executable, "-c", "import numba"])
    recording = str(next(place.glob("recordings/*.parquet")))
    print("\nwarm, wall seconds (goal 1; a hit 2)")
    for name, most, *arguments in (
        ("rig experiment plan", 5.0, "experiment", "plan", "mine.toml"),
        ("rig show", 6.0, "show", recording),
        ("rig session check", 7.0, "session", "check", "study.toml"),
        ("rig hit --no-plot", 9.0, "hit", "--no-plot"),
    ):
        seconds = shortest_time(2, [*run, *arguments], **options)  # the first may compile
        print(f"  {name}: {seconds:.2f} s, {seconds / numba:.1f} × import numba")
        assert seconds < most * numba


def test_a_stop_reaches_the_loop_almost_as_soon_as_an_interpreter_starts() -> None:
    """From exec to the stop word: 50 ms on an idle machine is the goal, 2.5 × a bare interpreter on any."""
    program = Path(sys.executable).with_name("rig")
    bare, stop = [], []
    with Ring.allocate(1, info={}, shared=True) as ring:
        for _ in range(50 if FULL else 15):
            bare.append(shortest_time(1, [sys.executable, "-c", "pass"]))
            ring.put(control_words.STOP, 0)
            ring.put(control_words.LOOP_DONE, 0)
            started = time.perf_counter()
            with subprocess.Popen([program, "stop", str(os.getpid())], stdout=subprocess.DEVNULL) as process:
                while ring.get(control_words.STOP) == 0 and process.poll() is None:
                    time.sleep(1e-4)
                stop.append(time.perf_counter() - started)
                ring.put(control_words.LOOP_DONE, 1)
            assert process.returncode == 0
    stopping, nothing = statistics.median(stop), statistics.median(bare)
    print(
        f"\nrig stop: {1e3 * stopping:.0f} ms to the stop word (goal 50), "
        f"{stopping / nothing:.1f} × python -c pass (goal 2.5)"
    )
    assert stopping < 2.5 * nothing
