"""Compare the cost of a tick of a simulated trial with the same trial in C.

They run in turns in one process, in CPU time of the thread; the median of the ratios counts. The C of `trial.c` is
written for one rig, one estimator and one law, gives the same trajectory to the last bit, and leaves out what only
other estimators read (the age of the edge in device time).
"""

import ctypes
import shutil
import statistics
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.messages import OLDEST_EDGE
from rig import config
from rig.config import controller, presets
from rig.control import _wall as wall
from rig.control import step
from rig.control.estimators import _fdm_butterworth as fdm_butterworth
from rig.control.estimators import estimator
from sim_backend.bare.trial import Trace, run_arguments, run_ticks
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import DiscretePlant

SOURCE = Path(__file__).with_name("trial.c")
OPTIONS = ["-std=c99", "-O3", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror"]  # c99: no contraction to FMA
MOST_TICKS = 60_000
PAIRS = 15

PLACES = {
    "RESOLUTION_SIGNED": estimator.RESOLUTION, "PERIOD": estimator.PERIOD,
    **{n: getattr(fdm_butterworth, n) for n in ("B0", "B1", "B2", "A1", "A2")},
    **{n: getattr(wall, n) for n in ("STIFFNESS", "DAMPING", "MAY_PULL", "ENTRY_ONLY")},
    **{n: getattr(step, n) for n in ("WAIT", "HOMING", "SETTLE", "TRIAL", "RELEASE", "DONE", "ENDS_RUN")},
    **{n: getattr(step, n) for n in ("INSIDE", "VELOCITY_UPDATED", "SATURATED", "SLEW_BOUND", "CLAMPED")},
    **{n: getattr(step, n) for n in ("NONFINITE", "OUT_OF_WINDOW", "HOMING_FAILED")},
}  # fmt: skip


def header() -> str:
    """Return the content of records.h: the control record and the indices and codes of the Python modules."""
    fields = [f"    {'double' if kind == '<f8' else 'int64_t'} {name};" for name, kind in step.CONTROL.descr]
    return "\n".join(
        [*(f"#define {name} {value}" for name, value in PLACES.items()), "struct control {", *fields, "};\n"]
    )


def compile_c(directory: Path, source: Path, *options: str) -> ctypes.CDLL:
    """Compile a file of this directory and load it; skip the test without a compiler."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("no gcc")
    (directory / "records.h").write_text(header())
    library = directory / f"{source.stem}-{len(options)}.so"
    flags = [*OPTIONS, *options, f"-I{directory}", f"-I{source.parent}"]
    subprocess.run([compiler, *flags, str(source), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def build_c(directory: Path, *options: str) -> Any:
    """Return a function of trial.c that runs a trial into a trace as `run_in_numba` does."""
    function = compile_c(directory, SOURCE, *options).trial
    function.restype = ctypes.c_int64

    def run(law: Any, plant: Any, trace: Any) -> Any:
        inputs = law.control, law.estimator.parameters, law.law.parameters, *plant.arrays, plant.at_rest(0.0)
        return function(
            *(ctypes.c_void_p(array.ctypes.data) for array in inputs),
            ctypes.c_int64(len(trace.counts)),
            *(ctypes.c_void_p(array.ctypes.data) for array in trace),
        )

    return run


def run_in_numba(law: Any, plant: Any, trace: Any) -> Any:
    arguments = run_arguments(law, plant, plant.at_rest(0.0), 0.0, OLDEST_EDGE, OperatorScript.silent())
    return run_ticks(*arguments, trace)


def cpu_ns(function: Any, *arguments: Any) -> Any:
    started = time.thread_time_ns()
    function(*arguments)
    return time.thread_time_ns() - started


def test_a_trial_costs_about_what_it_costs_in_c(tmp_path: Path) -> None:
    experiment = presets.load("koul-compliant")
    plant = DiscretePlant.build(config.rig_model(experiment), 1.0 / experiment.controller.position_rate)
    quantum = experiment.rig.amplifier.current_quantum_a

    def fresh() -> Any:
        return controller.for_experiment(experiment, current_quantum_a=quantum)

    runs = run_in_numba, build_c(tmp_path), build_c(tmp_path, "-march=native")
    trace, other = Trace.empty(MOST_TICKS, plant), Trace.empty(MOST_TICKS, plant)
    ticks = run_in_numba(fresh(), plant, trace)
    assert trace.phases[ticks - 1] == step.DONE
    for in_c in runs[1:]:
        assert in_c(fresh(), plant, other) == ticks
        for mine, theirs in zip(trace.first(ticks), other.first(ticks), strict=True):
            assert mine.tobytes() == theirs.tobytes(), "not the same trial"
    times = [[cpu_ns(run, fresh(), plant, other) for run in runs] for _ in range(PAIRS)]
    here, plain, native = (min(column) / ticks for column in zip(*times, strict=True))
    ratio, ratio_native = (statistics.median(row[0] / row[i] for row in times) for i in (1, 2))
    print(
        f"\ntwo masses, {ticks} ticks: {here:.1f} ns a tick, {1e3 / here:.1f} million ticks a second and core; "
        f"C -O3 {plain:.1f} ns (ratio {ratio:.2f}), with -march=native {native:.1f} ns (ratio {ratio_native:.2f})"
    )
    assert ratio < 2.0  # 1.4 to 1.6 on the processors seen; one call into Python a tick would be ten
