"""Describe the methods of a study in paragraphs for a paper, from the protocol, the logs and the results.

The text is in ``session_methods.j2``; this module computes the values in it. To repeat the study, a reader needs the
protocol file and these paragraphs.
"""

import platform
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from rig.config import OSCILLATIONS, Controller, Experiment, parameters
from rig.control import estimators
from rig.control.estimators import Estimator
from rig.core.errors import RigError
from rig.extras.study.agreement import LEAST_PEOPLE
from rig.extras.study.analyse import StudyAnalysis
from rig.extras.study.kmax import ENOUGH_REPEATS, LEAST_VALUES, RESAMPLES
from rig.extras.study.rows import Measure
from rig.recording.header import checkout
from rig.session.finished import cells_of, describe_task, levels_of, rows_of, rule, walls_in
from rig.session.search import EDGE_VERDICTS, LAPSE_RATES, PsychometricGrid, Rule, of_levels
from rig.views.report import fill_text

TEMPLATE = "extras/study/session_methods.j2"
MEASURES: Mapping[Measure, str] = {
    "rule": "the limit that the search rule gives",
    "K50 person": "K50, the stiffness at which half of the person's verdicts are stable",
    "K50 automatic": "K50 of the automatic verdicts, the stiffness at which half of them are stable",
}
# Keys whose values in effect stand in other paragraphs, and keys that change nothing at zero.
_SCHEME = tuple(
    f"controller.{name}"
    for name in ("position_rate", "velocity_rate", "estimator", "parameters", "prediction")
)
_ELSEWHERE = (
    *_SCHEME,
    "rig.limits.",
    "homing.",
    "verdict.",
    "trial.duration_s",
    "trial.baseline_s",
    "trial.foreperiod_s",
    "trial.hold_s",
    "trial.release_s",
    "trial.effort",
    "trial.start",
    "operator.begin_s",
    "operator.reach_s",
)
_NONE_AT_ZERO = ("trial.minimum_rest_counts",)
_CAPS = {"stiffness": "stiffness", "effort": "effort", "speed": "velocity", "energy": "J"}


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph of the methods under a short heading."""

    heading: str
    text: str


@dataclass(frozen=True, slots=True)
class _Setting:
    """A changed setting of the experiment: its key, its meaning, and its value with unit, as text."""

    key: str
    meaning: str
    value: str


@dataclass(frozen=True, slots=True)
class _Condition:
    """A condition of the study; `controller` and `estimator` are None if its estimator is not installed here."""

    name: str
    fit: str
    dampings: tuple[str, ...]
    controller: Controller | None
    estimator: Estimator | None
    changes: tuple[_Setting, ...]


@dataclass(frozen=True, slots=True)
class _StatedSearch:
    """Settings of a search: of the study (`condition` None), or of one condition that has its own settings."""

    condition: str | None
    levels: tuple[float, ...]
    step: float | None
    ratio: float | None
    rule_name: str
    rule: Rule
    catch_share: float


@dataclass(frozen=True, slots=True)
class _Prior:
    """Prior of the psychometric function on the searched stiffnesses `levels`, before any verdict."""

    levels: tuple[float, ...]
    grid: PsychometricGrid


def methods(found: StudyAnalysis) -> tuple[Paragraph, ...]:
    """Return all paragraphs of the methods, in the order of a paper."""
    text = fill_text(TEMPLATE, **_collect_facts(found))
    parts = re.findall(r"^## (.+)\n((?:(?!## ).*\n?)*)", text, flags=re.MULTILINE)
    return tuple(Paragraph(heading.strip(), " ".join(body.split())) for heading, body in parts)


def effective(found: StudyAnalysis) -> dict[str, Experiment | RigError]:
    """Return each condition's experiment at its first damping and softest wall, or the error if it is not available."""
    state = found.study.sessions[0].state
    walls = walls_in(state)
    experiments: dict[str, Experiment | RigError] = {}
    for condition in state.protocol.condition:
        try:
            experiments[condition.name] = walls.softest(condition)
        except RigError as error:  # an estimator that is not installed here
            experiments[condition.name] = error
    return experiments


def first_experiment(found: StudyAnalysis) -> Experiment:
    """Return the experiment of the first condition; the study's base experiment if its estimator is not installed."""
    walls = walls_in(found.study.sessions[0].state)
    try:
        return walls.softest(walls.protocol.condition[0])
    except RigError:
        return walls.base


