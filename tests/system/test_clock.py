"""From a simulated clock that drifts to what a recording says of time: the truth is known at every step."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig.cli
from rig import config
from rig.config import presets
from rig.core.clock_fit import ClockFit, as_exchanges, fit_clock
from rig.core.present import plain
from rig.devices.framed import FramedDevice
from rig.recording._capture import write_capture
from rig.recording.reader import open_recording
from rig.recording.timing_report import timing
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.rigs import rotary_rig
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


class Slow:
    """A link on which both ways take time, at least so long and exponentially longer: virtual time that passes."""

    def __init__(self, link: Any, *, out_ns: Any, back_ns: Any, jitter_ns: Any, seed: int = 0) -> None:
        self.link, self.url, self.clock = link, link.url, link.clock
        self.bytes_per_second = None
        self._ways, self._jitter, self._rng = (out_ns, back_ns), jitter_ns, np.random.default_rng(seed)

    def _pass(self, way: Any) -> None:
        wait = self._ways[way] + round(self._rng.exponential(1.0) * self._jitter[way])
        self.clock.sleep_until(self.clock.now_ns() + wait)

    def write(self, data: Any) -> None:
        self._pass(0)
        self.link.write(data)

    def read(self, timeout_s: Any) -> Any:
        data = self.link.read(timeout_s)
        if data:
            self._pass(1)
        return data

    def close(self) -> None:
        self.link.close()


def up_for(ticks: Any) -> Any:
    simulated = SimulatedDevice(rotary_rig(), position_rate_default=1000)
    for _ in range(ticks):
        simulated.tick()
    return simulated


@pytest.mark.parametrize("ppm", first_by_default([200.0, -37.5, -200.0, 0.0, 50.0], 2))
@pytest.mark.parametrize(
    "delays",
    [
        {"out_ns": 20_000, "back_ns": 20_000, "jitter_ns": (0.0, 0.0)},
        {"out_ns": 15_000, "back_ns": 95_000, "jitter_ns": (10_000.0, 40_000.0)},
        {"out_ns": 90_000, "back_ns": 5_000, "jitter_ns": (30_000.0, 0.0)},
    ],
    ids=["quiet", "asymmetric", "out-waits"],
)
def test_exchanges_over_a_link_find_offset_and_drift(ppm: float, delays: Any) -> None:
    """Within what the fit says of itself; before, during and after the exchanges."""
    simulated = up_for(777)
    link = Slow(MemoryLink(simulated, clock_ppm=ppm), **delays, seed=int(ppm) + 500)
    start_ns = simulated.elapsed_ns
    fit = FramedDevice(link).clock(40, over_s=4.0)
    device_ns = start_ns + np.array([0, 2 * 10**9, 4 * 10**9])
    truth_ns = (device_ns - start_ns) / (1.0 + ppm * 1e-6)
    errors = np.abs(fit.host_of(device_ns) - truth_ns)
    assert (errors <= 3.0 * fit.sd_of(device_ns) + fit.asymmetry_bound_ns).all()
    assert abs(fit.drift_ppm - (1.0 / (1.0 + ppm * 1e-6) - 1.0) * 1e6) <= 3.0 * fit.drift_sd_ppm
    assert fit.drift_sd_ppm < 10.0, "and it says something"
    least = delays["out_ns"] + delays["back_ns"]
    assert 0.5 * least <= fit.asymmetry_bound_ns <= 0.5 * least + 25_000


def hit(
    directory: Any, ppm: Any, *, sealed: bool = True, ticks_before: int = 0, experiment: Any = HIT
) -> Any:
    simulated = SimulatedDevice(config.rig_model(experiment))
    for _ in range(ticks_before):
        simulated.tick()
    with FramedDevice(MemoryLink(simulated, clock_ppm=ppm)) as device:
        return trial_on(device, experiment, directory / "hit.rigcap", sealed=sealed).recording


@pytest.mark.parametrize("ppm", [0.0, 120.0, -120.0])
def test_a_recording_knows_both_clocks(tmp_path: Path, ppm: float) -> None:
    """In lock-step a sample is received when it is taken, and answered at once: the ledger must find that again."""
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


def test_a_host_that_keeps_its_own_beat_sees_samples_wait_for_it(tmp_path: Path) -> None:
    """Answers wait for the beat too, one way only: the exchanges at rest, before and after, keep the clocks right."""
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


def test_equal_seeds_still_give_equal_bits(tmp_path: Path) -> None:
    files = []
    for number in range(2):
        (tmp_path / str(number)).mkdir()
        files.append(open_recording(hit(tmp_path / str(number), 75.0)))
    first, second = files
    assert first.rows.tobytes() == second.rows.tobytes()
    assert first.trailer["timing"] == second.trailer["timing"]


# ---------------------------------------------------------------------- rig recording timing


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return hit(tmp_path_factory.mktemp("sealed"), 50.0)


@pytest.fixture
def command(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)

    def call(*arguments: Any) -> Any:
        code = rig.cli.run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return call


def test_timing_as_json_is_what_the_trailer_has(command: Any, sealed: Any, tmp_path: Path) -> None:
    code, out, _ = command("recording", "timing", sealed, "--json", "--no-plot")
    assert code == 0
    facts = json.loads(out)
    assert facts.pop("picture") is None
    assert facts == open_recording(sealed).trailer["timing"]
    assert not list(tmp_path.iterdir())


def test_a_capture_and_what_is_sealed_from_it_say_the_same(tmp_path: Path) -> None:
    capture = hit(tmp_path, 50.0, sealed=False)
    assert capture.suffix == ".rigcap"
    before = timing(capture)
    (tmp_path / "sealed").mkdir()
    assert plain(timing(hit(tmp_path / "sealed", 50.0))) == plain(before)


def changed(sealed: Any, path: Any, **changes: Any) -> Any:
    recording = dataclasses.replace(open_recording(sealed), **changes)
    with open(path, "wb") as file:
        write_capture(file, recording)
    return path


def test_a_run_cut_off_has_the_hosts_share_alone(command: Any, sealed: Any, tmp_path: Path) -> None:
    """Its process was killed: no trailer, no clock."""
    path = changed(sealed, tmp_path / "cut.rigcap", trailer=None, complete=False)
    code, out, _ = command("recording", "timing", path)
    assert code == 0
    assert "unknown" in out
    assert "no clock exchanges" in out
    assert (tmp_path / "cut-timing.png").exists()
    assert timing(path).stages["law"].ticks > 100


def test_a_picture_does_not_overwrite_the_recording(command: Any, sealed: Any) -> None:
    content = sealed.read_bytes()
    code, out, err = command("recording", "timing", sealed, "-o", sealed)
    assert (code, "counted apart" in out) == (9, True)
    assert "does not end in a format" in err
    assert sealed.read_bytes() == content


def test_recordings_without_a_ledger_are_refused_in_one_line(
    command: Any, sealed: Any, tmp_path: Path
) -> None:
    recording = open_recording(sealed)
    names = [name for name in recording.names if name not in ("command_active", *recording.names[-5:])]
    columns = [c for c in recording.header["schema"]["columns"] if c["name"] in names]
    offset = 0
    for number, column in enumerate(columns):
        columns[number] = {**column, "offset": offset}
        offset += 8
    rows = np.zeros(len(recording), [(name, recording.rows.dtype[name]) for name in names])
    header = {**recording.header, "schema": {"row_bytes": offset, "columns": columns}}
    old = changed(sealed, tmp_path / "old.rigcap", rows=rows, header=header)
    code, out, err = command("recording", "timing", old)
    assert (code, out) == (9, "")
    assert "no column 'command_active'" in err
    empty = changed(sealed, tmp_path / "empty.rigcap", rows=recording.rows[:0])
    code, _, err = command("recording", "timing", empty)
    assert code == 9
    assert "no rows" in err
    broken = changed(sealed, tmp_path / "broken.rigcap", trailer={"clock": {"drift_ppm": 1.0}})
    code, _, err = command("recording", "timing", broken)
    assert code == 9
    assert "clock" in err
    assert command("recording", "timing", tmp_path / "nothere.parquet")[0] == 9


def test_devices_says_how_the_clocks_stand(command: Any) -> None:
    _, out, _ = command("device", "show", "sim://koul-compliant?clock_ppm=50", "--json")
    clock = ClockFit.from_mapping(json.loads(out)["clock"])
    assert clock.drift_ppm == pytest.approx(-50.0, abs=3 * clock.drift_sd_ppm)
