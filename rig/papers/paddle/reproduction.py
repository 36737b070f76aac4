"""Measured K–B curves of a haptic paddle, reproduced over every rig that could have given them.

The data (`rig.papers.paddle.data`) is unattributed, and nothing of the rig is known but its period. So rigs are drawn
from stated priors, each is hit under the four estimators as the paddle was, and what the curves say is judged over the
rigs that are plausible. Orders and ratios count, not newtons.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rig import config
from rig.experiments.zwidth import ZWidth
from rig.papers.koul.parts import map_part
from rig.papers.paddle import data, parts, rigs, rules
from rig.papers.paddle.claims import rulings
from rig.papers.paddle.pictures import PICTURES
from rig.papers.paddle.results import Paddle, capped_of, curves_of, numbers, provenance
from rig.papers.parts import Part, Parts, part
from rig.papers.reproduction import Paper
from rig.papers.rules import MOST


class PaddlePlan:
    """All parts of the work, by name, and the way back from their results."""

    def __init__(self, scale: rigs.Scale) -> None:
        self._scale = scale
        self._drawn = tuple(rigs.Rig.drawn(number) for number in range(scale.rigs))
        self._maps = {rig.number: rigs.map_plan(rig, scale) for rig in self._drawn}

    def parts(self) -> dict[str, Part]:
        """Everything that has to be computed."""
        found = {f"map/{number}": map_part(plan) for number, plan in self._maps.items()}
        for number, plan in self._maps.items():
            payload = {
                "experiment": config.as_mapping(plan.experiment),
                "schemes": [scheme.text for scheme in plan.schemes],
                "search": asdict(plan.search),
            }
            found[f"told/{number}"] = part(parts.TOLD, payload, 5.0)
        return found

    def results(self, done: Parts) -> Paddle:
        """Make sense of what came back."""
        maps = {number: ZWidth.of(plan, done.results[f"map/{number}"]) for number, plan in self._maps.items()}
        told = [done.one(f"told/{number}") for number in self._maps]
        return Paddle(
            scale=self._scale,
            drawn=self._drawn,
            curves=tuple(curves_of(found) for found in maps.values()),
            capped=sum(capped_of(found) for found in maps.values()),
            told=tuple(dict(zip(data.ESTIMATORS, limits, strict=True)) for limits in told),
            hits=sum(found.hits for found in maps.values()),
        )


def words(paddle: Paddle) -> dict[str, Any]:
    """What the templates call for."""
    return {
        "paddle": paddle,
        "measured": data,
        "rigs": rigs,
        "rules": rules,
        "told": parts,
        "most_share": MOST,
        "verdict": rigs.Rig.drawn(0).experiment().verdict,
    }


PADDLE = Paper(
    name="paddle",
    quick=rigs.QUICK,
    full=rigs.FULL,
    plan=PaddlePlan,
    rulings=rulings,
    words=words,
    numbers=numbers,
    provenance=provenance,
    pictures=PICTURES,
)
