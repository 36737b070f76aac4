"""Run any estimator over arrays of recorded or computed counts, with the same compiled update as the loop.

The results equal those of a rig, bit for bit. The update is called through the same function type as in the loop, so an
estimator of a plug-in needs no further compilation.

    counts = quantise(position, 1e-6)
    velocity = estimate("fdm-butterworth", counts, 1 / 2000, resolution=1e-6, cutoff_hz=150.0)
"""

import math
from typing import Any

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from rig.control.estimators import _family as family
from rig.control.estimators._own_counts import (
    COUNTS,
    EDGE_TIME,
    ELAPSED,
    FROM_SECONDS,
    LARGEST_COUNT,
    OLDEST_EDGE_S,
    age_of_last_change,
    real_numbers,
    unwrap,
    whole_numbers,
)
from rig.control.estimators.estimator import WINDOW, Estimator, Floats, Ints, Prepared
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR

FUTURE_S = 1e-9  # an edge at the sample itself may round to after it

_FLOATS, _INTS = types.float64[::1], types.int64[::1]


def quantise(position: ArrayLike, resolution: float, *, offset: float = 0.5) -> NDArray[np.int64]:
    """Return the counts of an ideal encoder: sign(resolution) · floor(position / abs(resolution) + offset).

    Parameters
    ----------
    position
        True positions (rad or m), any shape.
    resolution
        Travel for one count (rad or m); negative when counts fall while the position rises.
    offset
        Offset of position zero within a count: 0.5 rounds to the nearest count, 0 rounds down.

    Returns
    -------
    ndarray of int64
        Counts, in the shape of `position`. They do not wrap at 32 bits, unlike those of a device.

    Raises
    ------
    ConfigError
        The resolution is zero or not finite, or a position is not a finite number or is beyond 2^62 counts.
    """
    _check_resolution(resolution)
    cells = np.floor(real_numbers(position, "position", "rad or m") / abs(resolution) + offset)
    if not (np.abs(cells) < LARGEST_COUNT).all():
        raise ConfigError(
            "a position is not finite or is beyond 2^62 counts", remedy="check position and resolution"
        )
    return np.asarray(math.copysign(1.0, resolution) * cells).astype(np.int64)


def estimate(
    name: str,
    counts: ArrayLike,
    dt: float,
    *,
    resolution: float,
    edge_time: ArrayLike | None = None,
    elapsed: ArrayLike | None = None,
    width: Any = None,  # an int; `**parameters` of a caller would not type-check beside it
    effort: ArrayLike | None = None,
    **parameters: float | str,
) -> Floats:
    """Return the velocity (rad/s or m/s) at each sample by the named estimator, bit for bit as a running loop does.

    Parameters
    ----------
    name
        Name of the estimator (`rig.control.estimators.names`).
    counts
        Encoder counts, one for each sample: whole numbers of any type, shape (n,). A 32-bit counter may wrap, a
        narrower counter only if its `width` is given. Leave out lost samples and give the gaps as `elapsed`.
    dt
        Velocity period (s).
    resolution
        Travel for one count (rad or m); negative when counts fall while the position rises.
    edge_time
        Time of the last encoder edge before each sample (s, shape (n,)), on a clock that is zero at the first sample;
        −inf before the first edge. If it is not given, an edge is assumed at each sample whose count has changed.
    elapsed
        Velocity periods from the previous sample to each sample, shape (n,): above 1 after lost samples. Default: 1.
    width
        Bits of the counter. Not needed for a counter of 32 bits or one that does not wrap, nor for arrays of 8 or 16
        bit integers, which are treated as counters of that width.
    effort
        Mean effort of the motor from the previous sample to each sample (N·m or N), shape (n,). Required by an
        estimator that uses it, ignored by the others.
    **parameters
        Settings of the estimator; a setting that is not given has its default.

    Returns
    -------
    ndarray of float64
        Velocities (rad/s or m/s), shape (n,). The first velocity is zero.

    Raises
    ------
    ConfigError
        The estimator is unknown; settings, period or resolution are invalid; counts are missing or fractional; a jump
        exceeds half the range of the counter (without `width`: of all counts); arrays have different lengths; an edge
        is later than its sample.

    Examples
    --------
    >>> estimate("fdm", [0, 2, 4, 6], 0.001, resolution=1e-6).tolist()
    [0.0, 0.002, 0.002, 0.002]
    """
    return estimate_with_window(
        name,
        counts,
        dt,
        resolution=resolution,
        edge_time=edge_time,
        elapsed=elapsed,
        width=width,
        effort=effort,
        **parameters,
    )[0]


def estimate_with_window(
    name: str,
    counts: ArrayLike,
    dt: float,
    *,
    resolution: float,
    edge_time: ArrayLike | None = None,
    elapsed: ArrayLike | None = None,
    width: Any = None,  # an int; `**parameters` of a caller would not type-check beside it
    effort: ArrayLike | None = None,
    **parameters: float | str,
) -> tuple[Floats, Ints]:
    """Return the velocity (rad/s or m/s) at each sample, and the number of sampling periods that it spans (int64).

    The arguments are explained by `estimate`.
    """
    arrays = own_inputs(counts, dt, resolution=resolution, edge_time=edge_time, elapsed=elapsed, width=width)
    estimator = family.get(name)
    prepared = estimator.prepare(parameters, resolution, dt)
    require_effort(estimator, effort)
    return run(prepared, *arrays, None if effort is None else checked_efforts(effort, len(arrays[0])))


