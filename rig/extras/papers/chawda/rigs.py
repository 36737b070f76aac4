"""Settings of the reproduction of Chawda et al.: rig, estimators, grids, and ways to judge passivity.

Values that the paper does not give are set here; where a value decides a result, its comment gives the reason.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

from rig import config
from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.experiments.mapping.interface import PAPER, PAPERS_SCHEMES, Printed

RIG = "chawda-linear"
SEED = 0

# The four estimators of section V with the paper's settings, in the order of its Table I.
FDM, FOAW, AKF, LEVANT = "FDM+filter", "FOAW", "AKF", "Levant"
SCHEMES = dict(zip((FDM, FOAW, AKF, LEVANT), map(Scheme.parse, PAPERS_SCHEMES), strict=True))

ESTIMATORS = tuple(SCHEMES)
FILTERS = (FDM, FOAW, AKF)
PRINTED: Mapping[str, Printed] = dict(zip(ESTIMATORS, PAPER.values(), strict=True))  # Table I, by estimator

FRICTIONLESS: Mapping[str, Any] = {"rig.mechanics.motor_coulomb": 0.0}
RENDERING_HZ = 1000.0
EXCITATION_RMS = 2.0  # N, ten times Coulomb friction; the same on a rig without friction
HIGHEST_LINE = 400.0  # Hz: 0.4 of the rendering rate
CONTROL_BAND = (1.0, HIGHEST_LINE)  # Hz, of the controls, whose values theory predicts

# --- readings: how a measured impedance may be read, of which the paper gives only ±90° --------------------

Kind = Literal["deviations", "degrees"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One passivity test: a frequency band, and a tolerance by which the phase of Z may exceed ±90°.

    `tolerance` is in standard deviations of Z at each measured frequency or in degrees, by `kind`; 0 allows no
    deviation.
    """

    low_hz: float
    high_hz: float
    tolerance: float
    kind: Kind = "deviations"

    @property
    def allowed(self) -> str:
        """Allowed phase of the impedance as text, such as ``±90° and 3°``."""
        if not self.tolerance:
            return "strictly ±90°"
        unit = " standard deviations" if self.kind == "deviations" else "°"
        return f"±90° and {self.tolerance:g}{unit}"

    @property
    def text(self) -> str:
        """Frequency band and allowed phase of the impedance as text, such as ``1 to 250 Hz, ±90° and 3°``."""
        return f"{self.low_hz:g} to {self.high_hz:g} Hz, {self.allowed}"


LOWEST_HZ = (1.0, 2.0, 5.0, 10.0)
HIGHEST_HZ = (100.0, 150.0, 200.0, 250.0, 300.0, 400.0)
TOLERANCES: tuple[tuple[float, Kind], ...] = (
    (0.0, "deviations"),
    (2.0, "deviations"),
    (4.0, "deviations"),
    (1.0, "degrees"),
    (3.0, "degrees"),
)
READINGS = tuple(
    Reading(low_hz=low, high_hz=high, tolerance=tolerance, kind=kind)
    for low, high, (tolerance, kind) in product(LOWEST_HZ, HIGHEST_HZ, TOLERANCES)
)
# Of the pictures and of Table I: what `rig impedance measure` and `rig impedance map` do by default.
MAIN = READINGS.index(Reading(low_hz=1.0, high_hz=250.0, tolerance=2.0))
RESIDUAL, COHERENCE = 0.1, 0.5  # as in rig.analysis.impedance._verdict

# --- wall hits ---------------------------------------------------------------------------------------------------

# A harder push from nearer than the preset's: 1600 kN/m still rests ten counts deep (a stiff wall looks stable when it
# gives by less than a few counts), and the handle arrives at 0.17 m/s. The limits of effort are declared, not the
# paper's; nothing of what is judged may saturate.
PUSH: Mapping[str, Any] = {
    "trial.effort": 16.0,
    "trial.start": -0.0005,
    "trial.minimum_rest_counts": 10.0,
    "rig.limits.effort": 300.0,
    "rig.amplifier.effort_limit": 300.0,
    "rig.limits.slew": 1.0e7,
    "homing.tolerance_counts": 10.0,
}
FIGURE_3_RATE = 10_000
LOWPASS_HZ = {
    FIGURE_3_RATE: 4000.0,
    1000: 400.0,
}  # of the velocity ripple: oscillations at this rate must pass
LOWEST_STIFFNESS = 2000.0  # N/m

