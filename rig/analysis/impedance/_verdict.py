"""Judge from a measured impedance whether a wall is passive, and compute its deviation from the ideal wall.

A port is *passive* if the real part of its impedance is not negative; equivalently, if its phase stays within ±90°,
which is the test of the second paper (Chawda et al.). Measured lines have noise, and a stiff wall comes within a degree
of −90° at low frequencies ((b + B − K·T/2)·ω/K rad). So each spectral line gets a tolerance t of `z_score` standard
deviations: it fails if Re Ẑ < −t, which means a phase beyond ±(90° + asin(t/|Ẑ|)). With a z-score of 0 the test is that
of the paper. The residual power between the spectral lines is a second test.

*Fidelity* is defined as in the second paper: root mean square over the lines of |Ẑ| − |K/(jω) + B|. The rig's inertia
dominates it (1.886·f N·s/m for 0.52 kg up to f Hz), and it depends on band and lines: report it with band and lines.

*Effective stiffness* −ω·Im Z and *effective damping* Re Z of the wall without the rig are weighted means over the lines
of a low band, in per cent of the requested values. *Distortion* is a relative error similar to Colonnese's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rig.analysis.impedance._estimate import Impedance
from rig.analysis.impedance._fitting import Fit, RigidRig, fit
from rig.analysis.impedance._signals import Complexes, Floats

Z_SCORE = 2.0  # standard deviations by which a real part must be below zero to count
# Share of the motion's power off the lines above which a wall does not count as passive: a chattering estimator passes
# the test at the lines with most of its motion out of step with the excitation.
RESIDUAL = 0.1
# Up to here, where hands act, effective stiffness and damping are averaged: as the frequency rises, delays and filters
# turn stiffness into negative damping, and damping into stiffness.
EFFECTIVE_HZ = 20.0
# With fewer lines a misfit of stiffness and damping could not be seen.
EFFECTIVE_LINES = 3
# A line with a lower coherence γ² of the motion says nothing about passivity.
COHERENCE = 0.5


@dataclass(frozen=True, slots=True)
class Passivity:
    """Result of the passivity test Re Z ≥ −tolerance of an impedance Z at each excited frequency ("line").

    Attributes
    ----------
    passive
        True if no line fails.
    tested, failed_hz
        Number of lines in the band, and the frequencies of the spectral lines that fail (Hz).
    worst_hz
        Frequency of the line with the smallest Re Ẑ + tolerance (Hz).
    worst_real, worst_tolerance, worst_phase_deg
        Re Ẑ at `worst_hz`, its tolerance (both N·s/m or N·m·s/rad), and the phase of Ẑ (degrees).
    margin
        Smallest Re Ẑ + tolerance over the lines (N·s/m or N·m·s/rad); below zero if the test fails.
    phase_margin_deg
        Smallest 90° + asin(tolerance/|Ẑ|) − |phase| over the lines (degrees); it has the sign of `margin`.
    band_hz, z_score
        Lowest and highest frequency of the test (Hz), and its tolerance in standard deviations.
    """

    passive: bool
    tested: int
    failed_hz: tuple[float, ...]
    worst_hz: float
    worst_real: float
    worst_tolerance: float
    worst_phase_deg: float
    margin: float
    phase_margin_deg: float
    band_hz: tuple[float, float]
    z_score: float


@dataclass(frozen=True, slots=True)
class PassivityJudgement:
    """Judgement of whether a measured wall is passive; `reasons` is empty if the wall is judged passive."""

    passive: bool
    reasons: tuple[str, ...]
    passivity: Passivity
    residual: float
    residual_threshold: float
    least_coherence: float


@dataclass(frozen=True, slots=True)
class Fidelity:
    """Deviation of a rendered wall from the requested wall.

    Attributes
    ----------
    rms
        Root mean square over the spectral lines of |Ẑ| − |K/(jω) + B| (N·s/m or N·m·s/rad).
    rms_deviation
        Standard deviation of `rms` (same unit), if the lines are independent.
    noise_rms
        The `rms` that noise alone would give (same unit): differences below it do not rank two walls.
    stiffness, damping
        Effective stiffness and damping over `effective_band_hz` (SI), after subtraction of the rig's own impedance if
        it was given (otherwise the rig's inertia makes the stiffness too small). NaN with fewer than `EFFECTIVE_LINES`
        lines in that band.
    stiffness_deviation, damping_deviation
        Standard deviations of `stiffness` and `damping`, misfit included. They do not contain the damping by Coulomb
        friction, which depends on the excitation's band and size: compare only walls that were excited alike.
    stiffness_percent, damping_percent
        Effective stiffness and damping in per cent of the requested values; NaN if the requested value is zero.
    effective_band_hz, effective_lines
        Lowest and highest frequency (Hz) and number of the lines over which stiffness and damping are fitted.
    distortion
        Mean over the lines of weight · |Ẑ − Z|/|Z|, Z = K/(jω) + B: the average distortion error of Colonnese and
        Okamura in the form of Chawda et al. Their own text was not available, so weights and spacing of frequencies
        differ from theirs and published values are not comparable. NaN if K = B = 0.
    lines, band_hz
        Number of lines, and lowest and highest frequency of the band (Hz): all results depend on both.
    """

    rms: float
    rms_deviation: float
    noise_rms: float
    stiffness: float
    stiffness_deviation: float
    stiffness_percent: float
    damping: float
    damping_deviation: float
    damping_percent: float
    effective_band_hz: tuple[float, float]
    effective_lines: int
    distortion: float
    lines: int
    band_hz: tuple[float, float]


def passive(
    impedance: Impedance, band: tuple[float, float] | None = None, z_score: float = Z_SCORE
) -> Passivity:
    """Test at each spectral line of a band that the impedance's real part is at least −tolerance; return the result.

    Parameters
    ----------
    impedance
        Measured or exact impedance.
    band
        Lowest and highest frequency of the spectral lines to test (Hz, ends included); all spectral lines if left out.
    z_score
        Tolerance in standard deviations of each real part (`Impedance.spread`). The tolerance is zero if `z_score` is 0
        or the variance is unknown. Of lines exactly at the limit 2.3 % fail by chance with a z-score of 2.

    Raises
    ------
    ConfigError
        The band contains no line.
    """
    part = impedance.within(band)
    tolerance = np.nan_to_num(part.spread(z_score)) if z_score > 0.0 else np.zeros(len(part.z))
    room = part.z.real + tolerance
    room = np.where(np.isfinite(part.z), room, -math.inf)
    failed = room < 0.0
    worst = int(np.argmin(room))
    size = np.abs(part.z)
    share = np.divide(tolerance, size, out=np.full(len(size), 2.0), where=size > tolerance)
    # Where the uncertainty exceeds the value, any phase is compatible with it.
    wider = np.where(share > 1.0, 180.0, np.degrees(np.arcsin(np.minimum(share, 1.0))))
    turned = np.where(np.isfinite(part.z), 90.0 + wider - np.abs(part.phase_deg), -math.inf)
    return Passivity(
        passive=not failed.any(),
        tested=len(part.z),
        failed_hz=tuple(part.lines_hz[failed].tolist()),
        worst_hz=float(part.lines_hz[worst]),
        worst_real=float(part.z.real[worst]),
        worst_tolerance=float(tolerance[worst]),
        worst_phase_deg=float(part.phase_deg[worst]),
        margin=float(room[worst]),
        phase_margin_deg=float(turned.min()),
        band_hz=band or (float(part.lines_hz[0]), float(part.lines_hz[-1])),
        z_score=z_score,
    )


def judge(
    impedance: Impedance,
    band: tuple[float, float] | None = None,
    *,
    z_score: float = Z_SCORE,
    residual_threshold: float = RESIDUAL,
    least_coherence: float = COHERENCE,
) -> PassivityJudgement:
    """Judge from its measured impedance whether a wall is passive; return the judgement with its reasons.

    A wall is not passive if the real part of the impedance is too low, the residual power too high or the coherence too
    low. A residual or coherence that cannot be computed from the record (NaN) is ignored.
    """
    found = passive(impedance, band, z_score)
    part = impedance.within(band)
    reasons = []
    if not found.passive:
        reasons.append(
            f"Re Z is {found.worst_real:.4g} at {found.worst_hz:g} Hz (phase {found.worst_phase_deg:.2f}°, "
            f"tolerance {found.worst_tolerance:.2g}); {len(found.failed_hz)} of {found.tested} lines fail"
        )
    if impedance.residual > residual_threshold:
        reasons.append(
            f"{impedance.residual:.0%} of the motion's power is off the excited lines, "
            f"more than {residual_threshold:.0%}"
        )
    seen = part.coherence_motion[np.isfinite(part.coherence_motion)]
    least = float(seen.min()) if len(seen) else math.nan
    if least < least_coherence:
        at = float(part.lines_hz[int(np.nanargmin(part.coherence_motion))])
        reasons.append(f"the motion's coherence is {least:.2f} at {at:g} Hz, below {least_coherence:g}")
    return PassivityJudgement(
        not reasons, tuple(reasons), found, impedance.residual, residual_threshold, least
    )


def fidelity(
    impedance: Impedance,
    stiffness: float,
    damping: float,
    band: tuple[float, float] | None = None,
    *,
    device: RigidRig | Complexes | None = None,
    effective_hz: float = EFFECTIVE_HZ,
    weight: Callable[[Floats], Floats] | None = None,
) -> Fidelity:
    """Compare a rendered wall with the ideal wall K/(jω) + B; return errors, and effective stiffness and damping.

    Parameters
    ----------
    impedance
        Measured or exact impedance of rig and wall together.
    stiffness, damping
        Requested stiffness and damping (N/m or N·m/rad, N·s/m or N·m·s/rad).
    band
        Lowest and highest frequency of the spectral lines to use (Hz); all spectral lines if left out.
    device
        The rig's own impedance, as a `RigidRig` or as values at all lines of `impedance`: subtracted before K and B are
        fitted. It is not subtracted for `rms` and `distortion`, as in the papers.
    effective_hz
        Highest frequency at which effective stiffness and damping are fitted (Hz).
    weight
        Weight of each spectral line in `distortion`, a function of frequency (Hz); 1 if left out.

    Notes
    -----
    For an ideal sampled wall the effective damping is B − K·T/2, not B: the hold subtracts K·T/2.

    Raises
    ------
    ConfigError
        The band contains no line.
    """
    part = impedance.within(band)
    s = 2j * np.pi * part.lines_hz
    asked = stiffness / s + damping
    error = part.magnitude - np.abs(asked)
    variance = 0.5 * part.variance
    rms = math.sqrt(float(np.mean(error**2)))
    doubt = math.sqrt(float(np.mean(error**2 * variance)) / len(error)) / rms if rms > 0.0 else 0.0
    low_hz, high_hz = float(part.lines_hz[0]), min(effective_hz, float(part.lines_hz[-1]))
    low = int((part.lines_hz <= effective_hz * (1.0 + 1e-9)).sum())
    added = Fit.unknown("stiffness", "damping")
    if low >= EFFECTIVE_LINES:
        added = fit(impedance, ("stiffness", "damping"), band=(low_hz, high_hz), subtract=device)
    weights = np.ones(len(s)) if weight is None else weight(part.lines_hz)
    size = np.abs(asked)
    return Fidelity(
        rms=rms,
        rms_deviation=doubt,
        noise_rms=math.sqrt(float(np.mean(variance))),
        stiffness=added.values["stiffness"],
        stiffness_deviation=added.deviations["stiffness"],
        stiffness_percent=100.0 * added.values["stiffness"] / stiffness if stiffness else math.nan,
        damping=added.values["damping"],
        damping_deviation=added.deviations["damping"],
        damping_percent=100.0 * added.values["damping"] / damping if damping else math.nan,
        effective_band_hz=(low_hz, high_hz),
        effective_lines=low,
        distortion=float(np.mean(weights * np.abs(part.z - asked) / size)) if size.all() else math.nan,
        lines=len(s),
        band_hz=band or (float(part.lines_hz[0]), float(part.lines_hz[-1])),
    )
