"""Measure the areas of rendered walls for a ranking: tune each estimator, then judge each estimator–law pair.

The command `rig estimators rank` uses it. Which walls count is decided in `rule`, which pair wins in `compare`.
"""

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment
from rig.control import estimators
from rig.core.deferred import integrate
from rig.core.errors import ConfigError, LawError
from rig.experiments import sweep
from rig.experiments.estimation.interface import Variant, rest_noise
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.experiments.mapping.interface import StiffnessSearch
from rig.extras.papers.ranking import rule
from rig.extras.papers.ranking.rule import ESTIMATORS, Ground, Pair, Settings, Tuned


def find_edge(passes: Callable[[int], bool], start: int, length: int) -> int:
    """Return the largest index that passes, below the first that fails; -1 if none passes.

    The search begins at `start`: its steps double until the outcome changes; a bisection follows.
    """
    low, high, step = -1, length, 1
    if passes(start):
        low = start
        while low + step < length:
            if not passes(low + step):
                high = low + step
                break
            low, step = low + step, 2 * step
    else:
        high = start
        while high - step >= 0:
            if passes(high - step):
                low = high - step
                break
            high, step = high - step, 2 * step
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def trace_limits(
    passes: Callable[[float, float], bool], dampings: Sequence[float], rungs: Sequence[float]
) -> list[float]:
    """Return at each damping the greatest of the stiffnesses `rungs` that passes, 0 if none passes.

    The search stops after `rule.EMPTY_COLUMNS` dampings in a row with 0, so the list can be shorter than `dampings`.
    """
    limits: list[float] = []
    start = len(rungs) // 2
    for damping in dampings:
        edge = find_edge(lambda index, b=damping: passes(rungs[index], b), start, len(rungs))  # type: ignore[misc]
        limits.append(rungs[edge] if edge >= 0 else 0.0)
        start = edge if edge >= 0 else start
        begun = any(limits) or len(limits) >= rule.FEWEST_COLUMNS
        if begun and len(limits) > rule.EMPTY_COLUMNS and not any(limits[-rule.EMPTY_COLUMNS :]):
            break
    return limits


def area_under(limits: Sequence[float], dampings: Sequence[float], lowest: float) -> float:
    """Return the area below stiffness `limits` over `dampings` in the K–B plane (product of their units).

    The area is at least half the first damping above 0, times the stiffness `lowest`.
    """
    inside = [*limits, *[0.0] * (len(dampings) - len(limits))]
    return max(float(integrate.trapezoid(inside, dampings)), 0.5 * lowest * dampings[1])


@cache
def _search(rig: str, grip: str) -> StiffnessSearch:
    return Ground.of(rig).search(grip)


def series(experiment: Experiment, number: int, offset: float, rig: str, grip: str) -> dict[str, Any]:
    """Return the stiffness limit at each damping, the number of hits, and the velocity error, for one rig and grip.

    `number` is the variation of the rig (0: unchanged), `offset` the encoder's position between two counts (0 to 1).
    """
    model = config.rig_model(experiment)
    model = rule.vary(replace(model, encoder=replace(model.encoder, offset=offset)), number)
    simulator = HitSimulator(experiment, rig=model)
    hits = 0

    def passes(stiffness: float, damping: float) -> bool:
        nonlocal hits
        hits += 1
        try:
            return rule.counts(simulator.hit(stiffness, damping), stiffness, damping)
        except LawError:  # a velocity that is not finite
            return False

    limits = trace_limits(passes, Ground.of(rig).dampings(), _search(rig, grip).rungs)
    try:
        error = simulator.hit(experiment.wall.stiffness, experiment.wall.damping).rendering.velocity_error
    except LawError:
        error = sys.float_info.max
    return {"limits": limits, "hits": hits, "error": error}


