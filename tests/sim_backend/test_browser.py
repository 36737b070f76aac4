"""The rig of the documents' first page: its hits are those of the simulated rig, in every row and to the last bit."""

import functools
import itertools
import json
import math
import os
import shutil
import subprocess
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rig
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.control.judging import NUMBERS, measure_signals, recorded_signals
from rig.control.verdict import Kind, decide
from rig.core.errors import DeviceFaultError, RigError
from rig.core.sample import ROW, TRUTH_COLUMNS, Phase, RowFlag
from rig.experiments.hits.hit import left_by
from rig.experiments.trials.judgement import ended_early
from rig.realtime.hand import Wish
from sim_backend.browser import __main__ as browser
from sim_backend.mechanics.driven_hand import DrivenHand
from sim_backend.mechanics.inner import OFFSET
from tests.conformance.tiers import first_by_default

OFFSET_AT = 25 + OFFSET  # in rig_setup
COLUMNS = ("count", "effort_applied", *(column.name for column in TRUTH_COLUMNS))
HITS = 8
# 1000 hits take two minutes of a processor, the first groups 10 s.
GROUPS, FIRST = 125, 10
ENDED = {0: "finished", RowFlag.OUT_OF_WINDOW: "out_of_window", RowFlag.HOMING_FAILED: "homing_failed"}


