"""Reproduce the dual-rate sampling of Koul, Manivannan and Saha: every figure, every claim, and the paper's open ideas.

Some hundred searches and computations of theory run as one sweep. Rules compute verdicts from the numbers, and
templates write the sentences. Nothing is tuned here: the rigs are two presets, one of them fitted to the paper.

Source: Koul, Manivannan, Saha, "Enhanced Z-width of a haptic interface by dual-rate sampling" (2013), Figs. 5 to 8.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rig import config
from rig.analysis import theory
from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.experiments.mapping.interface import (
    KMax,
    MapPlan,
    StiffnessSearch,
    Way,
    ZWidth,
    highest_stiffness,
    kmax_plan,
    search_for,
)
from rig.extras.papers.koul import compare as compare_koul
from rig.extras.papers.koul import ideas as koul_ideas
from rig.extras.papers.koul import parts as koul_parts
from rig.extras.papers.koul import rigs, rules
from rig.extras.papers.koul.claims import by_cutoff, rulings
from rig.extras.papers.koul.ideas import Idea
from rig.extras.papers.koul.parts import DampingRange
from rig.extras.papers.koul.pictures import PICTURES
from rig.extras.papers.koul.results import Effect, Koul, cutoff, numbers, provenance
from rig.extras.papers.koul.rules import DAMPING_RANGE, DAMPING_RANGE_FAST
from rig.extras.papers.parts import Part, Parts, part
from rig.extras.papers.reproduction import Paper


class KoulPlan:
    """Tasks that compute everything for the paper of Koul et al., and the conversion of their results to `Koul`."""

    def __init__(self, scale: rigs.KoulScale) -> None:
        self._scale = scale
        self._dampings = {held.preset: _dampings(held.experiment(), scale.columns) for held in rigs.MAIN}
        self._kmax = {(p, lag): self._kmax_plan(p, lag) for p in rigs.PRESETS for lag in rigs.LAGS}
        self._maps = {held.name: self._map_plan(held) for held in rigs.HELD}
        self._ideas = koul_ideas.ideas()
        self._idea_maps = {idea.key: self._idea_plan(idea) for idea in self._ideas}
        self._effects = {
            name: rigs.MAIN[0].experiment({**changes, "trial.duration_s": scale.effect_s})
            for name, changes in rigs.EFFECTS.items()
        }
        self._effect_maps = {name: self._effect_plan(x) for name, x in self._effects.items()}

    def parts(self) -> dict[str, Part]:
        """Return all tasks of the computation, grouped by the name of the result that they compute."""
        scale, parts = self._scale, {}
        for (preset, lag), plan in self._kmax.items():
            parts[f"kmax/{preset}/{lag}"] = koul_parts.map_part(plan)
            parts[f"kmax-theory/{preset}/{lag}"] = part(
                koul_parts.linear_limits,
                {"experiment": config.as_mapping(plan.experiment), "rates": scale.rates},
                5.0 * len(scale.rates),
            )
        for name, plan in self._maps.items():
            parts[f"map/{name}"] = koul_parts.map_part(plan)
        for held in rigs.HELD:
            parts[f"range/{held.name}"] = self._ranges(held.experiment())
            for key, scheme in rigs.SCHEMES.items():
                parts[f"linear/{held.name}/{key}"] = self._linear(held, scheme)
        for name, experiment in self._effects.items():
            parts[f"effect-range/{name}"] = self._ranges(experiment)
            parts[f"effect/{name}"] = koul_parts.map_part(self._effect_maps[name])
        for idea in self._ideas:
            parts[f"idea/{idea.key}"] = koul_parts.map_part(self._idea_maps[idea.key])
            parts[f"idea-linear/{idea.key}"] = part(
                koul_parts.linear_limits,
                {
                    "experiment": config.as_mapping(idea.experiment()),
                    "scheme": idea.scheme.text,
                    "dampings": np.linspace(0.0, scale.idea_dampings[-1], scale.idea_points).tolist(),
                    "islands": False,
                    "passivity": False,
                },
                20.0,
            )
            parts[f"idea-range/{idea.key}"] = self._ranges(idea.experiment(), (idea.scheme,))
        chunks = np.array_split(np.arange(scale.plants), max(1, scale.plants // 10))
        for number, chunk in enumerate(chunks):
            payload = {
                "schemes": [s.text for s in rigs.SCHEMES.values()],
                "numbers": chunk.tolist(),
                "islands": [list(rigs.SCHEMES).index(key) for key in (rigs.DUAL, rigs.SLOW)],
                "seed": rigs.SEED,
            }
            parts[f"plants/{number}"] = part(koul_parts.random_plants, payload, 50.0 * len(chunk))
        parts["noise"] = part(koul_parts.velocity_noise, {"offsets": scale.impact_offsets}, 60.0)
        parts["lower-cutoffs"] = part(koul_parts.lower_cutoffs, {}, 60.0)
        rates = {"rates": scale.levant_rates}
        parts["differentiators"] = part(koul_parts.differentiators, rates, 300.0)
        for bits in scale.state_bits:
            payload = {"bits": bits, "offsets": scale.impact_offsets}
            parts[f"words/{bits}"] = part(koul_parts.word_lengths, payload, 60.0)
        return parts

    def results(self, done: Parts) -> Koul:
        """Convert the results of all tasks of the computation to one typed object."""
        scale = self._scale
        maps = {name: ZWidth.of(plan, done.results[f"map/{name}"]) for name, plan in self._maps.items()}
        kmax = {
            (preset, lag): KMax.of(ZWidth.of(plan, done.results[f"kmax/{preset}/{lag}"]))
            for (preset, lag), plan in self._kmax.items()
        }
        ideas = {}
        for idea in self._ideas:
            found = ZWidth.of(self._idea_maps[idea.key], done.results[f"idea/{idea.key}"])
            (of_idea,) = koul_parts.ranges_of(done.results[f"idea-range/{idea.key}"], len(scale.offsets))
            linear = done.one(f"idea-linear/{idea.key}")
            known = None if "not_linear" in linear else {name: linear[name] for name in ("peak", "range")}
            ideas[idea.key] = koul_ideas.Tried(idea, found, of_idea, known)
        ranges = {held.name: self._ranges_of(done.results[f"range/{held.name}"]) for held in rigs.HELD}
        effects = {
            name: Effect(
                undamped={
                    key: ZWidth.of(plan, done.results[f"effect/{name}"]).curve(number, "felt")[0].stiffness
                    for number, key in enumerate((rigs.DUAL, rigs.SLOW))
                },
                ranges=self._ranges_of(done.results[f"effect-range/{name}"]),
            )
            for name, plan in self._effect_maps.items()
        }
        return Koul(
            scale=scale,
            kmax=kmax,
            kmax_theory={
                (preset, lag): done.one(f"kmax-theory/{preset}/{lag}")["stiffness"]
                for preset, lag in self._kmax
            },
            maps=maps,
            ranges=ranges,
            linear={
                held.name: {key: done.one(f"linear/{held.name}/{key}") for key in rigs.SCHEMES}
                for held in rigs.HELD
            },
            effects=effects,
            figure_7=compare_koul.koul_figure_7(offsets=scale.impact_offsets),
            words=tuple(row for bits in scale.state_bits for row in done.one(f"words/{bits}")),
            figure_8=compare_koul.koul_figure_8(),
            noise=done.one("noise"),
            lower_cutoffs=done.one("lower-cutoffs"),
            differentiators=done.one("differentiators"),
            plants=tuple(
                row
                for name, results in done.results.items()
                if name.startswith("plants/")
                for rows in results
                for row in rows
            ),
            ideas=ideas,
            hits=sum(found.hits for found in (*maps.values(), *(tried.map for tried in ideas.values())))
            + sum(found.map.hits for found in kmax.values()),
        )

    def _kmax_plan(self, preset: str, lag: str) -> MapPlan:
        experiment = rigs.HeldRig(preset=preset, grip="normal").experiment(rigs.LAGS[lag])
        search = search_for(experiment, "bisection", ratio=self._scale.kmax_ratio, lowest=1.0)
        plan = kmax_plan(experiment, search, rates=self._scale.rates, offsets=self._scale.offsets)
        return replace(plan, judged="true")

    def _map_plan(self, held: rigs.HeldRig) -> MapPlan:
        experiment, scale = held.experiment(), self._scale
        main = held in rigs.MAIN
        way: Way = "grid" if held == rigs.MAIN[0] else "ladder"
        return MapPlan(
            experiment=experiment,
            schemes=tuple(rigs.SCHEMES.values()),
            dampings=self._dampings[held.preset][:: 1 if main else 2],
            search=_search(experiment, way, scale.ratio if main else scale.ratio**1.5),
            offsets=scale.offsets if main else scale.offsets[:1],
            judged="true",
        )

    def _idea_plan(self, idea: Idea) -> MapPlan:
        scale, experiment = self._scale, idea.experiment()
        return MapPlan(
            experiment=experiment,
            schemes=(idea.scheme,),
            dampings=scale.idea_dampings,
            search=_search(experiment, "ladder", scale.idea_ratio),
            offsets=scale.idea_offsets,
            judged="true",
        )

    def _effect_plan(self, experiment: Experiment) -> MapPlan:
        return MapPlan(
            experiment=experiment,
            schemes=(rigs.SCHEMES[rigs.DUAL], rigs.SCHEMES[rigs.SLOW]),
            dampings=(0.0,),
            search=_search(experiment, "bisection", self._scale.kmax_ratio),
            offsets=self._scale.offsets,
            judged="true",
        )

    def _ranges(self, experiment: Experiment, schemes: Sequence[Scheme] | None = None) -> Part:
        search = StiffnessSearch(way="bisection", lowest=0.02, highest=10.0, ratio=self._scale.range_ratio)
        return koul_parts.range_tasks(
            experiment,
            schemes or tuple(rigs.SCHEMES.values()),
            self._scale.offsets,
            stiffness=rigs.LOWEST_STIFFNESS,
            search=search,
            weight=15.0,
        )

    def _ranges_of(self, results: Sequence[Any]) -> dict[str, dict[str, DampingRange]]:
        found = koul_parts.ranges_of(results, len(self._scale.offsets))
        return dict(zip(rigs.SCHEMES, found, strict=True))

    def _linear(self, held: rigs.HeldRig, scheme: Scheme) -> Part:
        plan = self._maps[held.name]
        main = held in rigs.MAIN
        points = self._scale.theory_points if main else self._scale.theory_points // 4
        payload = {
            "experiment": config.as_mapping(plan.experiment),
            "scheme": scheme.text,
            "dampings": np.linspace(0.0, max(plan.dampings), points).tolist(),
            "islands": main and self._scale.theory_points > rigs.QUICK.theory_points,
            "passivity": main,
        }
        return part(koul_parts.linear_limits, payload, 100.0 if main else 30.0)


def _search(experiment: Experiment, way: Way, ratio: float) -> StiffnessSearch:
    highest = min(rigs.HIGHEST_STIFFNESS, highest_stiffness(experiment))
    return search_for(experiment, way, ratio=ratio, lowest=rigs.LOWEST_STIFFNESS, highest=highest)


def _dampings(experiment: Experiment, columns: int) -> tuple[float, ...]:
    """Return the wall dampings to test (N·m·s/rad): steps to 15 % beyond each linear range, and those of the paper.

    A linear range ends at the largest stable damping of a sampling scheme; ranges that differ by less than 20 % count
    once.
    """
    widest: list[float] = []
    for scheme in rigs.SCHEMES.values():
        own = koul_parts.linear_range(theory.as_lifted(experiment, scheme))
        if not any(abs(own - other) < 0.2 * other for other in widest):
            widest.append(own)
    widest.sort(reverse=True)
    columns_of = [columns, *(max(2, columns // 2) for _ in widest[1:])]
    several = [np.linspace(0.0, 1.15 * b, n + 1) for b, n in zip(widest, columns_of, strict=True)]
    ends = (DAMPING_RANGE_FAST, DAMPING_RANGE) if widest[0] > DAMPING_RANGE else ()
    return tuple(sorted({*ends, *(round(float(b), 4) for some in several for b in some)}))


def words(koul: Koul) -> dict[str, Any]:
    """Return the values that the templates of the report use, by name."""
    return {
        "koul": koul,
        "rigs": rigs,
        "rules": rules,
        "parts": koul_parts,
        "ideas": koul_ideas,
        "compare": compare_koul,
        "verdict": presets.load(rigs.COMPLIANT).verdict,
        "by_cutoff": by_cutoff,
        "cutoff": cutoff,
    }


KOUL = Paper(
    name="koul",
    quick=rigs.QUICK,
    full=rigs.FULL,
    plan=KoulPlan,
    rulings=rulings,
    words=words,
    numbers=numbers,
    provenance=provenance,
    pictures=PICTURES,
)