# HBA-SC: Levant's special case of the homogeneity-based approach; LFBA: Lyapunov-function-based approach.
HBA_SC, LFBA, ADJUSTED, FILTERED = (
    "Levant, HBA-SC",
    "Levant, LFBA",
    "Levant, adjusted",
    "FDM + 1 kHz Butterworth",
)
FILTERED_SCHEME = Scheme.parse("uniform:10k,estimator=fdm-butterworth,cutoff_hz=1000")
# Gains (μ1, μ2): Levant's special case; and one inside the region of the Lyapunov function alone, with the λ that
# Levant recommends now. The paper prints neither its C nor its LFBA and adjusted gains.
GAINS = {HBA_SC: (1.1, 1.0), LFBA: (4.0, 1.5)}
# m/s²: values of C among which the adjusted gains are chosen.
CONSTANTS = (1.5, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0)


# --- Levant's differentiator otherwise -----------------------------------------------------------------------------

VARIANT_CONSTANTS = (6.0, 25.0)  # m/s²: as in the paper at 1 kHz, and as identified from a hit
VARIANT_FORMS = ("explicit", "semi-implicit", "implicit")
VARIANT_OUTPUTS = ("u", "u1")
VARIANT_DAMPINGS = (0.0, 20.0, 60.0, 140.0)
# The paper suggests to combine both and defines no combination: the estimator of this project, with the paper's C.
COMBINED = "FOAW and Levant"
COMBINED_SCHEME = Scheme.parse("uniform:1k,estimator=foaw-levant,lipschitz=6,gains=hba-sc")


def levant(
    rate: int, lipschitz: float, gains: tuple[float, float], form: str = "explicit", out: str = "u"
) -> Scheme:
    """Return a uniform-rate sampling scheme with Levant's differentiator.

    `rate` is in Hz, `lipschitz` is C (m/s²), `gains` are (μ1, μ2). The paper uses explicit Euler and the output u.
    """
    mu1, mu2 = gains
    return Scheme.parse(
        f"uniform:{rate},estimator=levant,lipschitz={lipschitz!r},gains=custom,mu1={mu1!r},mu2={mu2!r},"
        f"discretisation={form},output={out}"
    )


# --- dual-rate ---------------------------------------------------------------------------------------------------

KOUL = ("koul-rigid", "koul-compliant")
NAMES = {"koul-rigid": "koul-rigid (nothing fitted)", "koul-compliant": "koul-compliant (fitted)"}
DUAL_RATES = ("dual:20k/2k", "dual:20k/5k")
PAPERS_DUAL = "dual:20k/2k,estimator=fdm-butterworth"
REFERENCES = ("uniform:20k,estimator=fdm-butterworth", "uniform:2k,estimator=fdm-butterworth")
DUAL_ESTIMATORS = (
    "fdm",
    "fdm-butterworth",
    "foaw-best",
    "foaw-end",
    "kalman",
    "levant",
    "optimal",
    "foaw-levant",
)
DUAL_READINGS = tuple(Reading(low_hz=2.0, high_hz=high, tolerance=2.0) for high in (50.0, 100.0, 250.0))


def dual_schemes() -> tuple[Scheme, ...]:
    """Return the sampling schemes for Koul's rigs: two uniform-rate ones for comparison, then dual-rate ones.

    Each velocity estimator of `DUAL_ESTIMATORS` has two dual-rate schemes, one for each of `DUAL_RATES`.
    """
    texts = [f"{rates},estimator={estimator}" for rates in DUAL_RATES for estimator in DUAL_ESTIMATORS]
    return tuple(Scheme.parse(text) for text in (*REFERENCES, *texts))


