"""Finite difference and a Butterworth low pass; with order 2 it is the reference of both papers.

The filter is the bilinear, prewarped design (`rig.control._butterworth`), run as second-order sections in transposed
direct form II. Its delay at zero frequency is √2·T/(2·tan(π·f_c·T)): 1.088 ms for
200 Hz at 2 kHz, to which the difference adds T/2 and the hold between velocity samples another T/2. For order n, √2
becomes 1/sin(π/2n): 1 for order 1, 2 for order 3, 2.61 for order 4. Source: Koul et al., section III (f_c = 200 Hz at
T2 = 2 kHz); Chawda et al., section II.A.

Experiments name it ``fdm-butterworth``. Its update must not allocate.
"""

from collections.abc import Mapping
from typing import Any

from rig.control import _butterworth as butterworth
from rig.control.estimators import _fdm as fdm
from rig.control.estimators.estimator import COMMON, Estimator, Floats, Ints, Setting, check_below_nyquist
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

# parameters: for each section b0, b1, b2, a1, a2; state_f: two for each section
B0, B1, B2, A1, A2 = range(COMMON, COMMON + 5)
S1, S2 = 0, 1
SECTION, STATES = 5, 2  # of each
HIGHEST_ORDER = 8
DC_GAIN_TOLERANCE = 1e-6  # rounding of the coefficients must not scale velocities
LONGEST_GAP = 1000  # after more lost periods the filter has settled whatever the memory was


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
    """Return the low-pass filtered velocity (rad/s or m/s) at a new encoder count, also after lost samples."""
    slope = fdm.update(count, edge_age_s, elapsed_ticks, effort, state_f, state_i, parameters)
    out = slope
    for _ in range(min(elapsed_ticks, LONGEST_GAP)):
        # The first section outside of the loop: most filters have no other.
        s1, s2 = state_f[S1], state_f[S2]
        out = parameters[B0] * slope + s1
        state_f[S1] = parameters[B1] * slope - parameters[A1] * out + s2
        state_f[S2] = parameters[B2] * slope - parameters[A2] * out
        p, s = SECTION, STATES
        # Not a range with a step, whose length numba finds by a division that costs as much as a section.
        while p + A2 < parameters.shape[0]:
            value = out
            out = parameters[p + B0] * value + state_f[s + S1]
            state_f[s + S1] = parameters[p + B1] * value - parameters[p + A1] * out + state_f[s + S2]
            state_f[s + S2] = parameters[p + B2] * value - parameters[p + A2] * out
            p, s = p + SECTION, s + STATES
    return float(out)


def low_pass(name: str, order: int, cutoff_hz: float, period_s: float) -> list[list[float]]:
    """Return the second-order sections (b0, b1, b2, 1, a1, a2) of a Butterworth low pass for a velocity period (s).

    Raises `ConfigError` (its message names the estimator `name`) if the cut-off is at or above Nyquist, or so far below
    the rate that rounding of the coefficients changes the gain at rest.
    """
    check_below_nyquist(name, "cutoff_hz", cutoff_hz, period_s, f"usually {0.1 / period_s:g} Hz, ")
    sections = butterworth.low_pass(order, cutoff_hz, 1.0 / period_s)
    dc_gain = 1.0
    for section in sections:
        dc_gain *= sum(section[:3]) / sum(section[3:])
    if abs(dc_gain - 1.0) > DC_GAIN_TOLERANCE:
        raise ConfigError(
            f"estimator {name}: with cutoff_hz = {cutoff_hz:g} Hz at a rate of {1.0 / period_s:g} Hz, the low pass has "
            f"the gain {dc_gain:.9f} at rest instead of 1, by rounding",
            remedy="choose a higher cutoff_hz or a lower velocity_rate",
        )
    return sections


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the coefficients b0, b1, b2, a1, a2 of all sections of the low pass, in one list."""
    order = settings["order"]
    if order != int(order):
        raise ConfigError(
            f"estimator fdm-butterworth: order = {order:g} must be a whole number", remedy="choose 1, 2, … 8"
        )
    sections = low_pass("fdm-butterworth", int(order), settings["cutoff_hz"], period_s)
    return [value for b0, b1, b2, _, a1, a2 in sections for value in (b0, b1, b2, a1, a2)]


ESTIMATOR = Estimator(
    name="fdm-butterworth",
    summary="finite difference and a Butterworth low pass, of second order unless chosen otherwise",
    source="Koul et al., section III; Chawda et al., section II.A",
    update=update,
    floats=HIGHEST_ORDER,
    ints=fdm.INTS,
    settings=(
        Setting("cutoff_hz", 200.0, 0.1, 1e6, "Hz", "-3 dB frequency of the low pass"),
        Setting("order", 2, 1, HIGHEST_ORDER, "1", "order of the low pass, a whole number"),
    ),
    design=design,
)
