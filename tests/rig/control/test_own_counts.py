"""Counts from other loggers: of any type, with samples missing, or from a narrow counter.

The remedy printed in a message is executed here: it must give the true speed.
"""

import decimal
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.estimators import estimate, quantise
from rig.core.errors import ConfigError

DT, DELTA = 1e-3, 1e-5
SPEED = 7  # counts in a period
TRUE = SPEED * DELTA / DT
COUNTS = SPEED * np.arange(40)
TIMES = 12.5 + DT * np.arange(40)


def speeds(counts: Any, **given: Any) -> np.ndarray:
    return estimate("fdm", counts, DT, resolution=DELTA, **given)[1:]


@pytest.mark.parametrize(
    "counts",
    [
        COUNTS.astype(np.float64),
        COUNTS.astype(np.float32),
        COUNTS.astype(object),
        COUNTS.astype(np.uint64),
        COUNTS.tolist(),
        pd.Series(COUNTS.astype(float), index=range(100, 140)),
        pd.Series(COUNTS, dtype="Int64"),
        pd.Series(COUNTS, dtype="Float64"),
        pd.Series(COUNTS, dtype="int64[pyarrow]"),
        np.ma.masked_array(COUNTS, mask=False),
    ],
    ids=lambda counts: f"{type(counts).__name__} {getattr(counts, 'dtype', '')}",
)
def test_whole_numbers_are_counts_whatever_type_holds_them(counts: Any) -> None:
    assert speeds(counts) == pytest.approx(TRUE)
    assert speeds(COUNTS, elapsed=np.ones(40)) == pytest.approx(TRUE)


LOST = [0, 1, 9, 10, 11, 39]
WITH_NAN = np.where(np.isin(np.arange(40), LOST), np.nan, COUNTS)
WITH_NA = pd.Series(COUNTS, dtype="Int64").mask(pd.Series(np.isin(np.arange(40), LOST)))
MISSING = {
    "nan": WITH_NAN,
    "None": [None if k in LOST else int(c) for k, c in enumerate(COUNTS)],
    "pandas nan": pd.Series(WITH_NAN, index=range(7, 47)),
    "pandas NA": WITH_NA,
    "pandas NA in objects": WITH_NA.astype(object),
    "pyarrow null": WITH_NA.astype("int64[pyarrow]"),
    "masked": np.ma.masked_array(COUNTS, mask=np.isin(np.arange(40), LOST)),
}


def apply(remedy: str, **names: Any) -> dict[str, Any]:
    """Execute the statements of a remedy; return the arguments that its last part says to give."""
    *statements, call = remedy.partition(": ")[2].split("; ")
    known = {"numpy": np, "pandas": pd, "dt": DT, **names}
    for statement in statements:
        exec(statement, known)
    return dict(eval(f"dict({call.removeprefix('give ')})", known))


@pytest.mark.parametrize("kind", MISSING)
@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("edges", [False, True])
def test_missing_counts_are_lost_samples_by_the_remedy(kind: str, gaps: bool, edges: bool) -> None:
    steps = np.where(np.arange(40) % 5 == 3, 4, 1)
    true = COUNTS if not gaps else SPEED * (np.cumsum(steps) - 1)
    counts = MISSING[kind]
    if gaps:
        counts = np.where(np.isnan(WITH_NAN), np.nan, true)
    arrays = {"elapsed": steps} if gaps else {}
    if edges:
        arrays["edge_time"] = DT * (np.cumsum(steps if gaps else np.ones(40)) - 1.0)
    with pytest.raises(ConfigError, match=r"at indices 0, 1, 9, 10, 11 … \(6 of 40\)") as caught:
        speeds(counts, **arrays)
    given = apply(caught.value.remedy, counts=counts, **arrays)
    assert set(given) == {"counts", "elapsed", *arrays}
    found = speeds(given.pop("counts"), **given)
    assert len(found) == 33
    assert found == pytest.approx(TRUE)
    period = estimate(
        "period", **apply(caught.value.remedy, counts=counts, **arrays), dt=DT, resolution=DELTA
    )
    assert period[2:] == pytest.approx(TRUE)