@dataclass(frozen=True, slots=True, kw_only=True)
class ChawdaScale:
    """Sizes of the grids and numbers of repetitions; they decide how long the reproduction takes."""

    name: str
    stiffnesses: tuple[float, ...]  # N/m, of the maps
    dampings: tuple[float, ...]  # N·s/m, of the maps
    measurements: int  # impedance measurements of each wall
    realisations: int  # of the excitation, for each measurement
    coarse: int  # stride: the variants of Levant's differentiator use every n-th stiffness of the maps
    periods: int  # of the excitation that are measured
    hit_dampings: tuple[float, ...]  # N·s/m
    hit_ratio: float  # of neighbouring stiffnesses of the hits at 10 kHz; at 1 kHz its square root
    offsets: tuple[float, ...]  # counts: position zero in its encoder cell, for each hit
    constants: tuple[float, ...]  # m/s²: values of C among which the adjusted gains are chosen
    dual_stiffnesses: tuple[float, ...]  # N·m/rad
    dual_dampings: tuple[float, ...]  # N·m·s/rad
    dual_measurements: int
    dual_realisations: int
    theory_points: int  # dampings at which linear theory is computed

    @property
    def rung(self) -> float:
        """Ratio of two neighbouring stiffnesses on the grids of walls."""
        return self.stiffnesses[1] / self.stiffnesses[0]


def _rungs(lowest: float, ratio: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{lowest * ratio**i:.3g}") for i in range(count))


FULL = ChawdaScale(
    name="full", stiffnesses=_rungs(4000.0, 1.2, 25),
    dampings=(0.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0, 140.0, 200.0, 300.0, 450.0, 700.0, 1100.0),
    measurements=3, realisations=4, coarse=2, periods=3,
    hit_dampings=(0.0, 25.0, 50.0, 75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 500.0, 600.0, 800.0),
    hit_ratio=1.2, offsets=(0.1, 0.6), constants=CONSTANTS, dual_stiffnesses=_rungs(10.0, 1.6, 13),
    dual_dampings=(0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2), dual_measurements=2, dual_realisations=3,
    theory_points=41,
)  # fmt: skip
QUICK = ChawdaScale(
    name="quick",
    stiffnesses=_rungs(4000.0, 1.7, 8),
    dampings=(0.0, 20.0, 60.0, 200.0, 700.0),
    measurements=2,
    realisations=3,
    coarse=3,
    periods=2,
    hit_dampings=(0.0, 50.0, 100.0, 250.0, 400.0, 800.0),
    hit_ratio=1.5,
    offsets=(0.1,),
    constants=(3.0, 12.0, 50.0),
    dual_stiffnesses=_rungs(10.0, 8.0, 3),
    dual_dampings=(0.0, 0.2),
    dual_measurements=1,
    dual_realisations=2,
    theory_points=7,
)


def excited_rig(scale: ChawdaScale, changes: Mapping[str, Any] | None = None) -> Experiment:
    """Return the paper's rig with an excitation that covers the bands of all passivity tests, and with `changes`."""
    excitation = {
        "excitation.low_hz": LOWEST_HZ[0],
        "excitation.high_hz": HIGHEST_LINE,
        "excitation.rms": EXCITATION_RMS,
        "excitation.periods": scale.periods,
        "excitation.realisations": scale.measurements * scale.realisations,
        "excitation.seed": SEED,
    }
    return config.override(presets.load(RIG), {**excitation, **(changes or {})}, "the reproduction")


def pushed_rig(rate: int) -> Experiment:
    """Return the paper's rig for automated wall hits, sampled at `rate` (Hz)."""
    changes = {**PUSH, "verdict.lowpass_hz": LOWPASS_HZ[rate], "trial.seed": SEED}
    return config.override(presets.load(RIG), changes, "the reproduction")


def dual_rig(preset: str, scale: ChawdaScale) -> Experiment:
    """Return one of Koul's rigs for impedance measurements; its excitation is shorter, since the rig settles sooner."""
    changes = {
        "excitation.low_hz": 2.0,
        "excitation.high_hz": 250.0,
        "excitation.period_s": 0.5,
        "excitation.settle_periods": 2,
        "excitation.periods": 2,
        "excitation.realisations": scale.dual_measurements * scale.dual_realisations,
        "excitation.seed": SEED,
    }
    return config.override(presets.load(preset), changes, "the reproduction")
