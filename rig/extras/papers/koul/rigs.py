"""Settings of the reproduction of Koul et al.: rigs, hands and pushes, sampling schemes, sizes of the grids.

All other files of this folder use them; choices of this project have a comment with the reason.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rig import config
from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.experiments.hits.compare import OFFSETS

COMPLIANT, RIGID = "koul-compliant", "koul-rigid"
PRESETS = (COMPLIANT, RIGID)
NAMES = {COMPLIANT: "koul-compliant (fitted)", RIGID: "koul-rigid (nothing fitted)"}

# The schemes of Fig. 6. For a uniform 20 kHz wall the paper fits two cut-offs: both are shown.
DUAL, FAST, FAST_1K, SLOW = "d", "u20", "u20/1k", "u2"
SCHEMES = {
    DUAL: Scheme.parse("dual:20k/2k"),
    FAST: Scheme.parse("uniform:20k,cutoff_hz=2000"),
    FAST_1K: Scheme.parse("uniform:20k,cutoff_hz=1000"),
    SLOW: Scheme.parse("uniform:2k"),
}
# Labels: the rates, and the cut-off of the filter.
LABELS = {
    DUAL: "dual-rate 20/2 kHz, 200 Hz",
    FAST: "uniform 20 kHz, 2 kHz",
    FAST_1K: "uniform 20 kHz, 1 kHz",
    SLOW: "uniform 2 kHz, 200 Hz",
}

LOWEST_STIFFNESS = 15.0  # N·m/rad, of every map; ranges of damping are those of this wall
HIGHEST_STIFFNESS = 2500.0  # N·m/rad, of fine encoders, which could show more
# N·m, as hard as the hand; rad, so close to the wall that the motor does not saturate.
PUSH_EFFORT, PUSH_START = 0.4, -0.004
PUSH = {"trial.kind": "constant-effort", "trial.effort": PUSH_EFFORT, "trial.start": PUSH_START}
SEED = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class KoulScale:
    """Sizes of the grids and numbers of repetitions; they decide how long the reproduction takes."""

    name: str
    rates: tuple[int, ...]  # Hz, of Fig. 5
    kmax_ratio: float  # of neighbouring stiffnesses in the searches of Fig. 5
    columns: int  # dampings of a map, for each scheme that has a range of its own
    ratio: float  # of neighbouring stiffnesses of the maps
    offsets: tuple[float, ...]  # counts: position zero in its encoder cell, for each hit
    range_ratio: float  # of neighbouring dampings in the searches of the largest damping
    idea_dampings: tuple[float, ...]  # N·m·s/rad
    effect_s: float  # trials compared with linear theory: slow growth takes long
    idea_points: int  # dampings of the ideas' linear theory
    idea_ratio: float  # of neighbouring stiffnesses of the ideas' maps
    idea_offsets: tuple[float, ...]  # counts
    plants: int  # random plants
    state_bits: tuple[int, ...]  # word lengths of figures 7 and 8
    levant_rates: tuple[int, ...]  # Hz, of the comparison with Levant's differentiator
    theory_points: int  # dampings of linear theory for Fig. 6
    impact_offsets: tuple[float, ...]  # counts, of figures 7 and 8


FULL = KoulScale(
    name="full",
    rates=(100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000),
    kmax_ratio=1.02,
    columns=9,
    ratio=1.08,
    offsets=(0.1, 0.6),
    range_ratio=1.015,
    idea_dampings=(0.0, 0.1, 0.2, 0.4, 0.8, 1.4, 2.0, 2.6, 3.2, 4.0),
    effect_s=3.0,
    idea_points=17,
    idea_ratio=1.1,
    idea_offsets=(0.1, 0.6),
    plants=200,
    state_bits=(0, 1, 2, 3, 4, 5, 6, 8, 16),
    levant_rates=(1000, 2000, 4000, 20_000, 50_000),
    theory_points=41,
    impact_offsets=OFFSETS,
)
QUICK = KoulScale(
    name="quick",
    rates=(500, 2000, 10_000, 20_000, 50_000),
    kmax_ratio=1.15,
    columns=2,
    ratio=1.5,
    offsets=(0.1,),
    range_ratio=1.4,
    idea_dampings=(0.0, 0.4),
    effect_s=1.5,
    idea_points=3,
    idea_ratio=1.7,
    idea_offsets=(0.1,),
    plants=10,
    state_bits=(2, 4, 16),
    levant_rates=(1000, 20_000),
    theory_points=8,
    impact_offsets=(0.1, 0.7),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldRig:
    """A rig whose handle is held by a simulated hand with `grip`; None: pushed by its motor with constant effort."""

    preset: str
    grip: str | None

    @property
    def name(self) -> str:
        """Name of this combination of rig and hand in the results, such as "koul-rigid, firm hand"."""
        return f"{self.preset}, {self.push}"

    @property
    def push(self) -> str:
        """What pushes the handle into the wall, as text: "automated" (the motor) or a hand, such as "firm hand"."""
        return "automated" if self.grip is None else f"{self.grip} hand"

    def experiment(self, changes: Mapping[str, Any] | None = None) -> Experiment:
        """Return the preset's experiment with this hand or push, and with `changes` of settings."""
        # As in the paper, whose amplifier gives the stall torque: the limits for people would bound the walls instead.
        held = (
            PUSH
            if self.grip is None
            else {"trial.kind": "human", "operator.grip": self.grip, "rig.limits.human": False}
        )
        return config.override(
            presets.load(self.preset), {**held, "trial.seed": SEED, **(changes or {})}, "the reproduction"
        )


MAIN = tuple(HeldRig(preset=preset, grip="normal") for preset in PRESETS)
OTHERS = tuple(HeldRig(preset=preset, grip=grip) for preset in PRESETS for grip in ("relaxed", "firm", None))
HELD = (*MAIN, *OTHERS)
WITH_LAG, WITHOUT_LAG = "with lag", "without lag"
LAGS: dict[str, dict[str, Any]] = {WITH_LAG: {}, WITHOUT_LAG: {"rig.amplifier.lag_s": 0.0}}

# Friction and quantiser by themselves: what each takes from, or adds to, the linear limits.
NO_FRICTION = {"rig.mechanics.motor_coulomb": 0.0, "rig.mechanics.link_coulomb": 0.0}
NO_QUANTUM = {"rig.encoder.counts_per_revolution": 64_000, "rig.amplifier.current_quantum_a": 2e-4}
NEITHER, FRICTION, QUANTISER, BOTH = "neither", "friction alone", "quantiser alone", "both"
EFFECTS: dict[str, dict[str, Any]] = {
    NEITHER: {**NO_FRICTION, **NO_QUANTUM},
    FRICTION: NO_QUANTUM,
    QUANTISER: NO_FRICTION,
    BOTH: {},
}
