"""Check the requirements on a velocity estimator; `check_estimator` raises an error for the first violation.

The error is an AssertionError with a sentence, so no test runner is needed. Known limits of an estimator are arguments;
no check is skipped. Tests of a lab's own estimators call it. It must not depend on pytest.
"""

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

# Encoder and velocity period of Koul et al.: 1000 lines, fourfold decoding, transmission 10:1, 2 kHz.
RESOLUTION_SI, PERIOD_S = 1.5708e-4, 5e-4  # rad, s
ONE_COUNT = RESOLUTION_SI / PERIOD_S  # velocity of one count in one period
NO_SETTINGS: Mapping[str, float | str] = {}
SETTLED = 400  # velocity periods after which every estimator has forgotten its start
EXTREMES = (-(2**31), 2**31 - 1, 0, -1, 1)  # counts


def velocities(
    prepared: Prepared,
    counts: Sequence[int],
    elapsed: Sequence[int] | None = None,
    ages: Sequence[float] | None = None,
) -> Floats:
    """Return the velocity (rad/s or m/s) that an estimator computes at each encoder count of a sequence.

    `elapsed` is the number of velocity periods (times between two velocity samples) before each count (default: 1), and
    `ages` the time (s) since the last encoder edge at each count (default: computed by `edge_ages`).
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
    """Return the time (s) since the last encoder edge at each sample, for a handle that moves evenly between samples.

    The handle moves from the middle of one count to the middle of the next, so the last of n edges lies half a count
    before the sample. Before the first sample the handle has been at rest for a second.
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
    """Check all requirements on a velocity estimator (rest, ramp, gaps, scale, …); raise AssertionError if one fails.

    Parameters
    ----------
    estimator, settings
        The estimator or its name, and its settings.
    linear
        True if three times the motion must give three times the velocity.
    ramp_tolerance
        Allowed relative error of the settled velocity at constant speed.
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
    """Check the arrays of an estimator: flat, of the right type, zeroed memory, resolution and period as parameters."""
    prepared = make(RESOLUTION_SI, PERIOD_S)
    assert prepared.parameters[RESOLUTION] == RESOLUTION_SI, "parameters[0] is not the resolution"
    assert prepared.parameters[PERIOD] == PERIOD_S, "parameters[1] is not the velocity period"
    assert np.isfinite(prepared.parameters).all(), "a parameter is not finite"
    arrays = prepared.parameters, prepared.state_f, prepared.state_i
    for array, kind in zip(arrays, ("float64", "float64", "int64"), strict=True):
        assert array.dtype == kind, "wrong type of array"
        assert array.ndim == 1, "not a flat array"
        assert array.flags.c_contiguous, "not contiguous"
        assert len(array) >= 1, "empty array: the plug point needs one element"
    assert not prepared.state_f.any(), "memory of a fresh estimator is not zero"
    assert not prepared.state_i.any(), "memory of a fresh estimator is not zero"


def check_memory(make: Make) -> None:
    """Check that an estimator writes only to its memory, does not change its parameters, and allocates nothing."""
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
    """Check that single calls of an estimator return the same velocities as calls in a compiled loop."""
    samples = inputs(_lively_counts(), PERIOD_S)
    alone = velocities(make(RESOLUTION_SI, PERIOD_S), samples[0].tolist(), ages=samples[1].tolist())
    inside, _ = run(make(RESOLUTION_SI, PERIOD_S), *samples)
    assert (alone == inside).all(), "differs inside a compiled loop"


def check_rest(make: Make) -> None:
    """Check that the velocity of a handle at rest is zero from the first sample on, at any position."""
    for place in (0, 12345, -(2**31)):
        v = velocities(make(RESOLUTION_SI, PERIOD_S), [place] * 50)
        assert (np.abs(v) < 1e-9 * ONE_COUNT).all(), f"a handle at rest at count {place} reads {v}"


def check_ramp(make: Make, tolerance: float) -> None:
    """Check the settled velocity at constant speed in both directions; `tolerance` is the allowed relative error."""
    for slope in (7, -7):
        v = velocities(make(RESOLUTION_SI, PERIOD_S), [slope * k for k in range(SETTLED)])
        assert np.isclose(v[-1], slope * ONE_COUNT, rtol=tolerance), f"a ramp of {slope} reads {v[-1]}"


def check_ramp_over_gaps(make: Make, tolerance: float) -> None:
    """Check the velocity at constant speed if samples are lost and the estimator receives the number of lost periods.

    `tolerance` is half the allowed relative error.
    """
    elapsed = [1] * SETTLED + [2, 1, 5, 1, 17, 3, 1]
    counts = 7 * np.cumsum(elapsed)
    v = velocities(make(RESOLUTION_SI, PERIOD_S), counts.tolist(), elapsed)[SETTLED:]
    assert np.allclose(v, 7 * ONE_COUNT, rtol=2 * tolerance), f"gaps disturb a ramp: {v}"


def check_sign_of_resolution(make: Make) -> None:
    """Check that a negative resolution (encoder mounted in reverse) gives the opposite velocity."""
    counts = _lively_counts()
    one, other = (velocities(make(r, PERIOD_S), counts) for r in (RESOLUTION_SI, -RESOLUTION_SI))
    assert np.allclose(one, -other, rtol=1e-9, atol=1e-9 * ONE_COUNT), "not odd in the sign of the resolution"


def check_shift(make: Make) -> None:
    """Check that the velocity depends only on differences of counts, not on the encoder's zero."""
    counts = _lively_counts()
    one = velocities(make(RESOLUTION_SI, PERIOD_S), counts)
    other = velocities(make(RESOLUTION_SI, PERIOD_S), [c + 1_000_003 for c in counts])
    assert np.allclose(one, other, rtol=1e-6, atol=1e-6 * ONE_COUNT), "depends on the encoder's zero"


