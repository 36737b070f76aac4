"""Work for a page outside the server's process: list and describe maps of stable walls, read results, find recordings.

`errand_worker` calls these functions. They must not write into the directory of a map.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

from rig.control.verdict import CRITERIA, Kind
from rig.core.errors import ConfigError, RecordingError, RigError
from rig.core.locks import is_locked
from rig.core.sample import unit_of
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import (
    RECORDING,
    TOGETHER,
    TRUE,
    FrequencyPlan,
    MapPlan,
    linear_curves,
    theory_curves,
)
from rig.experiments.sweep import read_on
from rig.recording.files import plain_errors

KINDS = tuple(str(kind) for kind in (Kind.STABLE, Kind.LIMIT_CYCLE, Kind.UNSTABLE, Kind.INVALID))
STABLE, LIMIT_CYCLE, UNSTABLE, INVALID = range(4)  # indices in `KINDS`, sent to the page
MOST = 500  # maps of a list


def directories(directory: str) -> list[dict[str, Any]]:
    """Return up to `MOST` maps (measurements of which walls are stable or passive) of a directory, newest first.

    Each has name, rig, domain ("time": wall hits; "frequency": impedances), number of schemes, and state ("running",
    "finished", "stopped").
    """
    found = [path.parent for path in Path(directory).glob(f"*/{maps.PLAN}")]
    found.sort(key=lambda path: -_changed_s(path))
    return [_headline(path) for path in found[:MOST]]


def _changed_s(path: Path) -> float:
    try:
        return (path / maps.JOURNAL).stat().st_mtime
    except OSError:
        # Its journal is not written yet, or was moved away meanwhile: the oldest in the list.
        return 0.0


def _headline(path: Path) -> dict[str, Any]:
    facts: dict[str, Any] = {"name": path.name, "changed_s": _changed_s(path)}
    try:
        plan, device = _plan(path)
    except RigError as error:
        return {**facts, "problem": str(error)}
    return {
        **facts,
        "problem": None,
        "rig": plan.experiment.rig.name,
        "domain": "frequency" if isinstance(plan, FrequencyPlan) else "time",
        "device": device,
        "schemes": len(plan.schemes),
        "state": _state(path),
    }


def _state(path: Path) -> str:
    if is_locked(path / maps.JOURNAL):
        return "running"
    return "finished" if (path / maps.SUMMARY).exists() else "stopped"


def _plan(path: Path) -> tuple[MapPlan | FrequencyPlan, str]:
    with plain_errors("read", path / maps.PLAN):
        return _read(path, (path / maps.PLAN).stat().st_mtime_ns)


@lru_cache(maxsize=MOST)
def _read(path: Path, changed_ns: int) -> tuple[MapPlan | FrequencyPlan, str]:
    return maps.read_plan(path)


def describe_map(directory: str) -> dict[str, Any]:
    """Return axes, units and sampling schemes of a map of stable walls, with the computing cost of each scheme."""
    path = Path(directory)
    plan, _ = _plan(path)
    experiment = plan.experiment
    motion = experiment.rig.motion
    facts: dict[str, Any] = {
        **_headline(path),
        "schemes": [
            {"text": scheme.text, "label": scheme.label(experiment), "weight": scheme.position_rate}
            for scheme in plan.schemes
        ],
        "dampings": list(plan.dampings),
        "units": {name: unit_of(name, motion) for name in ("stiffness", "damping")},
    }
    if isinstance(plan, FrequencyPlan):
        return {**facts, "criteria": [], "stripes": [""], "stiffnesses": list(plan.stiffnesses)}
    return {
        **facts,
        "criteria": list(CRITERIA),
        "kinds": KINDS,
        "judged": plan.judged,
        "stripes": [
            f"zero at {offset:g} count" + (f", repeat {repeat + 1}" if plan.repeats > 1 else "")
            for offset in plan.offsets
            for repeat in range(plan.repeats)
        ],
        "ratio": plan.search.ratio,
    }


def growth(directory: str, place: int) -> dict[str, Any]:
    """Read the results that were added to a map's journal (its file of results) after the byte offset `place`.

    Return the new columns (results at one damping), the new offset, and the state: "running", "finished" or "stopped".
    """
    path = Path(directory)
    plan, _ = _plan(path)
    # Read the state before the journal: if the map is finished now, its journal is complete.
    state = _state(path)
    found: list[tuple[str, Any]] = []
    if (path / maps.JOURNAL).exists():
        found, place = read_on(path / maps.JOURNAL, place)
    columns = [
        _impedances(plan, key, rows) if isinstance(plan, FrequencyPlan) else _hits(plan, key, rows)
        for key, rows in found
    ]
    return {"columns": columns, "place": place, "state": state}


def _hits(plan: MapPlan, key: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    series = next(one for one in plan.series() if one.key == key)
    suffix = TRUE if plan.judged == "true" else ""
    return {
        "key": key,
        "scheme": series.scheme,
        "damping": plan.dampings.index(series.damping),
        "stripe": plan.offsets.index(series.offset) * plan.repeats + series.repeat,
        "cells": [
            [
                row["stiffness"],
                KINDS.index(row[f"kind{suffix}"]),
                *(_code(row, name, suffix) for name in CRITERIA),
            ]
            for row in rows
        ],
    }


def _code(row: dict[str, Any], criterion: str, suffix: str) -> int:
    passes = row[f"passes_{criterion}{suffix}"]
    if passes is None:
        return INVALID
    if passes:
        return STABLE
    return UNSTABLE if row[f"kind{suffix}"] == KINDS[UNSTABLE] else LIMIT_CYCLE


def _impedances(plan: FrequencyPlan, key: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    scheme, _, damping = key.partition("/")
    return {
        "key": key,
        "scheme": int(scheme),
        "damping": plan.dampings.index(float(damping)),
        "stripe": 0,
        "cells": [
            [row["stiffness"], row["passive"], row["fidelity"], row["reason"]]
            for row in rows
            if row["realisation"] == TOGETHER
        ],
    }


def theory(directory: str) -> list[dict[str, Any]]:
    """Return the largest stable and passive stiffness over damping (SI) by linear theory, for each scheme of a map."""
    plan, _ = _plan(Path(directory))
    if isinstance(plan, FrequencyPlan):
        return [
            {"scheme": number, "name": name, "damping": dampings, "stiffness": stiffness}
            for number, (dampings, stable, passive) in linear_curves(plan).items()
            for name, stiffness in (("linearly stable", stable), ("passive in band", passive))
        ]
    return [
        {"scheme": number, "name": "linear theory, no friction", "damping": dampings, "stiffness": stiffness}
        for number, (dampings, stiffness) in theory_curves(plan).items()
    ]


def find_recording(directory: str, key: str, stiffness: float, output: str) -> dict[str, Any]:
    """Return name and map of the recording of one wall hit; a hit of a simulated map is repeated and recorded.

    `key` names the stiffness search that made the hit, as scheme/damping/encoder offset/repeat; `output` is the
    directory of such new recordings. Raises `ConfigError` if the map has no such hit, or contains impedances instead of
    hits.
    """
    path = Path(directory)
    plan, device = _plan(path)
    if isinstance(plan, FrequencyPlan):
        raise ConfigError(
            "this map contains impedances, so it has no recording of a hit",
            remedy="measure the impedance of a single wall: rig impedance measure",
        )
    row = next(
        (
            row
            for name, rows in read_on(path / maps.JOURNAL)[0]
            for row in rows
            if name == key and row["stiffness"] == stiffness
        ),
        None,
    )
    if row is None:
        raise ConfigError(
            f"the map has no cell at K = {stiffness:g} in stiffness search {key!r}: no hit was made there",
            remedy="choose a cell that the map shows",
        )
    if device:
        if not (path / maps.RECORDINGS / row[RECORDING]).exists():
            raise RecordingError(f"recording {row[RECORDING]} is missing", remedy="restore it from a copy")
        return {"name": row[RECORDING], "map": path.name}
    series = next(one for one in plan.series() if one.key == key)
    return {"name": maps.recorded_hit(plan, series, stiffness, Path(output)).name, "map": ""}
