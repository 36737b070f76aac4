"""The job that maps a simulated rig, as ``rig zwidth`` does; what it finds, the page reads in the map's directory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig import config
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.console.hits import experiment_of
from rig.console.talk import Talk
from rig.experiments import maps
from rig.experiments.ranges import frequency_plan, hit_plan, schemes_for, search_for
from rig.experiments.searches import bounds_of, numbers_of
from rig.experiments.sweep import Progress
from rig.experiments.zwidth import MapPlan
from rig.experiments.zwidth_frequency import FrequencyPlan


def zwidth(content: Mapping[str, Any], talk: Talk) -> Any:
    """Map hits or impedances (`rig.console.maps.RunMap`); returns the map's name."""
    experiment = config.override(experiment_of(content), content["changes"], "the page")
    frequency = content["domain"] == "frequency"
    plan = _impedances(experiment, content) if frequency else _hits(experiment, content)
    name = "impedance-map" if frequency else "zwidth"
    place = maps.directory_for(plan, Path(content["output"]), name)
    said = False

    def watch(progress: Progress) -> None:
        nonlocal said
        if not said:  # the directory is there
            talk.tell("mapping", map=place.name)
            said = True
        talk.progress(stage="stopping" if progress.stopping else "mapping", map=place.name)

    maps.map_into(plan, place, watch=watch)
    return {"map": place.name}


def _hits(experiment: Experiment, content: Mapping[str, Any]) -> MapPlan:
    low, high = bounds_of(content["stiffness"], "stiffness") if content["stiffness"] else (None, None)
    dampings = _numbers(content, "damping")
    schemes = schemes_for(experiment, _schemes(content), dampings)
    return hit_plan(
        experiment,
        schemes,
        dampings=dampings,
        search=search_for(
            experiment, content["way"], ratio=content["ratio"], lowest=low, highest=high, schemes=schemes
        ),
        offsets=_numbers(content, "offsets"),
        repeats=content["repeats"],
        judged=content["judged"],
    )


def _impedances(experiment: Experiment, content: Mapping[str, Any]) -> FrequencyPlan:
    return frequency_plan(
        experiment,
        _schemes(content),
        stiffnesses=_numbers(content, "stiffness"),
        dampings=_numbers(content, "damping"),
        signal={None: None, "true": "truth", "recorded": "count"}[content["judged"]],
    )


def _schemes(content: Mapping[str, Any]) -> list[Scheme]:
    return [Scheme.parse(text) for text in content["schemes"]]


def _numbers(content: Mapping[str, Any], name: str) -> tuple[float, ...] | None:
    return numbers_of(content[name], name) if content[name] else None
