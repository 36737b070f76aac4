"""Types of the results of the reproduction of Koul et al., and numbers that the report derives from them.

`claims`, `pictures` and the templates of the report read them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rig import config
from rig.config import presets
from rig.experiments.mapping.interface import KMax, Width, ZWidth
from rig.extras.papers.koul import rigs, rules
from rig.extras.papers.koul.compare import Panel, Profiles
from rig.extras.papers.koul.ideas import (
    FINEST_LINES,
    REFERENCE,
    SAME,
    USUAL_LINES,
    Change,
    Tried,
    encoder_key,
    rank_ideas,
)
from rig.extras.papers.koul.parts import DampingRange
from rig.extras.papers.koul.ways import Way, ways_of
from rig.extras.papers.rules import over, within
from rig.realtime.source_files import code_version

NUMBERS = {key: number for number, key in enumerate(rigs.SCHEMES)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """Simulated stability limits of Fig. 6 with friction, quantisation, both or neither, by sampling scheme."""

    undamped: Mapping[str, float]  # K at B = 0, stable in any sense
    ranges: Mapping[str, dict[str, DampingRange]]


@dataclass(frozen=True, slots=True)
class OverLinear:
    """Simulated stability limits divided by the limits of linear theory, by sampling scheme."""

    undamped: Mapping[str, float]
    range: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Best:
    """Idea (changed sampling or rig) of a group with the largest Z-width, compared with the paper's dual-rate wall."""

    tried: int  # without the reference
    wider: int  # number that widen the Z-width by more than `SAME`
    best: Tried
    change: Change
    is_reference: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Koul:
    """All computed results of the reproduction of Koul et al., from which claims, sentences and pictures are derived.

    Attributes
    ----------
    kmax, kmax_theory
        Fig. 5: largest stable K at B = 0 over the sampling rate, simulated and by linear theory; the keys are (preset,
        name of the amplifier's lag in `rigs.LAGS`).
    maps
        Fig. 6 and its variants, by name of the `HeldRig` (rig and hand), with the sampling schemes in the order of
        `SCHEMES`.
    ranges
        Largest stable damping (N·m·s/rad) of a soft wall, by name of the `HeldRig`, scheme, and ripple criterion.
    linear
        Limits by exact linear theory, by name of the `HeldRig` and scheme.
    effects
        Limits with each of `EFFECTS` by name, on the fitted preset in the normal hand.
    figure_7, words, figure_8
        Impacts, their peak penetrations by word length (bits) of the filter, and estimated velocities.
    noise
        Velocity noise of the encoder's quantisation (rad/s rms), by velocity rate and cut-off.
    plants
        Random plants with their largest dampings by linear theory, in the order of `SCHEMES`.
    ideas
        Results of the ideas for a larger Z-width, by the idea's key.
    """

    scale: rigs.KoulScale
    kmax: Mapping[tuple[str, str], KMax]
    kmax_theory: Mapping[tuple[str, str], list[float]]
    maps: Mapping[str, ZWidth]
    ranges: Mapping[str, Mapping[str, dict[str, DampingRange]]]
    linear: Mapping[str, Mapping[str, dict[str, Any]]]
    effects: Mapping[str, Effect]
    figure_7: tuple[Panel, ...]
    words: tuple[dict[str, Any], ...]
    figure_8: Profiles
    noise: Mapping[str, float]
    lower_cutoffs: Mapping[str, list[float | None]]
    differentiators: list[tuple[str, int, float, float]]
    plants: tuple[dict[str, Any], ...]
    ideas: Mapping[str, Tried]
    hits: int

    def width(self, held: rigs.HeldRig, key: str, criterion: str = "any") -> Width:
        """Return peak stiffness, largest damping and area of a sampling scheme's stable walls, on one rig and hand."""
        return self.maps[held.name].width(NUMBERS[key], criterion)

    def growth(self, preset: str) -> tuple[list[float | None], list[float]]:
        """Return K_max (stiffest stable wall) at the highest rate over K_max at 20 kHz, with and without lag.

        The first list is simulated, the second is by linear theory.
        """
        fast = self.scale.rates.index(rules.FAST_HZ)
        linear = [self.kmax_theory[preset, lag] for lag in rigs.LAGS]
        simulated = [self.kmax[preset, lag].saturation("any") for lag in rigs.LAGS]
        return simulated, [stiffness[-1] / stiffness[fast] for stiffness in linear]

    def by_preset(self) -> list[rigs.HeldRig]:
        """Return every combination of rig and hand, sorted by rig."""
        return sorted(rigs.HELD, key=lambda held: rigs.PRESETS.index(held.preset))

    def spread_of_hands(self) -> list[tuple[str, float, float]]:
        """Return (preset, least, largest) peak stiffness (N·m/rad) of the dual-rate wall over all simulated hands."""
        peaks = {
            p: [self.width(held, rigs.DUAL).stiffness_peak for held in rigs.HELD if held.preset == p]
            for p in rigs.PRESETS
        }
        return [(preset, min(of), max(of)) for preset, of in peaks.items()]

    def ways(self) -> list[Way]:
        """Compare the limits that three searches (ladder, bisection, grid) would find in the same grid of walls."""
        found = self.maps[rigs.MAIN[0].name]
        return [
            ways_of(found, key, number, criterion)
            for key, number in NUMBERS.items()
            for criterion in ("felt", "any")
        ]

    def null_readings(self) -> tuple[int, float]:
        """Count the filter's word lengths with which the velocity estimated at 20 kHz is null late in the impact.

        Also return the largest share of the true velocity that these word lengths still report early.
        """
        read = [word["read"][str(rules.FAST_HZ)] for word in self.words]
        null = [one["early"] for one in read if one["late"] <= rules.NULL]
        return len(null), max(null, default=0.0)

    def effect_ratios(self) -> list[OverLinear]:
        """Return simulated stability limits divided by linear theory, with and without friction and quantisation."""
        linear = self.linear[rigs.MAIN[0].name]
        return [
            OverLinear(
                {key: over(value, linear[key]["undamped"]) for key, value in effect.undamped.items()},
                {key: over(of["any"].damping, linear[key]["range"]) for key, of in effect.ranges.items()},
            )
            for effect in self.effects.values()
        ]

    def plant_shares(self) -> dict[str, Any]:
        """Return statistics of the largest stable damping on random plants, for three kinds of sampling.

        ``quartiles`` of the ratio fast uniform / dual-rate; ``larger``: share of plants where this ratio exceeds 1;
        ``same`` and ``same_with_islands``: share of plants where dual-rate and slow uniform are equal.
        """
        ranges = np.array([plant["ranges"] for plant in self.plants])
        dual, fast, slow = (ranges[:, NUMBERS[key]] for key in (rigs.DUAL, rigs.FAST, rigs.SLOW))
        ratios = fast / np.maximum(dual, 1e-9)
        whole = [plant["with_islands"][0] / plant["with_islands"][1] for plant in self.plants]
        return {
            "quartiles": [float(q) for q in np.percentile(ratios, (25, 50, 75))],
            "larger": float((ratios > 1.0).mean()),
            "same": _share_of_ones(dual / slow),
            "same_with_islands": _share_of_ones(whole),
        }

    def against(self, key: str) -> Change:
        """Return limits and area of an idea for a larger Z-width, divided by those of the paper's dual-rate wall."""
        return Change.of(self.ideas[key], self.ideas[REFERENCE])

    def linear_change(self, key: str) -> dict[str, float]:
        """Divide an idea's ``peak`` stiffness and damping ``range`` by those of the paper's dual-rate wall (theory).

        The result is empty if a wall is not linear.
        """
        new, old = self.ideas[key].linear, self.ideas[REFERENCE].linear
        return {name: over(new[name], old[name]) for name in ("peak", "range")} if new and old else {}

    def group(self, group: str) -> list[Tried]:
        """Return the results of one group of ideas (changed samplings or rigs) for a larger Z-width."""
        return [one for one in self.ideas.values() if one.idea.group == group]

    def changes(self, group: str) -> dict[str, Change]:
        """Return, by label, limits and area of each idea of a group, divided by those of the paper's dual-rate wall."""
        return {one.idea.label: self.against(one.idea.key) for one in self.group(group)}

    def best(self, group: str) -> Best:
        """Return the idea of a group with the largest area of stable walls, or the paper's dual-rate wall if larger."""
        tried, reference = self.group(group), self.ideas[REFERENCE]
        best = max([*tried, reference], key=lambda one: one.area("any"))
        return Best(
            tried=len(tried),
            wider=sum(change.area > 1.0 + SAME for change in self.changes(group).values()),
            best=best,
            change=Change.of(best, reference),
            is_reference=best is reference,
        )

    def finest_encoder(self) -> list[tuple[str, Change, float]]:
        """Return preset, dual-rate limits (finest over usual encoder) and ratio of areas of each rig.

        The ratio, with the finest encoder, is the area of stable walls (stiffness × damping) of uniform sampling at 20
        kHz
        divided by that of dual-rate sampling.
        """
        found = []
        for preset in rigs.PRESETS:
            dual, fast, usual = (
                self.ideas[encoder_key(preset, scheme, lines)]
                for scheme, lines in (
                    ("dual", FINEST_LINES),
                    ("uniform", FINEST_LINES),
                    ("dual", USUAL_LINES),
                )
            )
            found.append((preset, Change.of(dual, usual), over(fast.area("any"), dual.area("any"))))
        return found

    def ranked(self) -> list[Tried]:
        """Return the ideas on the reference's rig, sorted by area of their stable walls, then ideas on other rigs."""
        elsewhere = [t for t in self.ideas.values() if t.idea.preset != self.ideas[REFERENCE].idea.preset]
        return [*rank_ideas(self.ideas), *elsewhere]

    def highest_search(self) -> float:
        """Return the highest stiffness (N·m/rad) that was searched for any idea."""
        return max(tried.map.plan.search.highest for tried in self.ideas.values())