def check_counter_wrap(make: Make) -> None:
    """Check that an overflow of the device's 32-bit counter during a motion does not change the velocity."""
    counts = _lively_counts()
    wrapped = [(c + 2**31 - 200 + 2**31) % 2**32 - 2**31 for c in counts]
    assert min(wrapped) < 0 < max(wrapped)
    one = velocities(make(RESOLUTION_SI, PERIOD_S), counts)
    other = velocities(make(RESOLUTION_SI, PERIOD_S), wrapped)
    assert np.allclose(one, other, rtol=1e-6, atol=1e-6 * ONE_COUNT), "disturbed when the counter wraps"


def check_finite(make: Make) -> None:
    """Check that the velocity is finite for any sequence of counts and lost periods, because NaN would end the run."""
    random = np.random.default_rng(3)
    for _ in range(5):
        counts = random.integers(-(2**31), 2**31, 300)
        counts[random.integers(0, 300, 60)] = random.choice(EXTREMES, 60)
        # Numbers of lost periods of every order of magnitude, most of them small.
        elapsed = (5000.0 ** random.random(300)).astype(int)
        v = velocities(make(RESOLUTION_SI, PERIOD_S), counts.tolist(), elapsed.tolist())
        assert np.isfinite(v).all(), "a count sequence gives a velocity that is not finite"


def check_restart(make: Make) -> None:
    """Check that an estimator whose memory is set to zero returns exactly the velocities of a new estimator."""
    counts = _lively_counts()
    used = make(RESOLUTION_SI, PERIOD_S)
    fresh = velocities(used, counts)
    used.state_f[:] = 0.0
    used.state_i[:] = 0
    assert (velocities(used, counts) == fresh).all(), "a restart differs from a fresh estimator"


def check_memories_apart(make: Make) -> None:
    """Check that two estimators that are called alternately return the same velocities as one estimator alone."""
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
    """Check that three times the motion gives three times the velocity."""
    counts = _lively_counts()
    one = velocities(make(RESOLUTION_SI, PERIOD_S), counts)
    three = velocities(make(RESOLUTION_SI, PERIOD_S), [3 * c for c in counts])
    assert np.allclose(three, 3 * one, rtol=1e-9, atol=1e-9 * ONE_COUNT), "does not scale with the motion"


def _lively_counts() -> list[int]:
    t = np.arange(300) * PERIOD_S
    motion = np.where(t < 0.05, t * 1.2, 0.06 + 0.01 * np.exp(-(t - 0.05) / 0.02) * np.sin(600 * (t - 0.05)))
    return [int(c) for c in np.floor(motion / RESOLUTION_SI + 0.5)]