WRONG_COUNTS = {
    "fractions": (COUNTS * DELTA, r"counts\[1\] = 7e-05 is not a whole number", "positions in rad or m"),
    "bool": (np.arange(40) % 2 == 0, "truth values", "edges"),
    "nullable bool": (pd.Series([True, None] * 20, dtype="boolean"), "truth values", "edges"),
    "dates": (pd.date_range("2026-01-01", periods=40, freq="ms"), "dates", "column of counts"),
    "durations": (pd.to_timedelta(np.arange(40), unit="ms"), "durations", "column of counts"),
    "complex": (COUNTS + 0j, "complex", "whole numbers"),
    "decimals": ([decimal.Decimal(1)] * 40, "Decimal", "whole numbers"),
    "infinite": (np.where(COUNTS == 7, np.inf, COUNTS), r"counts\[1\] = inf", "whole number"),
    "double that has lost its last digits": (COUNTS + 2.0**53, r"counts\[1\].* above 2\^53", "integers"),
    "single that has lost its last digits": (np.float32(COUNTS) + 2.0**24, r"above 2\^24", "integers"),
    "beyond every counter": ([2**70] * 40, "beyond", "64 bits"),
}


@pytest.mark.parametrize("case", WRONG_COUNTS)
def test_value_that_is_not_a_count_is_refused(case: str) -> None:
    counts, message, remedy = WRONG_COUNTS[case]
    with pytest.raises(ConfigError, match=message) as caught:
        speeds(counts)
    assert remedy in caught.value.remedy


def test_positions_become_counts_as_the_remedy_says() -> None:
    with pytest.raises(ConfigError) as caught:
        speeds(COUNTS * DELTA)
    assert "quantise(positions, resolution)" in caught.value.remedy
    assert speeds(quantise(COUNTS * DELTA, DELTA)) == pytest.approx(TRUE)


@pytest.mark.parametrize("text", [COUNTS.astype(str), COUNTS.astype(bytes), pd.Series(COUNTS).astype(str)])
def test_text_becomes_numbers_as_the_remedy_says(text: Any) -> None:
    with pytest.raises(ConfigError, match="counts contains text") as caught:
        speeds(text)
    assert speeds(**apply(caught.value.remedy, counts=text)) == pytest.approx(TRUE)
    with pytest.raises(ConfigError, match="elapsed contains text") as caught:
        speeds(COUNTS, elapsed=np.ones(40, int).astype(str))
    steps = np.ones(40, int).astype(str)
    assert speeds(COUNTS, **apply(caught.value.remedy, elapsed=steps)) == pytest.approx(TRUE)


STAMPS = np.datetime64("2026-01-01T00:00:00", "ns") + np.round(1e9 * (TIMES - TIMES[0])).astype("m8[ns]")
WRONG_ELAPSED = {
    "seconds": (np.full(40, DT), r"elapsed\[0\] = 0.001 is not a whole number"),
    "first difference of pandas": (pd.Series(TIMES).diff() / DT, "elapsed is not a number at index 0"),
    "bool": (np.ones(40, bool), "truth values"),
    "dates": (STAMPS, "dates"),
    "durations": (np.diff(STAMPS, prepend=STAMPS[:1]), "durations"),
    "sample numbers": (np.arange(40), "below 1"),
}


@pytest.mark.parametrize("case", WRONG_ELAPSED)
@pytest.mark.parametrize("wrap", [np.asarray, pd.Series])
def test_elapsed_is_made_of_times_as_the_remedy_says(case: str, wrap: Any) -> None:
    elapsed, message = WRONG_ELAPSED[case]
    times = wrap(STAMPS if case in ("dates", "durations") else TIMES)
    kept = np.delete(np.arange(40), [5, 6, 20])
    with pytest.raises(ConfigError, match=message) as caught:
        speeds(COUNTS[kept], elapsed=np.asarray(elapsed)[: len(kept)])
    given = apply(caught.value.remedy, times=times[kept])
    assert speeds(COUNTS[kept], **given) == pytest.approx(TRUE)


