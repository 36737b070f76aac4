"""What the reproduction of Koul et al. computed, typed, and as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from rig import config
from rig.config import presets
from rig.experiments.kmax import KMax
from rig.experiments.sweep.executors import code_version
from rig.experiments.zwidth import ZWidth
from rig.papers.koul.compare import Panel, Profiles
from rig.papers.koul.ideas import Tried
from rig.papers.koul.parts import Range
from rig.papers.koul.rigs import COMPLIANT, LOWEST_STIFFNESS, PRESETS, PUSH, SEED, Scale


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """Limits of the walls of Fig. 6 under some of what the linear theory leaves out, by scheme."""

    undamped: Mapping[str, float]  # K at B = 0, stable in any sense
    ranges: Mapping[str, dict[str, Range]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Koul:
    """Everything that was computed; what claims, sentences and pictures are made of.

    Attributes
    ----------
    kmax, kmax_theory
        Fig. 5, by preset and `LAGS`.
    maps
        Fig. 6 and its variants, by name of `Held`: schemes in the order of `SCHEMES`.
    ranges
        Largest damping of the softest wall, by name of `Held` and scheme, then by criterion.
    linear
        Exact linear theory, by name of `Held` and scheme.
    effects
        By name of `EFFECTS`, on the fitted preset in the normal hand.
    figure_7, words, figure_8
        See `rig.papers.koul.compare`.
    noise
        What one count adds to the velocity (rad/s rms), by velocity rate and cut-off.
    plants
        Random plants with their linear ranges of damping, in the order of `SCHEMES`.
    ideas
        Maps of the ideas, by name.
    """

    scale: Scale
    kmax: Mapping[tuple[str, str], KMax]
    kmax_theory: Mapping[tuple[str, str], list[float]]
    maps: Mapping[str, ZWidth]
    ranges: Mapping[str, Mapping[str, dict[str, Range]]]
    linear: Mapping[str, Mapping[str, dict[str, Any]]]
    effects: Mapping[str, Effect]
    figure_7: tuple[Panel, ...]
    words: tuple[dict[str, Any], ...]
    figure_8: Profiles
    noise: Mapping[str, float]
    plants: tuple[dict[str, Any], ...]
    ideas: Mapping[str, Tried]
    hits: int


def numbers(koul: Koul) -> dict[str, Any]:
    """Every number, in plain values."""
    return {
        "kmax": {
            f"{preset}, {lag}": {**found.as_mapping(), "linear_theory": koul.kmax_theory[preset, lag]}
            for (preset, lag), found in koul.kmax.items()
        },
        "maps": {name: found.as_mapping() for name, found in koul.maps.items()},
        "ranges": {
            name: {
                key: {criterion: asdict(found) for criterion, found in ranges.items()}
                for key, ranges in of_name.items()
            }
            for name, of_name in koul.ranges.items()
        },
        "linear": koul.linear,
        "effects": {name: asdict(effect) for name, effect in koul.effects.items()},
        "figure_7": [panel.as_mapping() for panel in koul.figure_7],
        "word_lengths": list(koul.words),
        "figure_8": koul.figure_8.as_mapping(),
        "noise": koul.noise,
        "random_plants": list(koul.plants),
        "ideas": {key: tried.as_mapping() for key, tried in koul.ideas.items()},
    }


def provenance(koul: Koul) -> dict[str, Any]:
    """What the numbers come from, the same on every machine."""
    limits = presets.load(COMPLIANT).verdict
    return {
        "haptic-rig": code_version(),
        "scale": asdict(koul.scale),
        "seed": SEED,
        "hits": koul.hits,
        "presets": {name: config.as_mapping(presets.load(name)) for name in PRESETS},
        "verdict": asdict(limits),
        "lowest_stiffness": LOWEST_STIFFNESS,
        "automated_trial": PUSH,
    }
