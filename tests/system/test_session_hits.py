"""Hits of a session on the simulated rig: the numbers in its log, and memory that a trial must not keep."""

import gc
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rig.config.presets import load as preset
from rig.core.present import plain
from rig.experiments.hits import hit
from rig.session.engine import _hits as hits
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import SessionLog, read
from tests.conformance.firmware import need_compiler


def test_a_number_that_is_not_finite_is_null_in_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, measured = hit.judge, hits.baseline

    def judged(recording: Any, experiment: Any) -> Any:
        judgement = judge(recording, experiment)
        return replace(judgement, verdict=replace(judgement.verdict, heard=float("nan")))

    def noisy(recording: Any, experiment: Any) -> Any:
        free = measured(recording, experiment)
        assert free is not None
        return replace(free, velocity_rms=float("inf"))

    monkeypatch.setattr(hit, "judge", judged)
    monkeypatch.setattr(hits, "baseline", noisy)
    x = preset("koul-rigid")
    x = replace(x, trial=replace(x.trial, kind="human", baseline_s=0.1, duration_s=1.0))
    (tmp_path / "trials").mkdir()
    runner = DeviceRunner()
    done = runner.hit(x, {}, tmp_path / "trials", "t0001", lambda _: None, 0.0)
    runner.close()
    assert done.hit.numbers["heard"] is None
    assert done.hit.numbers["moved"] >= 0.0
    assert (done.hit.baseline or {})["velocity_rms"] is None
    with SessionLog(tmp_path / "log") as log:
        log.append("trial", **vars(done.hit))
    assert read(tmp_path / "log")[0].content == plain(vars(done.hit))


def test_a_trial_leaves_no_memory_to_the_collector(tmp_path: Path) -> None:
    """A session has hundreds of trials, and garbage collection is irregular: no array may be part of a cycle."""
    need_compiler()
    x = preset("koul-rigid")
    x = replace(x, trial=replace(x.trial, kind="human", duration_s=1.0))
    (tmp_path / "trials").mkdir()
    runner = DeviceRunner()
    runner.hit(x, {}, tmp_path / "trials", "t0001", lambda _: None, 0.0)  # what is made once
    gc.collect()
    gc.disable()
    try:
        runner.hit(x, {}, tmp_path / "trials", "t0002", lambda _: None, 0.0)
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        ours = {
            type(one).__name__
            for one in gc.garbage
            if type(one).__module__.startswith(("rig.", "sim_backend."))
        }
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
    assert not ours