def tune(payload: Mapping[str, Any]) -> dict[str, Any]:
    """Find the best settings of an estimator: those with the largest areas of rendered walls.

    Return ``best``, the index of the settings in the grid of `payload`, and ``tried``: (index, ln of the product of
    areas). The grid is searched at every `rule.COARSE`-th value, then at the neighbours of the best.
    """
    rig, grid = payload["rig"], payload["grid"]
    ground, pair = Ground.of(rig), Pair(payload["estimator"], payload["dual"])
    if len(grid) == 1:
        return {"best": 0, "tried": []}
    log_products: dict[int, float] = {}

    def log_product(index: int) -> float:
        if index not in log_products:
            log_products[index] = 0.0
            for grip in rule.TUNING_CONDITIONS:
                try:
                    experiment = ground.experiment(pair, grid[index], grip, 0)
                except ConfigError:  # the filter cannot be realised at this rate
                    log_products[index] = -math.inf
                    break
                limits = series(experiment, 0, rule.TUNING_OFFSET, rig, grip)["limits"]
                area = area_under(limits, ground.dampings(), _search(rig, grip).lowest)
                log_products[index] += math.log(area)
        return log_products[index]

    best = max([*range(0, len(grid), rule.COARSE), len(grid) - 1], key=log_product)
    step = rule.COARSE // 2
    while step:
        best = max(
            (index for index in (best, best - step, best + step) if 0 <= index < len(grid)), key=log_product
        )
        step //= 2
    tried = [
        [index, log_products[index]] for index in sorted(log_products) if math.isfinite(log_products[index])
    ]
    return {"best": best, "tried": tried}


def judge(payload: Mapping[str, Any]) -> dict[str, Any]:
    """Return the areas of rendered walls, undamped stiffness limits and velocity errors of one estimator–law pair.

    `payload` names pair, settings, rig, grip and delay; each list has a value for each encoder offset.
    """
    rig, grip, number = payload["rig"], payload["grip"], payload["number"]
    ground, pair = Ground.of(rig), Pair(*payload["pair"])
    experiment = ground.experiment(pair, payload["settings"], grip, payload["delay"])
    experiment = config.override(experiment, {"trial.seed": rule.JUDGED_SEED + number}, "the ranking")
    rungs, dampings = _search(rig, grip).rungs, ground.dampings()
    results = [series(experiment, number, offset, rig, grip) for offset in rule.OFFSETS]
    return {
        "areas": [area_under(result["limits"], dampings, rungs[0]) for result in results],
        "undamped": [result["limits"][0] for result in results],
        "errors": [result["error"] for result in results],
        "capped": sum(limit == rungs[-1] for result in results for limit in result["limits"]),
        "hits": sum(result["hits"] for result in results),
    }


def judging_tasks(
    ground: Ground,
    pairs: Sequence[Pair],
    tuned: Mapping[str, Settings],
    *,
    grips: Sequence[str] = rule.CONDITIONS,
    delays: Sequence[int] = rule.DELAYS,
    variations: int = rule.VARIATIONS,
) -> list[sweep.Task]:
    """Return the tasks that judge estimator–law pairs on a rig, sorted by delay and grip.

    `tuned` has the estimator's settings by the name of the pair without a special law.
    """
    return [
        sweep.Task(
            f"{pair.name}/{grip}/{delay}/{number}",
            judge,
            {
                "rig": ground.name,
                "pair": [pair.estimator, pair.dual, pair.law],
                "settings": tuned[pair.plain.name],
                "grip": grip,
                "delay": delay,
                "number": number,
            },
        )
        for delay in delays
        for grip in grips
        for pair in pairs
        for number in range(variations + 1)
    ]


