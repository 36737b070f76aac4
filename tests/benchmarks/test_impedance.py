"""Compare the cost of an impedance measurement with the same run in C.

As in test_trial.py: in turns in one process, CPU time of the thread, median of the ratios.
"""

import ctypes
import statistics
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import controller, presets
from rig.control import laws
from rig.experiments.trials.excitation_run import multisine_of, ramp_s
from sim_backend.bare.excited import ExcitedPlant
from sim_backend.mechanics.plant import DiscretePlant
from tests.benchmarks.test_trial import compile_c, cpu_ns

SOURCE = Path(__file__).with_name("excited.c")
CHAWDA = config.excited(presets.load("chawda-linear"))
RATIO, EVERY = 20, 5  # inner steps in a tick of 1 ms, and between two positions
SECONDS = 5
PAIRS = 15


def build_c(directory: Path, *options: str) -> Any:
    """Return the function of excited.c."""
    function = compile_c(directory, SOURCE, *options).excite
    function.restype = ctypes.c_int64
    return function


def test_a_excited_run_costs_about_what_it_costs_in_c(tmp_path: Path) -> None:
    ticks = 1000 * SECONDS
    model = config.rig_model(CHAWDA)
    excited_plant = ExcitedPlant(model, 1e-3, 4000.0, ticks)
    assert excited_plant.inner_rate_hz == pytest.approx(1000 * RATIO)
    template = controller.for_experiment(
        CHAWDA, current_quantum_a=model.amplifier.current_quantum_a, law=laws.get("bilateral")
    )
    wall = asdict(replace(CHAWDA.wall, stiffness=10e3, damping=20.0))
    plant = DiscretePlant.build(model, 1e-3 / RATIO)
    push = multisine_of(CHAWDA).period(1000 * RATIO, offset=0.5)
    rows = ticks * RATIO // EVERY
    arrays = np.zeros(rows, np.int64), np.zeros(rows), np.zeros(rows), np.zeros(ticks)
    whole = len(push), round(ramp_s(CHAWDA) * 1000 * RATIO), ticks, RATIO, EVERY

    def here() -> Any:
        return excited_plant.excite(template.fresh(wall), 0.0, push, ramp_s(CHAWDA), ticks)

    def there(function: Any) -> Any:
        law = template.fresh(wall)
        inputs = (
            law.control,
            law.estimator.parameters,
            law.law.parameters,
            *plant.arrays,
            plant.at_rest(0.0),
            push,
        )
        return function(
            *(ctypes.c_void_p(array.ctypes.data) for array in (*inputs, *arrays)),
            *(ctypes.c_int64(number) for number in whole),
        )

    run = here()
    compiled = build_c(tmp_path), build_c(tmp_path, "-march=native")
    for function in compiled:
        assert there(function) == ticks == run.ticks
        for mine, theirs in zip((run.counts, run.position, run.velocity, run.withheld), arrays, strict=True):
            assert mine.tobytes() == theirs.tobytes(), "not the same run"
    times = [[cpu_ns(here), *(cpu_ns(there, function) for function in compiled)] for _ in range(PAIRS)]
    mine, plain, native = (min(column) * 1e-6 for column in zip(*times, strict=True))
    ratio, ratio_native = (statistics.median(row[0] / row[i] for row in times) for i in (1, 2))
    print(
        f"\n{SECONDS} s at {RATIO} kHz inner: {mine:.2f} ms ({mine * 1e6 / (ticks * RATIO):.1f} ns an inner step); "
        f"C -O3 {plain:.2f} ms (ratio {ratio:.2f}), with -march=native {native:.2f} ms (ratio {ratio_native:.2f})"
    )
    assert ratio < 1.5