@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "u4", "i4"])
def test_the_type_of_counts_is_the_width_of_their_counter(kind: str) -> None:
    true = np.round(3e4 * np.sin(2 * np.pi * np.arange(3000) / 3000)).astype(np.int64)
    assert speeds(true.astype(kind)).tolist() == speeds(true).tolist()


@pytest.mark.parametrize("period", [2**8, 2**12, 4000, 2**16])
@pytest.mark.parametrize("lost", [False, True])
def test_wrap_without_a_width_is_reported_with_a_remedy(period: int, lost: bool) -> None:
    true = SPEED * np.arange(2 * period // SPEED)
    kept = np.arange(len(true)) if not lost else np.flatnonzero(np.arange(len(true)) % 7 != 3)
    elapsed = np.diff(kept, prepend=-1)
    counts = (true % period)[kept]
    with pytest.raises(ConfigError, match=r"counts\[\d+\] is .* more than half of the range") as caught:
        speeds(counts, elapsed=elapsed)
    assert "width=" in caught.value.remedy
    assert "numpy.unwrap(counts, period=N)" in caught.value.remedy
    assert speeds(np.unwrap(counts, period=period), elapsed=elapsed) == pytest.approx(TRUE)
    if period & (period - 1) == 0:
        assert speeds(counts, elapsed=elapsed, width=period.bit_length() - 1) == pytest.approx(TRUE)


def test_a_jump_that_is_real_is_stated_by_the_width() -> None:
    jump = np.repeat([0, 1000], 20)
    with pytest.raises(ConfigError, match=r"counts\[20\]"):
        speeds(jump)
    assert speeds(jump, width=32)[19] == pytest.approx(1000 * DELTA / DT)


@pytest.mark.parametrize("width", [8, 12, 16])
def test_a_motion_too_fast_for_its_counter_is_reported(width: int) -> None:
    """Beyond half of the counter's range per period the sign is ambiguous."""
    half = 2 ** (width - 1)
    steps = np.linspace(0, 1.3 * half, 60).astype(np.int64)
    counts = np.cumsum(steps) % 2**width
    within = steps < half
    assert speeds(counts[within], width=width) == pytest.approx(steps[within][1:] * DELTA / DT)
    with pytest.raises(ConfigError, match=rf"of a {width} bit counter"):
        speeds(counts, width=width)


def test_a_gap_in_which_a_narrow_counter_may_have_gone_round_is_reported() -> None:
    true = 20 * np.arange(60)
    kept = np.delete(np.arange(60), np.arange(30, 37))  # 160 counts: more than half of 256
    with pytest.raises(ConfigError, match=r"counts\[30\].*of a 8 bit counter"):
        speeds((true % 256)[kept], elapsed=np.diff(kept, prepend=-1), width=8)


@pytest.mark.parametrize(
    ("counts", "width", "message"),
    [
        ([0, 70_000], 16, "do not fit"),
        ([-1, 65_535], 16, "do not fit"),
        ([0, 128], 8, r"counts\[1\] is 128 after 0"),
        ([0, 1], 1, "width = 1"),
        ([0, 1], 65, "width = 65"),
        ([0, 1], True, "width = True"),
        ([0, 1], 12.5, "width = 12.5"),
        ([0, 3 * 2**31, 2**40], None, "more than half"),
    ],
)
def test_a_width_that_cannot_be_is_refused(counts: Any, width: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        speeds(counts, width=width)


@given(
    steps=st.lists(st.integers(-100, 100), min_size=2, max_size=60),
    start=st.integers(-(2**31), 2**31),
    width=st.integers(10, 32),
    signed=st.booleans(),
)
def test_unwrapping_finds_every_slow_motion(steps: list[int], start: int, width: int, signed: bool) -> None:
    true, least = start + np.cumsum(steps), 2 ** (width - 1) if signed else 0
    found = speeds((true + least) % 2**width - least, width=width)
    assert found == pytest.approx(np.diff(true) * DELTA / DT, abs=1e-9)
