"""Compare the cost of a velocity sample with the same algorithm in C.

The C functions are compiled with -O3 in this run and put into the same plug point of the same compiled loop, so that
one call through a function type is part of either cost. Measured side by side in CPU time of the thread; the median of
the ratios counts. Also printed: C in a loop of its own. The call, which hands over three arrays by value, costs about
5 ns, some of it hidden behind the arithmetic.
"""

import ctypes
import statistics
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.control import estimators
from rig.control.estimators import _fdm_butterworth as fdm_butterworth
from rig.control.estimators import _foaw as foaw
from rig.control.estimators import _kalman as kalman
from rig.control.estimators import _levant as levant
from rig.control.estimators.arrays import quantise, update_all
from rig.control.estimators.estimator import PERIOD, RESOLUTION
from rig.experiments.estimation._signals import SIGNALS
from rig.realtime.plugs import ESTIMATOR_SIGNATURE, NativeFunction
from tests.benchmarks.test_trial import compile_c, cpu_ns

SOURCE = Path(__file__).with_name("estimators.c")
RATE, DELTA = 20_000, 1e-6
SAMPLES = 100_000
PAIRS = 15
PLACES = {
    "RESOLUTION": RESOLUTION, "PERIOD": PERIOD,
    **{n: getattr(fdm_butterworth, n) for n in ("B0", "B1", "B2", "A1", "A2")},
    **{n: getattr(kalman, n) for n in ("R", "Q11", "Q12", "Q13", "Q22", "Q23", "Q33", "PRIOR33", "STEADY")},
    **{n: getattr(kalman, n) for n in ("GAIN1", "GAIN2", "GAIN3", "PRIOR")},
    **{n: getattr(levant, n) for n in ("ALPHA", "LAMBDA", "SCHEME", "OUTPUT")},
    **{n: getattr(foaw, n) for n in ("BAND", "LIMIT")},
}  # fmt: skip

# Of the time in C; on the processors seen 0.96 to 1.7. numba makes the call with a status and C without: 1.3 ns, much
# of the two cheapest; the steady Kalman filter's three states go through memory from one sample to the next.
MOST = 2.0
CASES = [  # estimator, settings, function in C
    ("fdm", {}, "fdm"),
    ("fdm-butterworth", {}, "fdm_butterworth"),
    ("kalman", {"gain": "steady", "bandwidth_hz": 300.0}, "kalman"),
    ("kalman", {"bandwidth_hz": 300.0}, "kalman"),
    ("levant", {"lipschitz": 20.0}, "levant"),
    ("levant", {"lipschitz": 20.0, "discretisation": "explicit"}, "levant"),
    ("foaw-end", {"window_limit": 16.0}, "foaw_end"),
]


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> Any:
    options = [f"-D{name}={value}" for name, value in PLACES.items()]
    return compile_c(tmp_path_factory.mktemp("c"), SOURCE, *options)


@pytest.fixture(scope="module")
def counts() -> Any:
    """Return the counts of an encoder of 1 µm at 20 kHz during repeated hits."""
    hit = SIGNALS["wall-bounce"]
    once = quantise(hit(np.arange(0.0, hit.end_s, 1.0 / RATE)).position, DELTA)
    return np.resize(np.concatenate([once, once[::-1]]), SAMPLES)


def make_run(update: Any, state_f: Any, state_i: Any, parameters: Any, counts: Any, out: Any) -> Any:
    """Return a function that runs an estimator over all counts in the compiled loop, from fresh memory."""
    ages, elapsed, efforts, windows = (
        np.zeros(len(counts)),
        np.ones(len(counts), np.int64),
        np.zeros(len(counts)),
        np.zeros(len(counts), np.int64),
    )

    def go() -> None:
        state_f[:] = 0.0
        state_i[:] = 0
        update_all(update, counts, ages, elapsed, efforts, state_f, state_i, parameters, out, windows)

    return go


def run_ours(prepared: Any, counts: Any, out: Any) -> Any:
    p = prepared
    return make_run(p.estimator.update, p.state_f, p.state_i, p.parameters, counts, out)


def run_theirs(library: Any, function: Any, parameters: Any, counts: Any, out: Any) -> Any:
    """Return a run of the C function in the same loop, and one in its own C loop."""
    f, i = np.zeros(16), np.zeros(512, np.int64)
    address = ctypes.cast(getattr(library, f"plug_{function}"), ctypes.c_void_p).value
    plugged = NativeFunction(address, ESTIMATOR_SIGNATURE, keep=library)
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (f, i, parameters, out)]

    def alone() -> None:
        f[:] = 0.0
        i[:] = 0
        library.run(
            getattr(library, function),
            ctypes.c_void_p(counts.ctypes.data),
            ctypes.c_int64(len(counts)),
            *pointers,
        )

    return make_run(plugged, f, i, parameters, counts, out), alone


@pytest.mark.parametrize(("name", "settings", "function"), CASES)
def test_an_estimator_costs_about_what_it_costs_in_c(
    in_c: Any, counts: Any, name: Any, settings: Any, function: Any
) -> None:
    prepared = estimators.get(name).prepare(settings, DELTA, 1.0 / RATE)
    mine, c = np.zeros(len(counts)), np.zeros(len(counts))
    run_mine = run_ours(prepared, counts, mine)
    run_c, run_c_alone = run_theirs(in_c, function, prepared.parameters, counts, c)
    run_mine()
    for go in (run_c_alone, run_c):
        go()
        assert np.abs(mine - c).max() < 1e-9 * DELTA * RATE, "not the same algorithm"
    pairs = [(cpu_ns(run_mine), cpu_ns(run_c), cpu_ns(run_c_alone)) for _ in range(PAIRS)]
    ratio = statistics.median(a / b for a, b, _ in pairs)
    here, there, alone = (min(times) / len(counts) for times in zip(*pairs, strict=True))
    print(
        f"\n{name} {settings}: {here:.1f} ns a sample, C -O3 in the same loop {there:.1f} ns (ratio {ratio:.2f}), "
        f"in its own {alone:.1f} ns"
    )
    assert ratio < MOST
