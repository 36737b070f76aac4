"""Requirements on every velocity estimator: `check_estimator` names the first that is broken.

It raises AssertionError with a sentence and needs no test runner; known limits of an estimator are arguments, not
skipped checks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import index

import numpy as np
from numpy.typing import NDArray

from rig.control import estimators
from rig.control.estimators import PERIOD, RESOLUTION, Estimator, Prepared, inputs, run
from rig.testing._compiled import allocations, guarded

Make = Callable[[float, float], Prepared]
Floats = NDArray[np.float64]

RESOLUTION_SI, PERIOD_S = 1.5708e-4, 5e-4  # Koul et al.: 1000 lines, x4, 10:1, velocity at 2 kHz
ONE_COUNT = RESOLUTION_SI / PERIOD_S  # velocity of one count in one period
NO_SETTINGS: Mapping[str, float | str] = {}
SETTLED = 400  # velocity periods after which every estimator has forgotten its start
EXTREMES = (-(2**31), 2**31 - 1, 0, -1, 1)


def velocities(
    prepared: Prepared,
    counts: Sequence[int],
    elapsed: Sequence[int] | None = None,
    ages: Sequence[float] | None = None,
) -> Floats:
    """Run an estimator over a sequence of counts.

    `elapsed` holds the velocity periods before each count (1), `ages` the age of the last edge at each (`edge_ages`).
    """
    update, memory = prepared.estimator.update, (prepared.state_f, prepared.state_i, prepared.parameters)
    steps = elapsed if elapsed is not None else [1] * len(counts)
    if ages is None:
        ages = edge_ages(counts, steps, float(prepared.parameters[PERIOD]))
    return np.array(
        [
            update(index(c), age, index(n), 0.0, *memory)
            for c, age, n in zip(counts, ages, steps, strict=True)
        ],
        dtype=np.float64,
    )


def edge_ages(counts: Sequence[int], elapsed: Sequence[int], period_s: float) -> list[float]:
    """Return the age of the last edge at each sample (s), as a handle gives it that moves evenly from cell to cell.

    From the middle of the cell of one sample to the middle of the next one's: the last of n edges lies half a
    count before the sample. The handle has been at rest for a second before the first.
    """
    ages = [1.0]
    for before, count, steps in zip(counts, counts[1:], elapsed[1:], strict=False):
        edges = abs((int(count) - int(before) + 2**31) % 2**32 - 2**31)
        passed = int(steps) * period_s
        ages.append(0.5 * passed / edges if edges else ages[-1] + passed)
    return ages[: len(counts)]


def check_estimator(
    estimator: Estimator | str,
    settings: Mapping[str, float | str] = NO_SETTINGS,
    *,
    linear: bool = True,
    ramp_tolerance: float = 0.01,
) -> None:
    """Run every check.

    Parameters
    ----------
    estimator, settings
        It, or the name of one, and its settings.
    linear
        True if its output scales with its input.
    ramp_tolerance
        Relative error that it may leave, settled, on a ramp of whole counts.
    """
    known = estimators.get(estimator) if isinstance(estimator, str) else estimator

    def make(resolution: float, period_s: float) -> Prepared:
        return known.prepare(settings, resolution, period_s)

    check_layout(make)
    check_memory(make)
    check_one_by_one(make)
    check_rest(make)
    check_ramp(make, ramp_tolerance)
    check_ramp_over_gaps(make, ramp_tolerance)
    check_sign_of_resolution(make)
    check_shift(make)
    check_counter_wrap(make)
    check_finite(make)
    check_restart(make)
    check_memories_apart(make)
    if linear:
        check_scale(make)


def check_layout(make: Make) -> None:
    """The first two parameters are resolution and period; memory is zero, flat and of the plug's types."""
    p = make(RESOLUTION_SI, PERIOD_S)
    assert p.parameters[RESOLUTION] == RESOLUTION_SI, "parameters[0] is not the resolution"
    assert p.parameters[PERIOD] == PERIOD_S, "parameters[1] is not the velocity period"
    assert np.isfinite(p.parameters).all(), "a parameter is not finite"
    for array, kind in ((p.parameters, "float64"), (p.state_f, "float64"), (p.state_i, "int64")):
        assert array.dtype == kind, "wrong type of array"
        assert array.ndim == 1, "not a flat array"
        assert array.flags.c_contiguous, "not contiguous"
        assert len(array) >= 1, "empty array: the plug point needs one element"
    assert not p.state_f.any(), "memory of a fresh estimator is not zero"
    assert not p.state_i.any(), "memory of a fresh estimator is not zero"


def check_memory(make: Make) -> None:
    """A run keeps to its memory, leaves its parameters alone and takes nothing from the heap."""
    fresh = make(RESOLUTION_SI, PERIOD_S)
    (state_f, floats), (state_i, ints) = guarded(fresh.state_f), guarded(fresh.state_i)
    parameters, kept = guarded(fresh.parameters)
    watched = replace(fresh, state_f=state_f, state_i=state_i, parameters=parameters)
    once, twice = (inputs(_lively_counts() * times, PERIOD_S) for times in (1, 2))
    needed = allocations(lambda: run(watched, *once))
    assert allocations(lambda: run(watched, *twice)) == needed, "the estimator allocates while it runs"
    assert floats() and ints() and kept(), "the estimator writes outside of its memory"  # noqa: PT018
    assert (parameters == fresh.parameters).all(), "the estimator changes its parameters"


def check_one_by_one(make: Make) -> None:
    """Called by itself it gives what it gives inside a compiled loop."""
    samples = inputs(_lively_counts(), PERIOD_S)
    alone = velocities(make(RESOLUTION_SI, PERIOD_S), samples[0].tolist(), ages=samples[1].tolist())
    inside, _ = run(make(RESOLUTION_SI, PERIOD_S), *samples)
    assert (alone == inside).all(), "differs inside a compiled loop"