@cache  # reading the metadata of five packages takes as long as a whole page
def analysed_with() -> dict[str, str]:
    """Return the versions of the programs and libraries that compute this analysis, by name."""
    found = {}
    for name in ("haptic-rig", "numpy", "scipy", "statsmodels", "matplotlib"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return {**found, **checkout(), "Python": platform.python_version()}


def _collect_facts(found: StudyAnalysis) -> dict[str, Any]:
    study, protocol, measure = found.study, found.study.protocol, found.options.measure
    experiments = effective(found)
    x = first_experiment(found)
    limits = x.rig.limits
    human = limits.human and protocol.trial.kind == "human"
    model = next((one for one in found.mixed if one.measure == measure), None)
    over = [one for one in found.over_participants if one.measure == measure]
    stop = {
        "{} trials": protocol.stop.trials,
        "{:g} min": protocol.stop.minutes,
        "{} invalid trials in a row": protocol.stop.invalid,
        "{} hits in a row that were cut off for safety": protocol.stop.aborts,
    }
    capped = {name: getattr(protocol.caps, name) for name in _CAPS}
    return {
        "found": found,
        "protocol": protocol,
        "x": x,
        "unit": study.unit,
        "asked": describe_task(protocol.trial, study.motion),
        "measure": measure,
        "measures": MEASURES,
        "complete": sum(session.complete for session in study.sessions),
        "devices": _collect_opened(found, "device", "firmware", "simulated"),
        "conditions": list(_conditions(found, experiments)),
        "changes": _settings(found, protocol.study.changes, _ELSEWHERE),
        "searches": list(_searches(found)),
        "edge_verdicts": EDGE_VERDICTS,
        "cells": len(cells_of(protocol)),
        "rows": rows_of(protocol),
        "row_counts": dict(sorted(Counter(s.state.row % rows_of(protocol) for s in study.sessions).items())),
        "oscillations": limits.oscillations
        if limits.oscillations is not None
        else OSCILLATIONS
        if human
        else 0,
        "caps": [
            f"{name} {value:g} {study.unit(_CAPS[name])}"
            for name, value in capped.items()
            if value is not None
        ],
        "ends": [text.format(value) for text, value in stop.items() if value is not None],
        "counts": found.counts(),
        "others": [
            f"{n} {name}" for name, n in found.counts().items() if name not in ("recorded", "counted") and n
        ],
        "model": model,
        "random_effects": [name for name, _ in model.deviations[:-1]] if model else [],
        "censored": sum(one.above + one.below for one in over),
        "limit_count": sum(one.limits for one in over),
        "least_values": LEAST_VALUES,
        "enough_repeats": ENOUGH_REPEATS,
        "resamples": RESAMPLES,
        "least_people": LEAST_PEOPLE,
        "lapse_rates": [f"{100 * value:g}" for value in LAPSE_RATES],
        "priors": _priors(found),
        "versions": list(_versions(found)),
        "analysed_with": [f"{name} {text}" for name, text in analysed_with().items()],
    }


def _conditions(
    found: StudyAnalysis, experiments: Mapping[str, Experiment | RigError]
) -> Iterator[_Condition]:
    for condition in found.study.protocol.condition:
        experiment = experiments[condition.name]
        yield _Condition(
            name=condition.name,
            fit=condition.fit,
            dampings=tuple(f"{damping:g}" for damping in condition.damping),
            controller=experiment.controller if isinstance(experiment, Experiment) else None,
            estimator=estimators.get(experiment.controller.estimator)
            if isinstance(experiment, Experiment)
            else None,
            changes=_settings(found, condition.changes, _SCHEME),
        )


def _settings(
    found: StudyAnalysis, changes: Mapping[str, Any], elsewhere: tuple[str, ...]
) -> tuple[_Setting, ...]:
    known, motion = parameters(), found.study.motion
    settings = []
    for key, value in changes.items():
        about = known.get(key)
        if key.startswith(elsewhere) or (key in _NONE_AT_ZERO and not value):
            continue
        meaning = about.meaning.partition(";")[0] if about else key.rpartition(".")[2].replace("_", " ")
        shown = f"{value:g}" if isinstance(value, float) else str(value)
        settings.append(_Setting(key, meaning, f"{shown} {about.unit_for(motion) if about else ''}".strip()))
    return tuple(settings)


def _searches(found: StudyAnalysis) -> Iterator[_StatedSearch]:
    protocol = found.study.protocol
    own = [(one.name, one.search) for one in protocol.condition if one.search is not None]
    shared = [(None, protocol.search)] if len(own) < len(protocol.condition) else []
    for name, wanted in (*shared, *own):
        yield _StatedSearch(
            condition=name,
            levels=tuple(levels_of(wanted)),
            step=wanted.step,
            ratio=wanted.ratio,
            rule_name=wanted.rule,
            rule=rule(wanted, 0),
            catch_share=wanted.catch_share,
        )


def _priors(found: StudyAnalysis) -> list[_Prior]:
    protocol = found.study.protocol
    every = dict.fromkeys(tuple(levels_of(protocol.search_of(one))) for one in protocol.condition)
    return [_Prior(levels, of_levels(levels)) for levels in every]


def _collect_opened(found: StudyAnalysis, *names: str) -> list[tuple[Any, ...]]:
    """Return the distinct combinations of the values `names` in the log's events "opened" (a rig was opened)."""
    every = [
        tuple(event.content.get(name, "unknown") for name in names)
        for session in found.study.sessions
        for event in session.of_kind("opened")
    ]
    return list(dict.fromkeys(every))


def _versions(found: StudyAnalysis) -> Iterator[str]:
    sets = dict.fromkeys(tuple((s.began.get("versions") or {}).items()) for s in found.study.sessions)
    for versions in filter(None, sets):
        named = [f"{name} {text}" for name, text in versions if name not in ("sources", "protocol")]
        sources = dict(versions).get("sources")
        yield ", ".join(named) + (f" (sources {str(sources)[:12]})" if sources else "")
