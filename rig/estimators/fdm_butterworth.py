"""Finite difference through a second-order Butterworth low pass: what both papers compare everything with.

The filter is the bilinear, prewarped design of scipy (``butter(2, cutoff_hz, fs=1/T2)``), run as one biquad
in transposed direct form II. Its delay at zero frequency is √2·T/(2·tan(π·f_c·T)): 1.088 ms for 200 Hz at 2
kHz, to which the difference adds T/2 and the hold between velocity samples another T/2. Source: Koul et
al., section III (f_c = 200 Hz at T2 = 2 kHz); Chawda et al., section II.A.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from firmware_protocol.kernel import kernel
from rig.errors import ConfigError
from rig.estimators import fdm
from rig.estimators.estimator import COMMON, Estimator, Floats, Ints, Setting
from rig.plugs import ESTIMATOR_SIGNATURE

B0, B1, B2, A1, A2 = range(COMMON, COMMON + 5)  # parameters
S1, S2, OUTPUT = 0, 1, 2  # state_f
DC_GAIN_TOLERANCE = 1e-6  # rounding of the coefficients must not scale velocities
LONGEST_GAP = 1000  # after more lost periods the filter has settled whatever the memory was


@kernel(ESTIMATOR_SIGNATURE)
def update(
    count: int, edge_age_s: float, elapsed_ticks: int, state_f: Floats, state_i: Ints, parameters: Floats
) -> float:
    """Filtered velocity; over a gap the filter runs once for each lost period on the mean slope."""
    slope = fdm.update(count, edge_age_s, elapsed_ticks, state_f, state_i, parameters)
    s1, s2, out = state_f[S1], state_f[S2], state_f[OUTPUT]
    for _ in range(min(elapsed_ticks, LONGEST_GAP)):
        out = parameters[B0] * slope + s1
        s1 = parameters[B1] * slope - parameters[A1] * out + s2
        s2 = parameters[B2] * slope - parameters[A2] * out
    state_f[S1], state_f[S2], state_f[OUTPUT] = s1, s2, out
    return float(out)


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Coefficients b0, b1, b2, a1, a2 of the biquad; `ConfigError` for a cut-off at or above Nyquist."""
    from scipy.signal import butter  # noqa: PLC0415  (slow to import, and only needed here)

    cutoff_hz = settings["cutoff_hz"]
    nyquist_hz = 0.5 / period_s
    if cutoff_hz >= nyquist_hz:
        raise ConfigError(
            f"estimator fdm-butterworth: cutoff_hz = {cutoff_hz:g} Hz is not below Nyquist {nyquist_hz:g} Hz",
            remedy=f"choose a lower one, usually {0.2 * nyquist_hz:g} Hz, or raise velocity_rate",
        )
    b, a = butter(2, cutoff_hz, fs=1.0 / period_s)
    dc_gain = b.sum() / a.sum()
    if abs(dc_gain - 1.0) > DC_GAIN_TOLERANCE:
        raise ConfigError(
            f"estimator fdm-butterworth: at cutoff_hz = {cutoff_hz:g} Hz and {1.0 / period_s:g} Hz its gain at rest is "
            f"{dc_gain:.9f} instead of 1",
            remedy="choose a higher cutoff_hz or a lower velocity_rate",
        )
    return [float(b[0]), float(b[1]), float(b[2]), float(a[1]), float(a[2])]


ESTIMATOR = Estimator(
    name="fdm-butterworth",
    summary="finite difference and a second-order Butterworth low pass",
    source="Koul et al., section III; Chawda et al., section II.A",
    update=update,
    floats=3,
    ints=fdm.INTS,
    settings=(Setting("cutoff_hz", 200.0, 0.1, 1e6, "Hz", "-3 dB frequency of the low pass"),),
    design=design,
)
