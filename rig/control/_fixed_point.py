"""Fixed-point arithmetic of an FPGA or a microcontroller without FPU, bit-exact, on int64.

A number is an integer that stands for integer · 2^−f. Its format is written Q*m.f*: m bits before the binary point,
the sign's among them, and f behind it, in a word of w = m + f bits, two's complement: −2^(w−1) … 2^(w−1) − 1.

* A value that does not fit *saturates*.
* Sums of products are exact, in 64 bits, and *rounded once*, when they are shifted back to their format.
  Designs (`design_biquad`, `rig.control._fixed_wall.design_wall`) prove that no sum overflows.
* Rounding is ``floor`` (arithmetic shift, like ``>>``), ``zero`` (towards zero, like ``/`` in C) or ``nearest`` (half a
  unit is added before the shift: halves are rounded towards +∞, also in `rig.control._guard`).

Source: Koul et al., section III, whose FPGA filtered in fixed point of a word length that the paper does not give.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel

ROUNDINGS = ("floor", "zero", "nearest")
FLOOR, ZERO, NEAREST = range(3)  # indices into ROUNDINGS, which is what kernels take
WIDEST = 48  # bits of a word
GREATEST = 2**63 - 1  # of a sum
TOLERANCE = 0.1  # relative error of gain at rest, and of 1 + a1 + a2, that a design may have


@kernel("i8(i8, i8, i8)", inline=True)
def shift_right(value: int, bits: int, rounding: int) -> int:
    """Return value / 2^bits (0 ≤ bits ≤ 62), rounded by the rule `rounding`, an index into `ROUNDINGS`."""
    if rounding == NEAREST:
        value += (1 << bits) >> 1
    elif rounding == ZERO and value < 0:
        value += (1 << bits) - 1
    return value >> bits


@kernel("i8(i8, i8, i8)", inline=True)
def divide(numerator: int, denominator: int, rounding: int) -> int:
    """Return numerator / denominator (above 0), rounded by the rule `rounding`, an index into `ROUNDINGS`."""
    if rounding == NEAREST:
        numerator += denominator >> 1
    elif rounding == ZERO and numerator < 0:
        numerator += denominator - 1
    return numerator // denominator


@kernel("i8(i8, i8)", inline=True)
def saturate(value: int, word_bits: int) -> int:
    """Return the value limited to the range of a two's complement word of `word_bits` bits."""
    # Not wrapped, as two's complement would: a velocity that wrapped would push the wrong way.
    limit = 1 << (word_bits - 1)
    return min(max(value, -limit), limit - 1)


@dataclass(frozen=True, slots=True)
class Format:
    """Fixed-point format Qm.f: words of `word_bits` bits, of which `fraction_bits` are behind the binary point."""

    word_bits: int
    fraction_bits: int

    def __str__(self) -> str:
        return f"Q{self.word_bits - self.fraction_bits}.{self.fraction_bits}"

    @property
    def lsb(self) -> float:
        """Return the value of the least significant bit of this format."""
        return 2.0**-self.fraction_bits

    @property
    def limits(self) -> tuple[int, int]:
        """Return the least and the greatest integer of a word of this format."""
        return -(1 << (self.word_bits - 1)), (1 << (self.word_bits - 1)) - 1

    def quantised(self, value: float, what: str = "a value") -> int:
        """Return the nearest integer of this format, halves towards +∞; raise `ConfigError` if `what` does not fit."""
        numerator, denominator = value.as_integer_ratio()
        integer = (2 * (numerator << self.fraction_bits) + denominator) // (2 * denominator)
        least, greatest = self.limits
        if not least <= integer <= greatest:
            raise ConfigError(
                f"{what} = {value:g} does not fit the format {self}, whose largest value is {greatest * self.lsb:g}",
                remedy="choose a longer word or fewer fractional bits",
            )
        return integer


