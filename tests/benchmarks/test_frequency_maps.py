"""Measure the cost of a map in the frequency domain, by what does not depend on the machine.

Judging a wall costs less than three times its simulation, and a map of many columns needs no more memory than one of a
few.
"""

import time
import tracemalloc
from dataclasses import replace
from typing import Any

import pytest

from rig import config
from rig.config import presets
from rig.experiments.mapping._ranges import frequency_plan
from rig.experiments.mapping.impedance import Judging
from rig.experiments.mapping.zwidth_frequency import run_column, wall_rows
from rig.experiments.trials.excitation_run import ExcitedRig

ONCE = config.override(presets.load("chawda-linear"), {"excitation.realisations": 1})


@pytest.mark.parametrize("scheme", range(4))
def test_judging_costs_less_than_three_times_exciting(
    scheme: int, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = frequency_plan(ONCE)
    experiment = plan.schemes[scheme].applied(config.excited(ONCE))
    bench = ExcitedRig(experiment)
    walls = [
        replace(experiment, wall=replace(experiment.wall, stiffness=k, damping=60.0))
        for k in plan.stiffnesses[:12]
    ]
    bench.excite(1e3, 10.0)
    shares = []
    for walled in walls:
        began = time.thread_time()
        bench.excite(walled.wall.stiffness, walled.wall.damping)
        excited = time.thread_time() - began
        began = time.thread_time()
        list(wall_rows(bench, walled, Judging(), "count"))
        shares.append((time.thread_time() - began) / excited)
    share = sorted(shares)[len(shares) // 2]
    with capsys.disabled():
        print(
            f"\n{plan.schemes[scheme].text.split(',')[1]}: a judged wall costs {share:.2f} of an excited one"
        )
    assert share < 3.0


def test_memory_is_that_of_a_column() -> None:
    plan = frequency_plan(ONCE)
    payload = {**plan.tasks[0].payload, "stiffnesses": list(plan.stiffnesses[:3])}
    run_column(payload)

    def peak(stiffnesses: Any) -> Any:
        tracemalloc.start()
        run_column({**payload, "stiffnesses": stiffnesses})
        _, highest = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return highest

    few, many = peak(list(plan.stiffnesses[:3])), peak(list(plan.stiffnesses[:30]))
    assert many < few + 2_000_000
