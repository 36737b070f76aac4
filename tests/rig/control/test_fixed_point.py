"""Fixed-point arithmetic against exact fractions, and the effect of rounding on a low-pass filter."""

from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from rig.control._fixed_point import (
    FLOOR,
    NEAREST,
    ROUNDINGS,
    ZERO,
    Format,
    design_biquad,
    divide,
    saturate,
    shift_right,
)
from rig.core.errors import ConfigError
from tests.conformance.fixed_law import clipped, rounded

VALUE = st.integers(-(2**61), 2**61)
ROUNDING = st.sampled_from((FLOOR, ZERO, NEAREST))
STATE = Format(32, 16)


@given(value=VALUE, bits=st.integers(0, 61), rounding=ROUNDING)
def test_shift_divides_with_the_named_rounding(value: Any, bits: int, rounding: Any) -> None:
    assert shift_right(value, bits, rounding) == rounded(Fraction(value, 2**bits), rounding)


@given(value=VALUE, denominator=st.integers(1, 2**61), rounding=ROUNDING)
def test_a_division_rounds_as_it_says(value: Any, denominator: int, rounding: Any) -> None:
    assert divide(value, denominator, rounding) == rounded(Fraction(value, denominator), rounding)


@given(value=st.integers(-(2**63), 2**63 - 1), bits=st.integers(1, 63))
def test_value_beyond_its_word_saturates(value: int, bits: int) -> None:
    assert saturate(value, bits) == clipped(value, bits)


def test_a_format_knows_its_name_its_step_and_its_ends() -> None:
    q = Format(16, 12)
    assert (str(q), q.lsb, q.limits) == ("Q4.12", 2**-12, (-32768, 32767))
    assert q.quantised(-8.0) == -32768
    assert q.quantised(0.5 * q.lsb) == 1  # halves towards +∞
    assert q.quantised(-0.5 * q.lsb) == 0
    with pytest.raises(ConfigError, match=r"gain = 8 does not fit the format Q4\.12.*7\.99.*longer word"):
        q.quantised(8.0, "gain")


@given(value=st.floats(-100, 100, allow_subnormal=False))
def test_quantising_is_rounding_of_the_exact_value(value: float) -> None:
    assert Format(48, 30).quantised(value) == rounded(Fraction(value) * 2**30, NEAREST)


# --- a low pass in rounded coefficients -------------------------------------------------------------------


def low_pass(relative_cutoff: float, bits: int = 14, **options: Any) -> Any:
    b, a = signal.butter(2, relative_cutoff, fs=1.0)
    return design_biquad(b, a, coefficient_bits=bits, state=STATE, **options)


def at_rest(f: Any) -> int:
    return 2**f.coefficient_bits + f.a1 + f.a2


@pytest.mark.parametrize("relative_cutoff", [0.02, 0.05, 0.1, 0.2, 0.45])
def test_the_gain_at_rest_is_one_to_the_bit(relative_cutoff: float) -> None:
    f = low_pass(relative_cutoff)
    assert f.b0 + f.b1 + f.b2 == at_rest(f)
    assert f.dc_gain == 1.0


def test_coefficients_that_round_the_gain_at_rest_to_zero_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"gain at rest is 0\b.*more coefficient_bits than 14"):
        low_pass(0.0012, unit_gain=False)  # b is a quarter, half and a quarter of an LSB


@given(cutoff=st.floats(0.02, 0.49), bits=st.integers(12, 30), word=st.integers(20, 48))
def test_no_design_that_is_accepted_can_overflow(cutoff: float, bits: int, word: int) -> None:
    b, a = signal.butter(2, cutoff, fs=1.0)
    try:
        f = design_biquad(b, a, coefficient_bits=bits, state=Format(word, 8))
    except ConfigError:
        return
    worst = sum(abs(c) for c in (f.b0, f.b1, f.b2, f.a1, f.a2)) * 2 ** (word - 1)
    assert worst + 2**bits < 2**63


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("relative_cutoff", [0.02, 0.05, 0.1])
def test_dead_zone_is_where_a_filter_may_rest(relative_cutoff: float, rounding: Any) -> None:
    """Brute force: try every output y that y = round(−(a1 + a2)·y) may keep for ever."""
    f = low_pass(relative_cutoff, rounding=rounding)
    one = 2**f.coefficient_bits
    reach = 2 * int(f.dead_zone) + 2
    rest = [
        y for y in range(-reach, reach + 1) if rounded(Fraction(-(f.a1 + f.a2) * y, one), f.rounding) == y
    ]
    error = Fraction(1, 2) if rounding == "nearest" else 1
    assert f.dead_zone == float(error * one / at_rest(f))
    if rounding == "zero":
        assert rest == [0]
    else:
        assert rest[0] == -int(f.dead_zone)  # no tie in these designs
        assert rest[-1] == (int(f.dead_zone) if rounding == "nearest" else 0)