def cutoff(word: Mapping[str, Any]) -> str:
    """Return the cut-off of the uniform wall in a row of `Koul.words`, as text like ``fs/20``."""
    return f"fs/{1 / word['uniform_share']:g}"


def word_name(word: Mapping[str, Any]) -> str:
    """Return word length and cut-off of a row of `Koul.words`, as text like ``4 bits, fs/20``."""
    return f"{word['state_bits']} bits, {cutoff(word)}"


def _share_of_ones(ratios: Sequence[float]) -> float:
    return float(np.mean([within(ratio, 1.0, rules.SAME_LINEAR) for ratio in ratios]))


def numbers(koul: Koul) -> dict[str, Any]:
    """Return every computed number of the reproduction by name, for the JSON file."""
    return {
        "kmax": {
            f"{preset}, {lag}": {**found.as_mapping(), "linear_theory": koul.kmax_theory[preset, lag]}
            for (preset, lag), found in koul.kmax.items()
        },
        "maps": koul.maps,
        "ranges": koul.ranges,
        "linear": koul.linear,
        "effects": koul.effects,
        "figure_7": koul.figure_7,
        "word_lengths": koul.words,
        "figure_8": koul.figure_8,
        "noise": koul.noise,
        "lower_cutoffs": koul.lower_cutoffs,
        "differentiators": koul.differentiators,
        "random_plants": koul.plants,
        "ideas": koul.ideas,
    }


def provenance(koul: Koul) -> dict[str, Any]:
    """Return where the numbers come from: code version, grid sizes, seed, settings; the same on every machine."""
    limits = presets.load(rigs.COMPLIANT).verdict
    return {
        "haptic-rig": code_version(),
        "scale": asdict(koul.scale),
        "seed": rigs.SEED,
        "hits": koul.hits,
        "presets": {name: config.as_mapping(presets.load(name)) for name in rigs.PRESETS},
        "verdict": asdict(limits),
        "lowest_stiffness": rigs.LOWEST_STIFFNESS,
        "automated_trial": rigs.PUSH,
    }
