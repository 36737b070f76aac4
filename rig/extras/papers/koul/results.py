"""What the reproduction of Koul et al. computed, typed, what its page asks of it, and all of it as plain values."""

from __future__ import annotations

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
    """Limits of the walls of Fig. 6 under some of what the linear theory leaves out, by scheme."""

    undamped: Mapping[str, float]  # K at B = 0, stable in any sense
    ranges: Mapping[str, dict[str, DampingRange]]


@dataclass(frozen=True, slots=True)
class OverLinear:
    """Limits of an effect over those of linear theory, by scheme."""

    undamped: Mapping[str, float]
    range: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Best:
    """The best of some ideas, beside the dual-rate wall of the paper."""

    tried: int  # without the reference
    wider: int  # of them widen the Z-width by more than `SAME`
    best: Tried
    change: Change
    is_reference: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Koul:
    """All computed results, from which claims, sentences and pictures are made.

    Attributes
    ----------
    kmax, kmax_theory
        Fig. 5, by preset and `LAGS`.
    maps
        Fig. 6 and its variants, by name of `HeldRig`: schemes in the order of `SCHEMES`.
    ranges
        Largest damping of the softest wall, by name of `HeldRig` and scheme, then by criterion.
    linear
        Exact linear theory, by name of `HeldRig` and scheme.
    effects
        By name of `EFFECTS`, on the fitted preset in the normal hand.
    figure_7, words, figure_8
        See `rig.extras.papers.koul.compare`.
    noise
        What one count adds to the velocity (rad/s rms), by velocity rate and cut-off.
    plants
        Random plants with their linear ranges of damping, in the order of `SCHEMES`.
    ideas
        Maps of the ideas, by name.
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
    plants: tuple[dict[str, Any], ...]
    ideas: Mapping[str, Tried]
    hits: int

    def width(self, held: rigs.HeldRig, key: str, criterion: str = "any") -> Width:
        """Return the summary of a map of Fig. 6, by key of the scheme."""
        return self.maps[held.name].width(NUMBERS[key], criterion)

    def growth(self, preset: str) -> tuple[list[float | None], list[float]]:
        """Return the last K_max over that at 20 kHz, with lag and without: simulated, and by linear theory."""
        fast = self.scale.rates.index(rules.FAST_HZ)
        linear = [self.kmax_theory[preset, lag] for lag in rigs.LAGS]
        simulated = [self.kmax[preset, lag].saturation("any") for lag in rigs.LAGS]
        return simulated, [stiffness[-1] / stiffness[fast] for stiffness in linear]

    def by_preset(self) -> list[rigs.HeldRig]:
        """Return every rig in every hand, rig by rig."""
        return sorted(rigs.HELD, key=lambda held: rigs.PRESETS.index(held.preset))

    def spread_of_hands(self) -> list[tuple[str, float, float]]:
        """Return the lowest and highest peak of the dual-rate wall over who pushes, by preset."""
        peaks = {
            p: [self.width(held, rigs.DUAL).stiffness_peak for held in rigs.HELD if held.preset == p]
            for p in rigs.PRESETS
        }
        return [(preset, min(of), max(of)) for preset, of in peaks.items()]

    def ways(self) -> list[Way]:
        """Return the ladder, bisection and grid through the map that has every wall."""
        found = self.maps[rigs.MAIN[0].name]
        return [
            ways_of(found, key, number, criterion)
            for key, number in NUMBERS.items()
            for criterion in ("felt", "any")
        ]

    def null_readings(self) -> tuple[int, float]:
        """Return how many word lengths read nothing late in the impact at 20 kHz, and the most these read early."""
        read = [word["read"][str(rules.FAST_HZ)] for word in self.words]
        null = [one["early"] for one in read if one["late"] <= rules.NULL]
        return len(null), max(null, default=0.0)

    def effect_ratios(self) -> list[OverLinear]:
        """Return limits over linear theory: without both, with friction, with the quantiser, with both."""
        linear = self.linear[rigs.MAIN[0].name]
        return [
            OverLinear(
                {key: over(value, linear[key]["undamped"]) for key, value in effect.undamped.items()},
                {key: over(of["any"].damping, linear[key]["range"]) for key, of in effect.ranges.items()},
            )
            for effect in self.effects.values()
        ]

    def plant_shares(self) -> dict[str, Any]:
        """Return ranges of damping on random plants: fast uniform over dual-rate, and where dual-rate is like slow."""
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
        """Return the change of an idea against the dual-rate wall of the paper."""
        return Change.of(self.ideas[key], self.ideas[REFERENCE])

    def linear_change(self, key: str) -> dict[str, float]:
        """Return the same of peak and range by linear theory; empty without one."""
        new, old = self.ideas[key].linear, self.ideas[REFERENCE].linear
        return {name: over(new[name], old[name]) for name in ("peak", "range")} if new and old else {}

    def group(self, group: str) -> list[Tried]:
        """Return the tried ideas of one group."""
        return [one for one in self.ideas.values() if one.idea.group == group]

    def changes(self, group: str) -> dict[str, Change]:
        """Return the changes of the ideas of one kind, by label."""
        return {one.idea.label: self.against(one.idea.key) for one in self.group(group)}

    def best(self, group: str) -> Best:
        """Return the idea of one kind whose Z-width has the largest area, the paper's wall among them."""
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
        """For each rig: what the finest encoder changes for dual-rate; area of uniform 20 kHz over dual-rate then."""
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
        """Return ideas by the area of their Z-width, then those on another rig."""
        elsewhere = [t for t in self.ideas.values() if t.idea.preset != self.ideas[REFERENCE].idea.preset]
        return [*rank_ideas(self.ideas), *elsewhere]

    def highest_search(self) -> float:
        """Return the highest stiffness that was tried with any idea."""
        return max(tried.map.plan.search.highest for tried in self.ideas.values())


def cutoff(word: Mapping[str, Any]) -> str:
    """Return the cut-off of a uniform wall, like ``fs/20``."""
    return f"fs/{1 / word['uniform_share']:g}"


def word_name(word: Mapping[str, Any]) -> str:
    """Return the word length and cut-off of a uniform wall."""
    return f"{word['state_bits']} bits, {cutoff(word)}"


def _share_of_ones(ratios: Sequence[float]) -> float:
    """Share of ratios that are one within the rule's tolerance."""
    return float(np.mean([within(ratio, 1.0, rules.SAME_LINEAR) for ratio in ratios]))


def numbers(koul: Koul) -> dict[str, Any]:
    """Return every number of the reproduction as plain values, for JSON."""
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
        "random_plants": koul.plants,
        "ideas": koul.ideas,
    }


def provenance(koul: Koul) -> dict[str, Any]:
    """Return the sources of the numbers, the same on every machine."""
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
