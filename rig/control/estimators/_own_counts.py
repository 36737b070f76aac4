"""Check and unwrap counts and elapsed periods of other data loggers: whole numbers of any type, counters that wrap.

A missing, fractional or ambiguous value raises an error with its index and with Python statements that correct the
array; `tests/rig/control/test_own_counts.py` runs these statements as printed. `rig.control.estimators.arrays` uses it.
It must not repair counts silently.
"""

import numbers
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.control.estimators.estimator import Floats, Ints
from rig.core.errors import ConfigError

NARROWEST, WIDEST = 2, 64  # bits of a counter
ESTIMATOR_BITS = 32  # an update takes the difference of two counts modulo 2^32
LARGEST_COUNT = 2.0**62
# age of an edge that was never seen: the longest that the wire's 32-bit time can express
OLDEST_EDGE_S = 134.0
NARROW_BYTES = 2  # integers of so few bytes are those of a counter of that width
# Counts in a sample that may be a wrap: half the range of an 8-bit counter, the narrowest in use.
LEAST_JUMP = 127

SHOWN = 5  # indices of missing values in a message

COUNTS, ELAPSED, EDGE_TIME = "counts", "elapsed", "edge_time"
_KINDS = {
    "b": "truth values",
    "U": "text",
    "S": "text",
    "T": "text",
    "M": "dates",
    "m": "durations",
    "c": "complex numbers",
}
_STEPS = "give elapsed=numpy.rint(numpy.diff(times, prepend=times[0] - dt) / dt)"
FROM_SECONDS = (
    f"compute velocity periods since the sample before from times (s): times = numpy.asarray(times); {_STEPS}"
)
_FROM_DATES = (
    "compute velocity periods since the sample before from the dates: times = numpy.asarray(times); "
    f"times = (times - times[0]) / numpy.timedelta64(1, 's'); {_STEPS}"
)
_REMEDIES = {
    (
        COUNTS,
        "b",
    ): "give the encoder's counts; if these are the levels of channels A and B, count the edges first",
    (COUNTS, "M"): "give the column of counts; times belong in elapsed",
    (COUNTS, "m"): "give the column of counts; times belong in elapsed",
    (ELAPSED, "b"): FROM_SECONDS,
    (ELAPSED, "M"): _FROM_DATES,
    (ELAPSED, "m"): _FROM_DATES,
}
_FRACTION = {
    COUNTS: "for positions in rad or m, give quantise(positions, resolution); for counts that were "
    "scaled, averaged or interpolated, give the original counts of the encoder, each a whole "
    "number",
    ELAPSED: FROM_SECONDS,
}


def whole_numbers(values: ArrayLike, array_name: str, also: tuple[str, ...] = ()) -> NDArray[Any]:
    """Return the values as an integer array: of their own type if that is an integer type, else of int64.

    Parameters
    ----------
    values
        Integers, or floats with whole values.
    array_name
        Name of the array in messages: "counts" or "elapsed".
    also
        Names of further arrays (``elapsed``, ``edge_time``) from which the user must remove the same samples.

    Raises
    ------
    ConfigError
        The array is not flat, has missing values (the message has their indices), another type, fractions, or floats so
        large that not every whole number can be represented.
    """
    array = _floats_if_missing(values, array_name)
    if array.ndim != 1:
        raise ConfigError(
            f"the array {array_name} has {array.ndim} dimensions instead of 1",
            remedy="give a one-dimensional array",
        )
    if len(array) == 0:
        return np.zeros(0, np.int64)
    if array.dtype.kind in "iu":
        return array
    if array.dtype.kind != "f":
        raise _no_whole_numbers_error(array_name, array.dtype.kind, str(array.dtype))
    missing = np.flatnonzero(np.isnan(array))
    if len(missing):
        remedy = FROM_SECONDS if array_name == ELAPSED else _remove_missing(values, also)
        raise ConfigError(
            f"{array_name} is not a number at {_format_indices(missing, len(array))}", remedy=remedy
        )
    parts = np.flatnonzero((array != np.trunc(array)) | np.isinf(array))
    if len(parts):
        raise ConfigError(
            f"{array_name}[{parts[0]}] = {array[parts[0]]:g} is not a whole number",
            remedy=_FRACTION[array_name],
        )
    bits = np.finfo(array.dtype).nmant + 1
    too_large = np.flatnonzero(np.abs(array) > min(2.0**bits, LARGEST_COUNT))
    if len(too_large):
        raise ConfigError(
            f"{array_name}[{too_large[0]}] = {array[too_large[0]]:.17g} is above 2^{bits}, where {array.dtype} cannot "
            "represent every whole number",
            remedy=f"give {array_name} as they were recorded, as integers",
        )
    return array.astype(np.int64)