# Effects of rounding on a low pass, in units of the last bit of its output (LSB), with S = 1 + a1 + a2. A steady output
# solves S·y = Σb·x + ε. The rounding error ε is within ±½ for nearest, −1 to 0 for floor, up to 1 towards zero for
# zero:
# Dead zone: the output for a steady input is wrong by up to e/S LSB; for a smaller input the output stays at zero from
# rest. e is ½ for nearest, 1 for floor and zero. S falls with the square of cut-off over rate: a filter without a dead
# zone of a count at 2 kHz may have one at 20 kHz.
# Bias: with floor the output after a motion in either direction stays below zero, by up to 1/S LSB (a low pass
# overshoots). With nearest it stays up to ½/S LSB above or below zero; with zero it returns to zero.
# Gain at rest: Σb/S of the rounded coefficients; at a low cut-off it can be any value, including zero.
# Limit cycles: errors of changing sign can add up to e·Σ|g| LSB at most, g the impulse response of 1/A(z).
@dataclass(frozen=True, slots=True)
class Biquad:
    """A second-order low pass in fixed point, with its gain at rest and dead zone after rounding.

    Run it in direct form I with one rounding,

        y = saturate(shift_right(b0·x + b1·x1 + b2·x2 − a1·y1 − a2·y2, coefficient_bits, rounding), state.word_bits),

    with x and y in the format `state`. `dead_zone` (LSB of `state`) is the largest error for a steady input.
    """

    b0: int
    b1: int
    b2: int
    a1: int
    a2: int
    coefficient_bits: int
    state: Format
    rounding: int
    dc_gain: float
    dead_zone: float


def design_biquad(
    b: Sequence[float],
    a: Sequence[float],
    *,
    coefficient_bits: int,
    state: Format,
    rounding: str = "nearest",
    unit_gain: bool = True,
) -> Biquad:
    """Return a low pass in fixed point: round its coefficients and check the filter that results.

    Parameters
    ----------
    b, a
        Coefficients b0, b1, b2 and 1, a1, a2 of a stable low pass with gain 1 at rest.
    coefficient_bits
        Fractional bits of the coefficients, whose words have three bits more: the sign, and two for values up to 2.
    state
        Format of input and output.
    rounding
        One of `ROUNDINGS`, for the output; coefficients are rounded to the nearest.
    unit_gain
        True: adjust b1 so that the gain at rest is exactly 1. False: keep each rounded coefficient.

    Raises
    ------
    ConfigError
        Too few bits: the filter is unstable, or the gain at rest or 1 + a1 + a2 changes by more than `TOLERANCE`. Too
        many bits: a sum could overflow 64 bits.
    """
    form = Format(coefficient_bits + 3, coefficient_bits)
    one = 1 << coefficient_bits
    a1, a2 = (form.quantised(float(value), "a coefficient") for value in a[1:])
    b0, b1, b2 = (form.quantised(float(value), "a coefficient") for value in b)
    at_rest = one + a1 + a2  # 1 + a1 + a2, which sets gain at rest, cut-off and dead zone
    more_bits = f"choose more coefficient_bits than {coefficient_bits}, a higher cut-off or a lower rate"
    wanted = float(sum(a)) * one
    if not (at_rest > 0 and abs(a1) < one + a2 and abs(a2) < one) or abs(at_rest / wanted - 1.0) > TOLERANCE:
        raise ConfigError(
            f"with coefficients in the format {form}, 1 + a1 + a2 = {wanted:.4g} LSB is rounded to {at_rest}, "
            f"which changes the filter's gain at rest by more than {100 * TOLERANCE:.0f} %",
            remedy=more_bits,
        )
    if unit_gain:
        b1 += at_rest - (b0 + b1 + b2)
    dc_gain = (b0 + b1 + b2) / at_rest
    if abs(dc_gain - 1.0) > TOLERANCE:
        raise ConfigError(
            f"with coefficients in the format {form} the filter's gain at rest is {dc_gain:.3g} instead of 1",
            remedy=more_bits,
        )
    largest = (abs(b0) + abs(b1) + abs(b2) + abs(a1) + abs(a2)) << (state.word_bits - 1)
    if largest + one > GREATEST:
        raise ConfigError(
            f"products of the formats {form} (coefficients) and {state} (signal) overflow 64 bits",
            remedy="choose shorter words, of at most 60 bits together",
        )
    index = ROUNDINGS.index(rounding)
    error = 0.5 if index == NEAREST else 1.0
    return Biquad(b0, b1, b2, a1, a2, coefficient_bits, state, index, dc_gain, error * one / at_rest)