def own_inputs(
    counts: ArrayLike,
    dt: float,
    *,
    resolution: float,
    edge_time: ArrayLike | None = None,
    elapsed: ArrayLike | None = None,
    width: Any = None,
) -> tuple[Ints, Floats, Ints]:
    """Check a user's arrays; return unwrapped counts, age of the last edge (s) and elapsed periods at each sample.

    The arguments are explained by `estimate`.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise ConfigError(
            f"dt = {dt!r} s is not a valid sampling period: it must be above 0 and finite",
            remedy="give the time between two samples in s",
        )
    _check_resolution(resolution)
    held, steps = _counts_and_steps(counts, elapsed, edge_time)
    return inputs(unwrap(held, width, steps), dt, edge_time, steps)


def inputs(
    counts: ArrayLike, dt: float, edge_time: ArrayLike | None = None, elapsed: ArrayLike | None = None
) -> tuple[Ints, Floats, Ints]:
    """Check arrays of samples; return counts, age of the last encoder edge (s) and elapsed periods, for each sample.

    Counts may wrap at 32 bits; those of a narrower counter must be unwrapped before (`_own_counts.unwrap`).
    """
    held, steps = _counts_and_steps(counts, elapsed, edge_time)
    whole = held.astype(np.int64)
    time_s = dt * (np.cumsum(steps) - steps[:1].sum())
    if edge_time is None:
        return whole, age_of_last_change(whole, time_s), steps
    edges = real_numbers(edge_time, EDGE_TIME, "s")
    if edges.shape != whole.shape:
        raise ConfigError(
            f"{len(whole)} counts are given, but edge_time has shape {edges.shape}",
            remedy="give one time for each count",
        )
    age = time_s - edges
    if not (age >= -FUTURE_S).all():  # also finds NaN
        raise ConfigError(
            "an edge_time is later than its sample, or not a number",
            remedy="give seconds from the first sample, and -inf where no edge is known",
        )
    return whole, np.clip(age, 0.0, OLDEST_EDGE_S), steps


def _counts_and_steps(
    counts: ArrayLike, elapsed: ArrayLike | None, edge_time: ArrayLike | None
) -> tuple[NDArray[Any], Ints]:
    also = {ELAPSED: elapsed, EDGE_TIME: edge_time}
    held = whole_numbers(counts, COUNTS, tuple(name for name, values in also.items() if values is not None))
    if elapsed is None:
        return held, np.ones(len(held), np.int64)
    steps = whole_numbers(elapsed, ELAPSED).astype(np.int64)
    if len(steps) != len(held):
        raise ConfigError(
            f"{len(held)} counts are given, but {len(steps)} values of elapsed",
            remedy="give one value for each count",
        )
    if len(steps) and steps.min() < 1:
        raise ConfigError(
            "elapsed has a value below 1: each sample must be at least one period after the previous sample",
            remedy=FROM_SECONDS,
        )
    return held, steps


def require_effort(estimator: Estimator, effort: object) -> None:
    """Raise `ConfigError` if the estimator uses the motor's effort and `effort` is None."""
    if effort is None and estimator.uses_effort:
        raise ConfigError(
            f"estimator {estimator.name} needs the effort of the motor",
            remedy="give the effort of each sample (N·m or N), or choose an estimator that uses only counts",
        )


def checked_efforts(effort: ArrayLike, samples: int) -> Floats:
    """Return the efforts (N·m or N) as float64, shape (samples,); raise `ConfigError` if they are not such numbers."""
    applied = real_numbers(effort, "effort", "N·m or N")
    if applied.shape != (samples,):
        raise ConfigError(
            f"{samples} counts are given, but effort has shape {applied.shape}",
            remedy="give one value for each count",
        )
    if not np.isfinite(applied).all():
        raise ConfigError("effort has values that are not finite", remedy="give finite numbers in N·m or N")
    return applied


def run(
    prepared: Prepared, counts: Ints, edge_age_s: Floats, elapsed: Ints, effort: Floats | None = None
) -> tuple[Floats, Ints]:
    """Run an estimator over arrays; return the velocity (rad/s or m/s) at each sample, and the periods that it spans.

    `counts`, `edge_age_s` (age of the last encoder edge, s) and `elapsed` (periods since the previous sample) are the
    results of `inputs`. `effort` is the mean effort since the previous sample (N·m or N), by default zero. The memory
    of `prepared` changes.
    """
    velocities, windows = np.empty(len(counts)), np.empty(len(counts), np.int64)
    memory = (prepared.state_f, prepared.state_i, prepared.parameters)
    applied = np.zeros(len(counts)) if effort is None else effort
    update_all(prepared.estimator.update, counts, edge_age_s, elapsed, applied, *memory, velocities, windows)
    return velocities, windows


@kernel(types.void(ESTIMATOR, _INTS, _FLOATS, _INTS, _FLOATS, _FLOATS, _INTS, _FLOATS, _FLOATS, _INTS))
def update_all(
    update: Any,
    counts: Ints,
    edge_age_s: Floats,
    elapsed: Ints,
    effort: Floats,
    state_f: Floats,
    state_i: Ints,
    parameters: Floats,
    velocities: Floats,
    windows: Ints,
) -> None:
    """Call the function `update` of an estimator for each sample; write velocities (rad/s or m/s) and periods spanned.

    All arrays except the estimator's memory (`state_f`, `state_i`) and `parameters` have the length of `counts`.
    """
    for k in range(len(counts)):
        velocities[k] = update(counts[k], edge_age_s[k], elapsed[k], effort[k], state_f, state_i, parameters)
        windows[k] = state_i[WINDOW]


def _check_resolution(resolution: float) -> None:
    if not (math.isfinite(resolution) and resolution != 0.0):
        raise ConfigError(
            f"resolution = {resolution!r} is not a valid travel for one count: it must be finite and not 0",
            remedy="give the travel for one count (rad or m)",
        )
