"""Device clocks that drift: the clock fit and the times in a recording agree with the simulated clock."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import presets
from rig.core.clock_fit import ClockFit, as_exchanges, fit_clock
from rig.devices.framed import FramedDevice
from rig.recording._capture import write_capture
from rig.recording.reader import open_recording
from rig.recording.timing_report import timing
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

HIT = config.override(
    presets.load("koul-compliant"),
    {
        "controller.position_rate": 5_000,
        "controller.velocity_rate": 1_000,
        "trial.duration_s": 0.3,
        "trial.release_s": 0.02,
        "homing.settle_s": 0.01,
        "verdict.tail_s": 0.1,
    },
)


def hit(
    directory: Any, ppm: Any, *, sealed: bool = True, ticks_before: int = 0, experiment: Any = HIT
) -> Any:
    simulated = SimulatedDevice(config.rig_model(experiment))
    for _ in range(ticks_before):
        simulated.tick()
    with FramedDevice(MemoryLink(simulated, clock_ppm=ppm)) as device:
        return trial_on(device, experiment, directory / "hit.rigcap", sealed=sealed).recording


@pytest.mark.parametrize("ppm", first_by_default([0.0, 120.0, -120.0]))
def test_a_recording_has_both_clocks(tmp_path: Path, ppm: float) -> None:
    """In lock-step, samples arrive and are answered without delay, and the recorded times must show that."""
    recording = open_recording(hit(tmp_path, ppm, ticks_before=1000))
    fit = ClockFit.from_mapping(recording.trailer["clock"])
    assert fit.used >= 3
    assert abs(fit.drift_ppm + ppm) <= 3.0 * fit.drift_sd_ppm + 0.02
    assert fit == fit_clock(as_exchanges(recording.trailer["exchanges"]))
    allowed = 3.0 * fit.sd_of(recording.rows["device_time"]) + 63
    assert (np.abs(recording.rows["sampled_at"] - recording.rows["received_at"]) <= allowed).all()
    applied, sent = recording.rows["applied_at"], recording.rows["sent_at"]
    seen = applied != 0
    assert seen[:-1].all()
    assert (np.abs(applied - sent)[seen] <= allowed[seen]).all()
    whole = recording.trailer["timing"]["stages"]["whole"]
    assert whole["ticks"] == len(recording) - 1
    assert max(abs(whole["minimum"]), whole["maximum"]) <= 2 * allowed.max()


def test_samples_wait_for_a_host_with_its_own_period(tmp_path: Path) -> None:
    """A host with its own period delays replies one way only; clock exchanges at rest keep the fit unbiased."""
    experiment = config.override(HIT, {"host.pacing": "host"})
    recording = open_recording(hit(tmp_path, 80.0, experiment=experiment))
    fit = ClockFit.from_mapping(recording.trailer["clock"])
    assert fit.drift_ppm == pytest.approx(-80.0, abs=3.0 * fit.drift_sd_ppm + 0.01)
    assert fit.drift_sd_ppm < 1.0
    waited = recording.rows["sampled_at"] - recording.rows["received_at"]
    period_ns = 1e9 / experiment.controller.position_rate
    allowed = 3.0 * fit.sd_of(recording.rows["device_time"]) + 63
    assert (waited <= allowed).all()
    assert (-waited <= period_ns + allowed).all()


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return hit(tmp_path_factory.mktemp("sealed"), 50.0)


def change(sealed: Any, path: Any, **changes: Any) -> Any:
    recording = dataclasses.replace(open_recording(sealed), **changes)
    with open(path, "wb") as file:
        write_capture(file, recording)
    return path


def test_a_run_cut_off_has_the_hosts_share_alone(run: Any, sealed: Any, tmp_path: Path) -> None:
    path = change(sealed, tmp_path / "cut.rigcap", trailer=None, complete=False)
    code, out, _ = run("recording", "timing", path)
    assert code == 0
    assert "unknown" in out
    assert "no clock exchanges" in out
    assert (tmp_path / "cut-timing.png").exists()
    assert timing(path).stages["law"].ticks > 100


def test_a_picture_does_not_overwrite_the_recording(run: Any, sealed: Any) -> None:
    content = sealed.read_bytes()
    code, out, err = run("recording", "timing", sealed, "-o", sealed)
    assert (code, "counted apart" in out) == (9, True)
    assert "does not end in a format" in err
    assert sealed.read_bytes() == content


def test_a_recording_without_rows_or_clock_is_refused(run: Any, sealed: Any, tmp_path: Path) -> None:
    empty = change(sealed, tmp_path / "empty.rigcap", rows=open_recording(sealed).rows[:0])
    broken = change(sealed, tmp_path / "broken.rigcap", trailer={"clock": {"drift_ppm": 1.0}})
    for path, words in ((empty, "no rows"), (broken, "clock")):
        code, _, err = run("recording", "timing", path)
        assert (code, words in err) == (9, True)


def test_device_show_fits_the_clocks(run: Any) -> None:
    clock = json.loads(run("device", "show", "sim://koul-compliant?clock_ppm=50", "--json")[1])["clock"]
    assert clock["drift_ppm"] == pytest.approx(-50.0, abs=3 * clock["drift_sd_ppm"])
    assert clock["drift_sd_ppm"] < 5.0
