"""Chawda, Celik and O'Malley (2015): the cut-off of a velocity filter and the Z-width, from the abstract.

Nothing but the abstract could be read in public (asmedigitalcollection.asme.org, and the first page of a copy): no
number of the paper is known here, so that its two statements are judged, and none of its figures is drawn.

Source: "A Method for Selecting Velocity Filter Cut-Off Frequency for Maximizing Impedance Width Performance in Haptic
Interfaces", ASME J. Dyn. Sys., Meas., Control 137(2), 024503 (2015), doi 10.1115/1.4028526.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rig import config
from rig.control.verdict import CRITERIA
from rig.experiments.zwidth import ZWidth
from rig.papers.cutoff import rigs, rules
from rig.papers.koul.parts import map_part
from rig.papers.parts import Part, Parts
from rig.papers.reproduction import Paper
from rig.papers.rules import Ruling
from rig.realtime.source_files import code_version
from rig.views.plots import style


@dataclass(frozen=True, slots=True, kw_only=True)
class Cutoff:
    """Everything that was computed: maps by encoder, and of models that miss the rig."""

    scale: rigs.Scale
    maps: Mapping[str, ZWidth]
    models: Mapping[str, ZWidth]

    def areas(self, found: ZWidth, criterion: str = "any") -> list[float]:
        """Area of the Z-width at each cut-off (N²·s/m²)."""
        return [found.width(number, criterion).area for number in range(len(self.scale.cutoffs))]

    @property
    def hits(self) -> int:
        """How many walls were hit."""
        return sum(found.hits for found in (*self.maps.values(), *self.models.values()))


class CutoffPlan:
    """All parts of the work, by name, and the way back from their results."""

    def __init__(self, scale: rigs.Scale) -> None:
        self._scale = scale
        self._maps = {
            name: rigs.map_plan({"rig.encoder.quantum": quantum}, scale)
            for name, quantum in rigs.QUANTA.items()
        }
        self._models = {name: rigs.map_plan(rigs.model(name), scale) for name in rigs.MODELS}

    def parts(self) -> dict[str, Part]:
        """Everything that has to be computed."""
        maps = {f"map/{name}": map_part(plan) for name, plan in self._maps.items()}
        return maps | {f"model/{name}": map_part(plan) for name, plan in self._models.items()}

    def results(self, done: Parts) -> Cutoff:
        """Make sense of what came back."""
        return Cutoff(
            scale=self._scale,
            maps={name: ZWidth.of(plan, done.results[f"map/{name}"]) for name, plan in self._maps.items()},
            models={
                name: ZWidth.of(plan, done.results[f"model/{name}"]) for name, plan in self._models.items()
            },
        )


def rulings(cutoff: Cutoff) -> dict[str, Ruling]:
    """On both statements."""
    cases: dict[tuple[str, ...], list[float]] = {
        (name, criterion): cutoff.areas(found, criterion)
        for name, found in cutoff.maps.items()
        for criterion in CRITERIA
    }
    rig = cutoff.areas(cutoff.maps[rigs.MODELLED])
    models = {name: cutoff.areas(of) for name, of in cutoff.models.items()}
    cutoffs = cutoff.scale.cutoffs
    return {
        "exists": rules.exists(cases),
        "predicts": rules.predicts(rig, models).having(
            best=cutoffs[rules.place_of_best(rig)],
            found=[(name, cutoffs[rules.place_of_best(of)]) for name, of in models.items()],
        ),
    }


def words(cutoff: Cutoff) -> dict[str, Any]:
    """What the templates call for."""
    return {"cutoff": cutoff, "rigs": rigs, "rules": rules}


def numbers(cutoff: Cutoff) -> dict[str, Any]:
    """Every number in plain values."""
    every = {**cutoff.maps, **cutoff.models}
    return {
        "cutoffs": list(cutoff.scale.cutoffs),
        "areas": {name: {of: cutoff.areas(found, of) for of in CRITERIA} for name, found in every.items()},
    }


def provenance(cutoff: Cutoff) -> dict[str, Any]:
    """What the numbers come from, the same on every machine."""
    return {
        "haptic-rig": code_version(),
        "scale": asdict(cutoff.scale),
        "seed": rigs.SEED,
        "hits": cutoff.hits,
        "rig": config.as_mapping(rigs.experiment({})),
    }


@style.own_style()
def _areas(cutoff: Cutoff, path: Path) -> None:
    figure = style.new_figure(11.0, 4.2)
    panels = figure.subplots(1, 2)
    for number, (name, found) in enumerate(cutoff.maps.items()):
        areas = cutoff.areas(found)
        best = max(areas) or 1.0
        panels[0].plot(
            cutoff.scale.cutoffs, [a / best for a in areas], "o-", color=style.SERIES[number], label=name
        )
    for number, (name, found) in enumerate(cutoff.models.items()):
        areas = cutoff.areas(found)
        best = max(areas) or 1.0
        panels[1].plot(
            cutoff.scale.cutoffs, [a / best for a in areas], color=style.SERIES[number], label=name
        )
    for axes, title in zip(panels, ("by encoder", f"models of the rig with {rigs.MODELLED}"), strict=True):
        axes.set(xscale="log", xlabel="cut-off (Hz)", ylabel="area of the Z-width over its largest")
        axes.set_title(title, fontsize=10)
        axes.legend(fontsize=8)
        style.lighten(axes)
    style.save(figure, path)


CUTOFF = Paper(
    name="cutoff",
    quick=rigs.QUICK,
    full=rigs.FULL,
    plan=CutoffPlan,
    rulings=rulings,
    words=words,
    numbers=numbers,
    provenance=provenance,
    pictures={"areas": _areas},
)
