"""Measure a map (which walls a simulated rig renders stably) for a page, like ``rig zwidth``, in a process of its own.

The page reads the results in the directory of the map.
"""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from rig import config
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import FrequencyPlan, MapRequest, frequency_plan, numbers_of
from rig.experiments.sweep import Progress
from rig.extras.console.hits import experiment_of
from rig.extras.console.talk import Talk


def zwidth(content: Mapping[str, Any], talk: Talk) -> Any:
    """Measure which walls of a simulated rig are stable or passive; return the name of the map's directory.

    `content` has the fields of the page's request `RunMap`; `talk` reports the progress.
    """
    experiment = config.override(experiment_of(content), content["changes"], "the page")
    frequency = content["domain"] == "frequency"
    plan = _impedances(experiment, content) if frequency else MapRequest(**_fields(content)).plan(experiment)
    name = "impedance-map" if frequency else "zwidth"
    place = maps.directory_for(plan, Path(content["output"]), name)
    is_reported = False

    def watch(progress: Progress) -> None:
        nonlocal is_reported
        if not is_reported:
            # From the first report on, the directory exists.
            talk.tell("mapping", map=place.name)
            is_reported = True
        talk.progress(stage="stopping" if progress.stopping else "mapping", map=place.name)

    maps.map_into(plan, place, watch=watch)
    return {"map": place.name}


def _fields(content: Mapping[str, Any]) -> dict[str, Any]:
    return {one.name: content[one.name] for one in fields(MapRequest)}


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