def built_page(factory: pytest.TempPathFactory) -> Path:
    """Return the directory of the page: HAPTIC_RIG_WALL, where a stage of CI has built it once, or a new one."""
    pytest.importorskip("ziglang", reason="no compiler for WebAssembly: pip install 'haptic-rig[page]'")
    if built := os.environ.get("HAPTIC_RIG_WALL"):
        return Path(built)
    browser.build(place := factory.mktemp("wall"))
    return place


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled rig and its tables, as the page has them."""
    if shutil.which("node") is None:
        pytest.skip("no JavaScript: install nodejs")
    return built_page(tmp_path_factory) / "wall.js"


def run_node(script: str, content: Any, *arguments: Path) -> list[Any]:
    """Return what a script beside this file answers, line by line."""
    command = ["node", Path(__file__).with_name(script), *arguments]
    made = subprocess.run(command, input=json.dumps(content), capture_output=True, text=True, check=True)
    return [json.loads(line) for line in made.stdout.splitlines()]


def random_hit(generator: np.random.Generator) -> dict[str, Any]:
    """Return rig, changes and encoder offset of a hit: any wall and rates of a page."""
    name = str(generator.choice(presets.names()))
    own, rates = presets.load(name), browser.RATES[generator.integers(len(browser.RATES))]
    stiffness, damping = 10.0 ** generator.uniform(-0.7, 0.5), generator.uniform(0.0, 2.0)
    depth = own.wall.side * abs(own.trial.start) * generator.uniform(0.0, 0.5)
    changes = browser.changes_of(own, rates, str(generator.choice(browser.ESTIMATORS)))
    changes["wall.stiffness"] = own.wall.stiffness * float(stiffness)
    changes["wall.damping"] = own.wall.damping * float(damping)
    changes["wall.position"] = own.wall.position + float(depth)
    return {"name": name, "changes": changes, "place": OFFSET_AT, "offset": float(generator.uniform())}


@pytest.mark.parametrize("group", first_by_default(range(GROUPS), FIRST))
def test_a_hit_in_a_page_is_that_of_rig_hit_in_every_row(group: int, data: Path, tmp_path: Path) -> None:
    generator = np.random.default_rng(group)
    hits = [random_hit(generator) for _ in range(HITS)]
    answers = run_node("browser_hits.mjs", hits, data, tmp_path)
    for number, (hit, answer) in enumerate(zip(hits, answers, strict=True)):
        changes = {**hit["changes"], "rig.encoder.offset": hit["offset"]}
        if "refused" in answer:
            with pytest.raises(RigError):
                rig.hit(hit["name"], changes=changes, output=tmp_path)
            continue
        changes["trial.effort"] = answer["effort"]
        try:
            recorded = rig.hit(hit["name"], changes=changes, output=tmp_path).recorded
        except DeviceFaultError as error:
            assert answer["fault"]
            recorded = left_by(error)
        judgement, own = recorded.judgement, recorded.experiment
        assert answer["kind"] == judgement.verdict.kind, hit
        rows, quantum = recorded.recording.rows, presets.load(hit["name"]).rig.amplifier.effort_quantum
        *columns, currents, phases = np.fromfile(tmp_path / str(number)).reshape(len(COLUMNS) + 2, -1)
        # The host's own float64 law, whose phase and effort a recording has, may change it a tick after the device's.
        assert abs(len(rows) - len(phases)) <= 1, hit
        if np.array_equal(phases, rows["phase"]):
            tick_s, limits = 1.0 / own.controller.position_rate, config.verdict_thresholds(own)
            signals = recorded_signals(rows, tick_s, own.rig.encoder.resolution)
            signals = replace(signals, effort=currents[phases == Phase.TRIAL] * quantum)
            numbers = measure_signals(signals, limits).numbers
            for measure, value in answer["numbers"].items():
                found = math.nan if value is None else value
                np.testing.assert_equal(found, numbers[measure], f"{measure}: {hit}")
            early = [] if judgement.early is None else [judgement.early[1]]
            assert answer["reasons"] == [*early, *decide(numbers, limits)[1]], hit
        for name, column in zip(COLUMNS, columns, strict=True):
            scale = quantum if name == "effort_applied" else 1.0
            ticks = min(len(rows), len(column))
            np.testing.assert_array_equal(column[:ticks] * scale, rows[name][:ticks], f"{name}: {hit}")


def test_a_page_decides_as_python_does(data: Path) -> None:
    """JSON has no NaN: a number that is missing is null."""
    limits = config.verdict_thresholds(presets.load("hapkit"))
    (trials,) = run_node("browser_parts.mjs", {"part": "decide", "content": asdict(limits)}, data)
    seen = set()
    for known, kind, reasons in trials:
        numbers = np.zeros(1, NUMBERS)[0]
        for name, value in known.items():
            numbers[name] = math.nan if value is None else value
        assert (kind, tuple(reasons)) == decide(numbers, limits), known
        seen.add(kind)
    assert seen == set(Kind)


def test_a_page_judges_a_run_that_ended_early_as_python_does(data: Path) -> None:
    (runs,) = run_node("browser_parts.mjs", {"part": "endedEarly"}, data)
    assert len(runs) == 4 * (len(Fault) + 2), "touched or not, released or not"
    for run, kind, reason in runs:
        rows = np.zeros(2, ROW)
        rows["phase"] = Phase.TRIAL, Phase.RELEASE if run["released"] else Phase.TRIAL
        rows["penetration"][0] = run["touched"]
        ended = "fault" if run["fault"] else ENDED[run["last"]]
        trailer = {"reason": ended, "fault": {"name": Fault(run["fault"]).name}}
        recording: Any = SimpleNamespace(rows=rows, trailer=trailer, header={"extra": {}})
        assert ended_early(recording) == (kind and (kind, reason)), run


def test_the_hand_of_a_page_reaches_as_far_as_the_simulated_one(data: Path) -> None:
    (ends,) = run_node("browser_parts.mjs", {"part": "ends"}, data)
    changes, wishes = {"trial.kind": "human", "operator.tremor": 0.0}, itertools.count()
    for name, wanted, end in ends:
        model = config.rig_model(config.override(presets.load(name), changes, check_rules=False))
        hand = DrivenHand(model, functools.partial(lambda to: Wish(next(wishes), to, 0.0), wanted))
        hand.begin(presets.load(name).trial.start, 0.01)
        assert [hand.next(0.0) for _ in range(999)][-1].rows[-1, 0] == pytest.approx(end, abs=1e-9), name


def test_a_wall_that_the_device_refuses_leaves_the_one_that_waits(data: Path) -> None:
    assert run_node("browser_parts.mjs", {"part": "refused"}, data) == [[True, True, True]]
