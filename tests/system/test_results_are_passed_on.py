"""A hit or a session computes each intermediate result once: it validates, designs, judges and reads nothing twice."""

import json
import sys
from collections import Counter
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import pytest

from rig.config import _load as load
from rig.config import controller, override, presets
from rig.control import judging
from rig.core.present import plain
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.trials import judgement, plan
from rig.recording import reader
from tests.conformance.tiers import first_by_default

COUNTED: dict[str, Callable[..., Any]] = {
    "files": load.experiment_from_mapping,  # every value of an experiment and every rule
    "rules": load.broken_rules,  # after a file, and after a change of some values
    "designs": controller.for_experiment,
    "parameters": controller.device_parameters,
    "plans": plan.plan_of,
    "judgements": judgement.judge,
    # A judgement measures what was recorded, and in simulation the truth too.
    "measurings": judging.measure_signals,
    "openings": reader.open_recording,
}


@pytest.fixture
def call_counts(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count the calls of the costly functions, whichever module of `rig` they come from."""
    calls: Counter[str] = Counter()

    def counting(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def counted(*given: Any, **options: Any) -> Any:
            calls[name] += 1
            return function(*given, **options)

        return counted

    modules = [module for name, module in sys.modules.items() if name.split(".")[0] == "rig"]
    for name, function in COUNTED.items():
        instead = counting(name, function)
        for module in modules:
            for attribute in [key for key, value in vars(module).items() if value is function]:
                monkeypatch.setattr(module, attribute, instead)
    return calls


@pytest.mark.parametrize("loop", first_by_default(["host", "device"]))
def test_a_hit_validates_designs_judges_and_reads_back_once(
    loop: str, call_counts: Counter[str], tmp_path: Path
) -> None:
    experiment = presets.load("koul-rigid")
    (result,) = hit(
        HitRequest(experiment=experiment, changes={"controller.loop": loop}, output=tmp_path), admit
    )
    assert result.recorded.recording.trailer is not None
    assert plain(result.verdict) == result.recorded.recording.trailer["verdict"]
    assert result.experiment.controller.loop == loop
    assert call_counts == {
        "files": 1,
        "rules": 2,  # of the file, and of the experiment in effect: nothing else is armed
        "designs": 1,
        "parameters": 1,
        "plans": 1,
        "judgements": 1,
        "measurings": 2,
        "openings": 1,  # the capture: the sealed file is compared with it a column at a time
    }


@pytest.mark.parametrize("loop", first_by_default(["host", "device"]))
def test_a_planned_run_is_the_one_that_runs(loop: str, tmp_path: Path) -> None:
    experiment = override(presets.load("koul-rigid"), {"controller.loop": loop})
    run = plan.make_plan(experiment).run
    assert run is not None
    (result,) = hit(HitRequest(experiment=experiment, output=tmp_path), admit)
    header = result.recorded.recording.header
    assert header["initial_state"] == json.loads(json.dumps(run.controller.as_mapping()))
    active = header["identity"]["parameters"]
    assert active["verified"] == 1, "a simulation; a plan alone arms nothing"
    planned = {**run.parameters, "verified": 1}
    # The wire carries float32.
    assert {name: active[name] for name in planned} == pytest.approx(planned, rel=2.0**-24)
