"""Hits of a session on the simulated rig: the numbers in its log, and memory that a trial must not keep."""

import gc
from dataclasses import replace
from pathlib import Path

from rig.config.presets import load as preset
from rig.session.engine._hits import DeviceRunner
from tests.conformance.firmware import need_compiler


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