def measure_rig(
    rig: str,
    *,
    pairs: Sequence[Pair] | None = None,
    entries: Sequence[Tuned] = (),
    directory: Path | None = None,
    workers: int | None = 1,
    watch: Callable[[sweep.Progress], None] | None = None,
    **matrix: Any,
) -> dict[str, Any]:
    """Measure estimator–law pairs (None: all that the rig can run) on one rig; return values for JSON.

    `entries` are the user's own estimators, each with the range of its tuned parameter. An interrupted measurement
    resumes from the two journals in `directory`. `workers` is the number of processes, `watch` receives the progress,
    `matrix` limits `grips`, `delays` and `variations`. Raise `ConfigError` for an unknown rig or estimator.
    """
    ground = Ground.of(rig)
    # `get` refuses an unknown name here; else all others would be tuned first, which takes minutes.
    known = {**ESTIMATORS, **{estimators.get(entry.estimator).name: entry for entry in entries}}
    chosen = [*(ground.pairs if pairs is None else pairs), *(Pair(entry.estimator) for entry in entries)]
    grids = {pair.plain: known[pair.estimator].grid(ground.velocity_rate(pair)) for pair in chosen}

    def run(stage: str, tasks: Sequence[sweep.Task]) -> dict[str, Any]:
        journal = None if directory is None else directory / f"{rig}-{stage}.journal"
        found = sweep.run(tasks, journal=journal, workers=workers, watch=watch)
        return dict(zip([task.key for task in tasks], found, strict=True))

    tuning_tasks = [
        sweep.Task(
            pair.name, tune, {"rig": rig, "estimator": pair.estimator, "dual": pair.dual, "grid": grid}
        )
        for pair, grid in grids.items()
    ]
    best = {name: found["best"] for name, found in run("tuning", tuning_tasks).items()}
    tuned = {pair.name: grid[best[pair.name]] for pair, grid in grids.items()}
    ends = [
        pair.name for pair, grid in grids.items() if len(grid) > 1 and best[pair.name] in (0, len(grid) - 1)
    ]
    judged = run("judging", judging_tasks(ground, chosen, tuned, **matrix))
    noise = {pair.name: rest_velocity(ground, pair, tuned[pair.name]) for pair in grids}
    return {"rig": rig, "tuned": tuned, "ends": ends, "noise": noise, "conditions": compact(judged)}


def rest_velocity(ground: Ground, pair: Pair, settings: Settings) -> float:
    """Return the estimated velocity (rms, rad/s or m/s) at rest, while the encoder toggles between two counts."""
    own = estimators.get(pair.estimator).settings_of(config.settings_of_rig(ground.preset))
    variant = Variant(pair.estimator, {**own, **settings})
    period_s = 1.0 / ground.velocity_rate(pair)
    return _three_digits(rest_noise(variant, period_s, ground.preset.rig.encoder.resolution)[1])


def estimate_s(rig: str) -> float:
    """Return the estimated time of ranking on one rig (s, one core), from some hits with a filtered difference."""
    ground = Ground.of(rig)
    pair = Pair("fdm-butterworth")
    settings: Settings = {"cutoff_hz": 0.05 * ground.velocity_rate(pair)}
    spent = []
    for grip in rule.TUNING_CONDITIONS:
        (task,) = judging_tasks(ground, [pair], {pair.name: settings}, grips=[grip], delays=[0], variations=0)
        judge(task.payload)  # compiles, and fills caches
        began = time.process_time()
        judge(task.payload)
        spent.append(time.process_time() - began)
    tasks = len(ground.pairs) * len(rule.CONDITIONS) * len(rule.DELAYS) * (rule.VARIATIONS + 1)
    return tasks * float(np.mean(spent))


def compact(judged: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return areas, undamped stiffness limit, velocity error and capped dampings, by pair and condition (grip/delay).

    The area of each variation is the geometric mean over the encoder offsets. The undamped limit is a mean, the
    velocity error a median, over variations and offsets.
    """
    gathered: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    for key, result in judged.items():
        pair, grip, delay, _ = key.split("/")
        gathered.setdefault(pair, {}).setdefault(f"{grip}/{delay}", []).append(result)
    return {
        pair: {name: _condition_results(variations) for name, variations in conditions.items()}
        for pair, conditions in gathered.items()
    }


def _condition_results(variations: Sequence[Mapping[str, Any]]) -> list[Any]:
    return [
        [_three_digits(math.exp(np.mean(np.log(result["areas"])))) for result in variations],
        _three_digits(float(np.mean([result["undamped"] for result in variations]))),
        _three_digits(float(np.median([result["errors"] for result in variations]))),
        sum(result["capped"] for result in variations),
    ]


def _three_digits(value: float) -> float:
    return float(f"{value:.3g}")