def real_numbers(values: ArrayLike, array_name: str, unit: str) -> Floats:
    """Return the values as float64, NaN where masked; raise `ConfigError`, with name and unit, for text and dates."""
    array = _unmask(values)
    if array.dtype.kind in _KINDS:
        raise ConfigError(
            f"{array_name} holds {_KINDS[array.dtype.kind]} ({array.dtype}), not numbers",
            remedy=f"give numbers in {unit}",
        )
    return array.astype(np.float64)


def unwrap(values: NDArray[Any], width: Any, elapsed: Ints) -> Ints:
    """Return counts (int64) of a counter of less than 32 bits without its wraps.

    Parameters
    ----------
    values
        Integers of any type, as `whole_numbers` returns them.
    width
        Bits of the counter. None: the size of the array's integers if that is 8 or 16 bits, else 32.
    elapsed
        Velocity periods between the previous sample and each sample.

    Raises
    ------
    ConfigError
        The width is invalid, the counts do not fit it, a step is so large that its direction is ambiguous, or, without
        a width, a jump looks like a wrap.
    """
    if width is not None and not (
        isinstance(width, int | np.integer) and not isinstance(width, bool) and NARROWEST <= width <= WIDEST
    ):
        raise ConfigError(
            f"width = {width!r} is not a number of bits",
            remedy=f"give the bits of the counter, {NARROWEST} to {WIDEST}, or leave width out",
        )
    if len(values) < 2:
        return values.astype(np.int64)
    bits = int(width or 0) or (
        8 * values.dtype.itemsize if values.dtype.itemsize <= NARROW_BYTES else ESTIMATOR_BITS
    )
    low, high = int(values.min()), int(values.max())
    fits = (low >= 0 and high < 2**bits) or (-(2 ** (bits - 1)) <= low and high < 2 ** (bits - 1))
    if width is not None and not fits:
        raise ConfigError(
            f"counts from {low} to {high} do not fit a counter of {width} bits",
            remedy="give the width of the counter; leave width out if the counts have been unwrapped already",
        )
    counts = values.astype(np.int64)
    steps = np.diff(counts)
    if fits and bits <= ESTIMATOR_BITS:
        steps = (steps + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
        _check_direction(counts, steps, elapsed, bits)
        counts = counts[0] + np.concatenate(([0], np.cumsum(steps)))
    if width is None:
        _check_jumps(values, counts, steps)
    beyond = np.flatnonzero(np.abs(steps) >= 2 ** (ESTIMATOR_BITS - 1))
    if len(beyond):
        raise ConfigError(
            f"counts[{beyond[0] + 1}] differs by {steps[beyond[0]]} from the previous count; allowed is less than 2^31",
            remedy="check the counts of these two samples",
        )
    return counts


def age_of_last_change(counts: Ints, time_s: Floats) -> Floats:
    """Return the time since the last encoder edge at each sample (s), if each change of the count is an edge."""
    changed = np.zeros(len(counts), dtype=bool)
    changed[1:] = counts[1:] != counts[:-1]
    last = np.maximum.accumulate(np.where(changed, time_s, -np.inf)) if len(counts) else time_s
    return np.minimum(time_s - last, OLDEST_EDGE_S)


def _check_direction(counts: Ints, steps: Ints, elapsed: Ints, bits: int) -> None:
    expected = np.concatenate(([0.0], steps[:-1] / elapsed[1:-1] * elapsed[2:]))
    wrong = np.flatnonzero(np.abs(steps - expected) >= 2 ** (bits - 1))
    if len(wrong):
        at = int(wrong[0]) + 1
        raise ConfigError(
            f"counts[{at}] is {counts[at]} after {counts[at - 1]}, {elapsed[at]} periods earlier, "
            f"where the previous speed predicts {expected[at - 1]:+.4g} counts: the difference is "
            f"half of the range of a {bits} bit counter, or more",
            remedy="give the counter's width, sample it more often, or estimate the two sides of a gap "
            "separately",
        )


def _check_jumps(values: NDArray[Any], counts: Ints, steps: Ints) -> None:
    span = int(counts.max()) - int(counts.min())
    wide = np.flatnonzero(np.abs(steps) > max(span / 2, LEAST_JUMP))
    if len(wide):
        at = int(wide[0]) + 1
        raise ConfigError(
            f"counts[{at}] is {values[at]} after {values[at - 1]}, more than half of the range of all "
            f"counts ({span}): the counter wraps, or was reset",
            remedy="give the bits of the counter, such as width=16; if it wraps at another number N: "
            "numpy.unwrap(counts, period=N); if the handle moved so far in one sample, width=32",
        )


def _floats_if_missing(values: ArrayLike, array_name: str) -> NDArray[Any]:
    """Return plain numbers: floats with NaN if a value is missing; raise `ConfigError` for other objects."""
    array = _unmask(values)
    if array.dtype.kind != "O" or array.ndim != 1:
        return array
    present = [value for value in array if not _is_missing(value)]
    for value in present:
        if isinstance(value, bool | np.bool_):
            raise _no_whole_numbers_error(array_name, kind="b", type_name="bool")
        if isinstance(value, str | bytes):
            raise _no_whole_numbers_error(array_name, kind="U", type_name="str")
        if not isinstance(value, numbers.Real):
            kind = np.asarray(value).dtype.kind
            raise _no_whole_numbers_error(array_name, kind, type(value).__name__)
    if len(present) == len(array) and all(isinstance(value, numbers.Integral) for value in present):
        try:
            return np.array([int(value) for value in array], np.int64)
        except OverflowError:
            raise ConfigError(
                f"{array_name} has a value beyond ±2^63", remedy="give values that fit into 64 bits"
            ) from None
    return np.array([np.nan if _is_missing(value) else float(value) for value in array])


def _unmask(values: ArrayLike) -> NDArray[Any]:
    mask = np.ma.getmask(values)
    return np.where(mask, np.nan, np.asarray(values)) if np.any(mask) else np.asarray(values)


def _is_missing(value: Any) -> bool:
    try:
        return value is None or bool(value != value)  # noqa: PLR0124 - NaN and NaT differ from themselves
    except TypeError:  # pandas.NA is neither true nor false
        return True


def _no_whole_numbers_error(array_name: str, kind: str, type_name: str) -> ConfigError:
    if _KINDS.get(kind) == "text":
        convert = f"{array_name} = numpy.asarray({array_name}, dtype=float)"
        remedy = f"convert them: {convert}; give {array_name}={array_name}"
    else:
        remedy = _REMEDIES.get((array_name, kind), "give whole numbers, as integers or floats")
    return ConfigError(
        f"{array_name} contains {_KINDS.get(kind, 'no numbers')} ({type_name}), not whole numbers",
        remedy=remedy,
    )


def _remove_missing(values: ArrayLike, also: tuple[str, ...]) -> str:
    number = "numpy.asarray(counts, dtype=float)"
    if _has_pandas_na(values):  # numpy makes no number of it
        number = "pandas.array(counts, dtype='Float64').to_numpy(float, na_value=numpy.nan)"
    elif isinstance(values, np.ma.MaskedArray):
        number = "numpy.ma.filled(counts.astype(float), numpy.nan)"
    given = ["counts=counts[kept]", "elapsed=numpy.diff(sample, prepend=sample[0] - 1)"]
    sample, start = "kept", "sample[0]"
    if ELAPSED in also:
        sample, start = "numpy.cumsum(elapsed)[kept]", "(sample[0] - elapsed[0])"
    if EDGE_TIME in also:
        given.append(f"edge_time=numpy.asarray(edge_time)[kept] - dt * {start}")
    return (
        f"leave these samples out, and state the gaps: counts = {number}; kept = "
        f"numpy.flatnonzero(numpy.isfinite(counts)); sample = {sample}; give {', '.join(given)}"
    )


def _has_pandas_na(values: ArrayLike) -> bool:
    array = np.asarray(values)
    return array.dtype.kind == "O" and any(type(value).__name__ == "NAType" for value in array)


def _format_indices(found: Ints, size: int) -> str:
    shown = ", ".join(map(str, found[:SHOWN])) + (" …" if len(found) > SHOWN else "")
    word = "index" if len(found) == 1 else "indices"
    return f"{word} {shown} ({len(found)} of {size})"
