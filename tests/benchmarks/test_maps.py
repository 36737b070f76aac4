"""Measure the cost of a map: CPU time of Fig. 6, the share of Python, and memory over the number of hits.

pytest tests/benchmarks/test_maps.py -o addopts="" -s
"""

import json
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.analysis import theory
from rig.config import presets
from rig.experiments.mapping import _ranges as ranges
from rig.experiments.mapping._maps import zwidth
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import MapPlan, run_series
from rig.experiments.mapping.zwidth_frequency import run_column
from sim_backend.bare import hits

HELD = config.override(presets.load("koul-compliant"), {"trial.kind": "human", "operator.grip": "normal"})


@pytest.fixture(scope="module")
def figure_6() -> Any:
    """Return the plan of 17 dampings, three schemes, a ladder of 6 %, two offsets and one repeat: 102 series."""
    schemes = theory.default_schemes(HELD)
    dampings = ranges.dampings_for(HELD, schemes)
    return MapPlan(experiment=HELD, schemes=schemes, dampings=dampings, search=ranges.search_for(HELD))


def test_the_whole_map_of_figure_6(figure_6: Any) -> None:
    """Run every fourth damping, first and last included, and extrapolate to the whole."""
    started = time.process_time()
    tasks = figure_6.tasks
    planned_s = time.process_time() - started
    chosen = figure_6.dampings[::4]
    started = time.process_time()
    found = zwidth(replace(figure_6, dampings=chosen))
    cpu_s = time.process_time() - started
    whole_s = cpu_s * len(figure_6.dampings) / len(chosen)
    print(
        f"\nFig. 6: {len(tasks)} series: {whole_s:.1f} s of CPU (goal 12 s), {found.hits / cpu_s:.0f} hits per second "
        f"of a core; planning {planned_s:.2f} s"
    )
    assert planned_s < 2.0
    assert whole_s < 60.0


def test_python_takes_a_small_share_of_a_series(figure_6: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = [0.0]
    compiled = hits.hit

    def timed(*arguments: Any) -> Any:
        started = time.thread_time()
        ticks = compiled(*arguments)
        inside[0] += time.thread_time() - started
        return ticks

    payloads = [json.loads(json.dumps(task.payload)) for task in figure_6.tasks[::17]]
    run_series(payloads[0])
    monkeypatch.setattr(hits, "hit", timed)
    started = time.thread_time()
    count = sum(len(run_series(payload)) for payload in payloads)
    whole = time.thread_time() - started
    print(
        f"\n{1e3 * whole / count:.2f} ms a hit, {100 * (whole - inside[0]) / whole:.0f} % of it outside compiled code"
    )
    assert inside[0] > 0.7 * whole


def test_memory_of_a_map_does_not_grow_with_the_number_of_series(tmp_path: Path) -> None:
    short = config.override(HELD, {"trial.duration_s": 0.6, "verdict.tail_s": 0.1})

    def peak(repeats: Any) -> Any:
        plan = MapPlan(
            experiment=short,
            schemes=theory.default_schemes(short)[:1],
            dampings=(0.5,),
            search=StiffnessSearch(lowest=100.0, highest=900.0, ratio=2.5),
            repeats=repeats,
        )
        tracemalloc.start()
        found = zwidth(plan, journal=tmp_path / f"{repeats}", workers=1)
        for _ in found.table():
            pass
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most, found.hits

    peak(2)
    (few, few_hits), (many, many_hits) = peak(10), peak(30)
    grown = (many - few) / (many_hits - few_hits)
    print(f"\npeak of memory: {few / 1e6:.1f} MB for {few_hits} hits, {many / 1e6:.1f} MB for {many_hits}")
    assert grown < 10_000.0  # bytes a hit: its series' description, not its numbers


def test_memory_of_a_map_in_the_frequency_domain_is_that_of_a_column() -> None:
    once = config.override(presets.load("chawda-linear"), {"excitation.realisations": 1})
    plan = ranges.frequency_plan(once)

    def peak(walls: int) -> Any:
        tracemalloc.start()
        run_column({**plan.tasks[0].payload, "stiffnesses": list(plan.stiffnesses[:walls])})
        _, highest = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return highest

    peak(3)
    assert peak(30) < peak(3) + 2_000_000