def check_rest(make: Make) -> None:
    """A handle at rest reads zero from the first sample on, wherever it rests."""
    for place in (0, 12345, -(2**31)):
        v = velocities(make(RESOLUTION_SI, PERIOD_S), [place] * 50)
        assert (np.abs(v) < 1e-9 * ONE_COUNT).all(), f"a handle at rest at count {place} reads {v}"


def check_ramp(make: Make, tolerance: float) -> None:
    """A steady motion of whole counts a period reads its true velocity once settled, both ways."""
    for slope in (7, -7):
        v = velocities(make(RESOLUTION_SI, PERIOD_S), [slope * k for k in range(SETTLED)])
        assert np.isclose(v[-1], slope * ONE_COUNT, rtol=tolerance), f"a ramp of {slope} reads {v[-1]}"


def check_ramp_over_gaps(make: Make, tolerance: float) -> None:
    """Check that lost velocity periods do not disturb a steady motion: the update receives how many passed."""
    elapsed = [1] * SETTLED + [2, 1, 5, 1, 17, 3, 1]
    counts = 7 * np.cumsum(elapsed)
    v = velocities(make(RESOLUTION_SI, PERIOD_S), counts.tolist(), elapsed)[SETTLED:]
    assert np.allclose(v, 7 * ONE_COUNT, rtol=2 * tolerance), f"gaps disturb a ramp: {v}"


def check_sign_of_resolution(make: Make) -> None:
    """An encoder mounted the other way round gives the opposite velocity."""
    counts = _lively_counts()
    one, other = (velocities(make(r, PERIOD_S), counts) for r in (RESOLUTION_SI, -RESOLUTION_SI))
    assert np.allclose(one, -other, rtol=1e-9, atol=1e-9 * ONE_COUNT), "not odd in the sign of the resolution"


def check_shift(make: Make) -> None:
    """Only differences of counts matter: where the encoder's zero lies does not."""
    counts = _lively_counts()
    one = velocities(make(RESOLUTION_SI, PERIOD_S), counts)
    other = velocities(make(RESOLUTION_SI, PERIOD_S), [c + 1_000_003 for c in counts])
    assert np.allclose(one, other, rtol=1e-6, atol=1e-6 * ONE_COUNT), "depends on the encoder's zero"


def check_counter_wrap(make: Make) -> None:
    """The 32-bit counter of a device may wrap in the middle of a motion."""
    counts = _lively_counts()
    wrapped = [(c + 2**31 - 200 + 2**31) % 2**32 - 2**31 for c in counts]
    assert min(wrapped) < 0 < max(wrapped)
    one = velocities(make(RESOLUTION_SI, PERIOD_S), counts)
    other = velocities(make(RESOLUTION_SI, PERIOD_S), wrapped)
    assert np.allclose(one, other, rtol=1e-6, atol=1e-6 * ONE_COUNT), "disturbed when the counter wraps"


def check_finite(make: Make) -> None:
    """Whatever counts and gaps arrive, the velocity is finite: NaN would end the run."""
    random = np.random.default_rng(3)
    for _ in range(5):
        counts = random.integers(-(2**31), 2**31, 300)
        counts[random.integers(0, 300, 60)] = random.choice(EXTREMES, 60)
        elapsed = (5000.0 ** random.random(300)).astype(int)  # of every size, most of them short
        v = velocities(make(RESOLUTION_SI, PERIOD_S), counts.tolist(), elapsed.tolist())
        assert np.isfinite(v).all(), "a count sequence gives a velocity that is not finite"


def check_restart(make: Make) -> None:
    """Zeroing the memory is a restart: it then gives the bits of a fresh one."""
    counts = _lively_counts()
    used = make(RESOLUTION_SI, PERIOD_S)
    fresh = velocities(used, counts)
    used.state_f[:] = 0.0
    used.state_i[:] = 0
    assert (velocities(used, counts) == fresh).all(), "a restart differs from a fresh estimator"


def check_memories_apart(make: Make) -> None:
    """Two estimators run side by side as if alone: all memory is in the arrays."""
    counts = _lively_counts()
    alone = velocities(make(RESOLUTION_SI, PERIOD_S), counts)
    one, two = make(RESOLUTION_SI, PERIOD_S), make(RESOLUTION_SI, PERIOD_S)
    ages = edge_ages(counts, [1] * len(counts), PERIOD_S)
    both = [
        (velocities(one, [c], ages=[a])[0], velocities(two, [-c], ages=[a])[0])
        for c, a in zip(counts, ages, strict=True)
    ]
    assert [v for v, _ in both] == alone.tolist(), "an estimator is disturbed by another of its kind"


def check_scale(make: Make) -> None:
    """Three times the motion reads three times the velocity."""
    counts = _lively_counts()
    one = velocities(make(RESOLUTION_SI, PERIOD_S), counts)
    three = velocities(make(RESOLUTION_SI, PERIOD_S), [3 * c for c in counts])
    assert np.allclose(three, 3 * one, rtol=1e-9, atol=1e-9 * ONE_COUNT), "does not scale with the motion"


def _lively_counts() -> list[int]:
    """Return a hit as an encoder sees it: approach, impact, ringing, with rounding."""
    t = np.arange(300) * PERIOD_S
    motion = np.where(t < 0.05, t * 1.2, 0.06 + 0.01 * np.exp(-(t - 0.05) / 0.02) * np.sin(600 * (t - 0.05)))
    return [int(c) for c in np.floor(motion / RESOLUTION_SI + 0.5)]
