"""What the abstract is tried with: a linear rig, cut-offs, encoders, and models that miss the rig.

The paper's rig is a linear one of one degree of freedom; its numbers could not be read. The rig here is that of the
same group's comparison of estimators (preset chawda-linear), which may be the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rig import config
from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.experiments.searches import Search
from rig.experiments.zwidth import MapPlan
from rig.papers.cutoff.rules import ERROR

RIG = "chawda-linear"
SEED = 0
RATE = 1000  # Hz
QUANTA: Mapping[str, float] = {"1 µm": 1e-6, "10 µm": 1e-5, "50 µm": 5e-5}  # the first is the preset's
LOWEST, HIGHEST = 1000.0, 300_000.0  # N/m, of the walls that are hit

MODELS: Mapping[str, Mapping[str, float]] = {
    f"{what} {sign} {ERROR:.0%}": {key: factor}
    for what, key in (
        ("mass", "rig.mechanics.motor_inertia"),
        ("damping", "rig.mechanics.motor_damping"),
        ("friction", "rig.mechanics.motor_coulomb"),
    )
    for sign, factor in (("−", 1.0 - ERROR), ("+", 1.0 + ERROR))
}
MODELLED = "10 µm"  # the encoder of the rig that the models miss


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """How fine everything is computed."""

    name: str
    cutoffs: tuple[float, ...]  # Hz
    dampings: tuple[float, ...]  # N·s/m
    ratio: float  # between rungs of stiffness
    offsets: tuple[float, ...]


FULL = Scale(
    name="full",
    cutoffs=(5.0, 10.0, 20.0, 35.0, 60.0, 100.0, 150.0, 220.0, 320.0, 450.0),
    dampings=(0.0, 30.0, 60.0, 120.0, 180.0, 240.0, 360.0, 480.0, 640.0),
    ratio=1.1,
    offsets=(0.3,),
)
QUICK = Scale(
    name="quick",
    cutoffs=(10.0, 60.0, 220.0, 450.0),
    dampings=(0.0, 60.0, 160.0, 480.0),
    ratio=1.4,
    offsets=(0.3,),
)


def experiment(changes: Mapping[str, Any]) -> Experiment:
    """The rig in automated hits, under some changes."""
    return config.override(presets.load(RIG), {"trial.seed": SEED, **changes}, "the reproduction")


def model(name: str) -> dict[str, float]:
    """The changes that make the rig a model that misses it."""
    rig = presets.load(RIG)
    changes = {"rig.encoder.quantum": QUANTA[MODELLED]}
    for key, factor in MODELS[name].items():
        changes[key] = factor * float(getattr(rig.rig.mechanics, key.rpartition(".")[2]))
    return changes


def map_plan(changes: Mapping[str, Any], scale: Scale) -> MapPlan:
    """The walls that are hit: a scheme for each cut-off."""
    found = experiment({**changes, "trial.minimum_rest_counts": 0.0})
    return MapPlan(
        experiment=found,
        schemes=tuple(Scheme.parse(f"uniform:{RATE},cutoff_hz={cutoff:g}") for cutoff in scale.cutoffs),
        dampings=scale.dampings,
        search=Search(way="ladder", lowest=LOWEST, highest=HIGHEST, ratio=scale.ratio),
        offsets=scale.offsets,
        judged="true",
    )
