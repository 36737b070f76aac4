"""Finite difference and Butterworth low pass in fixed point, bit for bit as an FPGA or a microcontroller computes it.

It is the filter of `rig.control.estimators._fdm_butterworth` with order 2, on integers. Velocities are counts per
velocity period (time between two velocity samples) in the format Q(w−f).f, with w = `word_bits` and f = `state_bits`;
coefficients have `coefficient_bits` fractional bits; products are summed exactly in 64 bits and rounded once per
period. `rig.control._fixed_point` explains the rounding and its effects on a low pass. Velocities beyond ±2^(w−1−f)
counts a period saturate: 32768 with the defaults. Experiments name it ``fdm-butterworth-fixed``. Its update must not
allocate.

Source: Koul et al., section III ("second-order fixed-point Butterworth"); its word length and rounding are not given.
"""

from collections.abc import Mapping
from typing import Any

from rig.control._fixed_point import (
    ROUNDINGS,
    WIDEST,
    Biquad,
    Format,
    design_biquad,
    divide,
    saturate,
    shift_right,
)
from rig.control.estimators import _fdm as fdm
from rig.control.estimators._fdm_butterworth import LONGEST_GAP, low_pass
from rig.control.estimators.estimator import (
    COMMON,
    RESOLUTION,
    WINDOW,
    Choice,
    Estimator,
    Floats,
    Ints,
    Setting,
)
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

# parameters: integers but for the last, which is the velocity of one LSB of the output in counts per second
B0, B1, B2, A1, A2, COEFFICIENT_BITS, STATE_BITS, WORD_BITS, ROUNDING, SCALE = range(COMMON, COMMON + 10)
X1, X2, Y1, Y2 = range(fdm.INTS, fdm.INTS + 4)  # state_i: inputs and outputs of the last two periods
NUMERATORS = ("unit-gain", "nearest")


@kernel(ESTIMATOR_SIGNATURE, no_refcount=True)
def update(
    count: int,
    edge_age_s: float,
    elapsed_ticks: int,
    effort: float,
    state_f: Floats,
    state_i: Ints,
    parameters: Floats,
) -> float:
    """Return the velocity (rad/s or m/s) at a new encoder count, low-pass filtered in fixed point."""
    if state_i[fdm.STARTED] == 0:
        state_i[fdm.STARTED] = 1
        state_i[fdm.PREVIOUS] = count
    else:
        state_i[WINDOW] = elapsed_ticks
    moved = fdm.count_difference(count, state_i[fdm.PREVIOUS])
    state_i[fdm.PREVIOUS] = count

    word_bits, rounding = int(parameters[WORD_BITS]), int(parameters[ROUNDING])
    x = moved << int(parameters[STATE_BITS])
    if elapsed_ticks > 1:
        x = divide(x, elapsed_ticks, rounding)
    x = saturate(x, word_bits)

    b0, b1, b2 = int(parameters[B0]), int(parameters[B1]), int(parameters[B2])
    a1, a2, bits = int(parameters[A1]), int(parameters[A2]), int(parameters[COEFFICIENT_BITS])
    x1, x2, y1, y2 = state_i[X1], state_i[X2], state_i[Y1], state_i[Y2]
    for _ in range(min(elapsed_ticks, LONGEST_GAP)):
        # Direct form I: the state is input and output themselves, so that no hidden sum can overflow.
        total = b0 * x + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2
        x1, x2 = x, x1
        y1, y2 = saturate(shift_right(total, bits, rounding), word_bits), y1
    state_i[X1], state_i[X2], state_i[Y1], state_i[Y2] = x1, x2, y1, y2
    return float(y1 * parameters[SCALE] * parameters[RESOLUTION])


def biquad(settings: Mapping[str, Any], period_s: float) -> Biquad:
    """Return the integer coefficients of the low pass in fixed point, with its gain at rest and its dead zone.

    Raises `ConfigError` if a number of bits is not whole, the cut-off is at or above Nyquist, or the words are too
    short for the filter or too long for sums of 64 bits (`rig.control._fixed_point.design_biquad`).
    """
    for name in ("coefficient_bits", "state_bits", "word_bits"):
        if settings[name] != int(settings[name]):
            raise ConfigError(
                f"estimator fdm-butterworth-fixed: {name} = {settings[name]:g} must be a whole number",
                remedy="give a whole number of bits",
            )
    state = Format(int(settings["word_bits"]), int(settings["state_bits"]))
    if state.word_bits - state.fraction_bits < 2:
        raise ConfigError(
            f"estimator fdm-butterworth-fixed: the format {state} cannot represent one count per period",
            remedy="choose word_bits at least two above state_bits",
        )
    section = low_pass("fdm-butterworth-fixed", 2, settings["cutoff_hz"], period_s)[0]
    return design_biquad(
        section[:3],
        section[3:],
        coefficient_bits=int(settings["coefficient_bits"]),
        state=state,
        rounding=settings["rounding"],
        unit_gain=settings["numerator"] == "unit-gain",
    )


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the low pass in integers: coefficients b0, b1, b2, a1, a2, word sizes (bits), rounding and scale."""
    f = biquad(settings, period_s)
    form = [f.coefficient_bits, f.state.fraction_bits, f.state.word_bits, f.rounding]
    return [float(n) for n in (f.b0, f.b1, f.b2, f.a1, f.a2, *form)] + [f.state.lsb / period_s]


ESTIMATOR = Estimator(
    name="fdm-butterworth-fixed",
    summary="finite difference and a second-order Butterworth low pass, in fixed point",
    source="Koul et al., section III",
    update=update,
    floats=0,
    ints=fdm.INTS + 4,
    settings=(
        Setting("cutoff_hz", 200.0, 0.1, 1e6, "Hz", "-3 dB frequency of the low pass"),
        Setting("coefficient_bits", 14, 2, 30, "bit", "fractional bits of the coefficients"),
        # With 16, rounding costs less than 1e-4 counts a period at f_c = fs/10. With 2 to 4, the reading of the FPGA of
        # Koul et al. that explains its figure 7, a dead zone decides: at f_c = fs/20 with 4 bits, rounded to zero, all
        # motion below 0.78 counts a period (2.4 rad/s at 20 kHz) reads as rest.
        Setting("state_bits", 16, 0, 30, "bit", "fractional bits of input and output (counts per period)"),
        Setting(
            "word_bits", 32, 4, WIDEST, "bit", "length of their saturating words, sign and fraction included"
        ),
        Choice("rounding", "nearest", ROUNDINGS, "how each output is rounded to its word"),
        Choice(
            "numerator", "unit-gain", NUMERATORS, "exact gain at rest, or each coefficient rounded by itself"
        ),
    ),
    design=design,
)
