"""Marks: events of input pins and phases, dated on the device's clock and on the host's."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.faults import Input
from rig import config, devices
from rig.cli import rig as command_line
from rig.config import presets
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.core.sample import Phase, RowFlag
from rig.devices.device import DeviceUrl
from rig.devices.framed import FramedDevice
from rig.loop._contradictions import WRAP
from rig.loop._rows import sync_time
from rig.loop.layout import Buffers
from rig.realtime.codec import STATE
from rig.recording._ledger import period_ns_of
from rig.recording.data import Recording
from rig.recording.marks import EDGES_KEY, marks, sync_edges
from rig.recording.reader import open_recording
from sim_backend.ends.link import open_link
from tests.conformance.recording import example_header, example_rows
from tests.conformance.rigs import rotary_rig
from tests.conformance.trials import trial_on

START = -0.015
EDGES_S = (0.02, 0.05, 0.0501001, 0.13)
SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {"trial.duration_s": 0.15, "trial.release_s": 0.003, "homing.settle_s": 0.003, "verdict.tail_s": 0.05},
)
FIXED = config.override(SHORT, {"controller.loop": "device", "controller.estimator": "fdm-butterworth-fixed"})


def recorded(directory: Path, loop: str, clock_ppm: int) -> Recording:
    experiment = SHORT if loop == "host" else FIXED
    edges = ",".join(map(str, EDGES_S))
    url = (
        f"sim://?initial_position={START}&clock_ppm={clock_ppm}&sync={edges}&firmware={int(loop == 'device')}"
    )
    path = directory / "trial.rigcap"
    with FramedDevice(devices.open_link(url, config.rig_model(experiment))) as device:
        trial_on(device, experiment=experiment, recording=path, verified=True, seed=0)
    return open_recording(path.with_suffix(".parquet"))


@pytest.fixture(scope="module", params=["host", "device"])
def trial(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return recorded(tmp_path_factory.mktemp("marks"), request.param, 300)


def loop_of(trial: Recording) -> str:
    return str(trial.header["extra"]["loop"])


def test_sync_edges_are_dated_by_the_device_and_on_the_hosts_clock(trial: Recording) -> None:
    edges = sync_edges(trial)
    # The host loop gets a STATE for each sample. A law on the device sends 200 STATEs a second: of two edges
    # between two of them it reports the last.
    wanted = EDGES_S if loop_of(trial) == "host" else (EDGES_S[0], *EDGES_S[2:])
    assert [edge.device_time for edge in edges] == pytest.approx([t * 1e9 for t in wanted], abs=62.5)
    # The device's clock is fast by 300 ppm and was zero when the host's was; the fit knows it to its uncertainty.
    assert [edge.host_time for edge in edges] == pytest.approx([t * 1e9 / 1.0003 for t in wanted], abs=2_000)
    assert trial.trailer is not None
    assert trial.trailer[EDGES_KEY] == [
        {"device_time": e.device_time, "host_time": e.host_time, "tick": e.tick} for e in edges
    ]
    rows = trial.rows
    late = period_ns_of(trial) if loop_of(trial) == "host" else 5e6
    for edge in edges:
        place = int(np.flatnonzero(rows["tick"] == edge.tick)[0])
        age = int(rows["device_time"][place]) - edge.device_time
        assert 0 <= age <= late, "reported by the first sample behind it"
        assert (rows["sync_time"][:place] < edge.device_time).all()


def test_marks_are_where_phases_and_contacts_begin(trial: Recording) -> None:
    rows, found = trial.rows, marks(trial)
    at = {name: [mark for mark in found if mark.name == name] for name in {mark.name for mark in found}}
    for name in ("homed", "trial", "release", "end"):
        assert len(at[name]) == 1, name
    assert found == sorted(found, key=lambda mark: mark.device_time)
    in_trial = rows["phase"] == Phase.TRIAL
    inside = in_trial & (rows["penetration"] > 0)  # another way than flags
    assert at["trial"][0].tick == rows["tick"][in_trial][0]
    assert at["contact"][0].tick == rows["tick"][inside][0]
    assert len(at["contact"]) == int(np.count_nonzero(np.diff(inside.astype(int), prepend=0) == 1))
    assert at["release"][0].tick == rows["tick"][rows["phase"] == Phase.RELEASE][0]
    assert at["homed"][0].tick < at["trial"][0].tick
    assert at["end"][0].device_time == rows["device_time"][-1]
    for mark in found:
        if mark.name in ("homed", "trial", "contact", "release", "end"):
            row = rows[rows["tick"] == mark.tick][0]
            assert (mark.device_time, mark.host_time) == (row["device_time"], row["sampled_at"])


def test_sync_outputs_follow_trial_and_wall(trial: Recording) -> None:
    rows = trial.rows
    trial_pin, inside_pin = (rows["inputs"] & int(bit) != 0 for bit in (Input.SYNC_TRIAL, Input.SYNC_INSIDE))
    in_trial, inside = rows["phase"] == Phase.TRIAL, rows["flags"] & int(RowFlag.INSIDE) != 0
    if loop_of(trial) == "device":  # as old as the newest STATE, with the pins of the law's own tick
        assert np.count_nonzero(trial_pin) == pytest.approx(np.count_nonzero(in_trial), abs=101)
        assert not [mark for mark in marks(trial) if mark.name.endswith("_out")]
        return
    assert (trial_pin[1:] == in_trial[:-1]).all()
    assert (inside_pin[1:] == inside[:-1]).all()
    assert not trial_pin[0]
    found = marks(trial)
    rose = [mark.device_time for mark in found if mark.name == "trial_out"]
    assert rose == [mark.device_time for mark in found if mark.name == "trial"], (
        "in lock-step there is no delay"
    )


def test_show_lists_the_marks(trial: Recording) -> None:
    path = str(trial.path)
    shown = CliRunner().invoke(command_line, ["show", path, "--marks"])
    assert shown.exit_code == 0, shown.output
    lines = shown.output.partition("\nmarks\n")[2].splitlines()
    assert any(line.split()[:2] == ["trial", "+0.000000"] for line in lines)
    as_json = CliRunner().invoke(command_line, ["show", path, "--marks", "--json"])
    assert json.loads(as_json.stdout)["marks"] == plain(marks(trial))
    assert "marks" not in json.loads(CliRunner().invoke(command_line, ["show", path, "--json"]).stdout)


def made(phase: list[int], inside: list[int], sync_time: list[int], **trailer: object) -> Recording:
    rows = example_rows(len(phase))
    for name in ("inputs", "sync_time", "flags"):
        rows[name] = 0
    rows["tick"] = np.arange(len(phase))
    rows["device_time"] = 1_000_000 * np.arange(1, 1 + len(phase))
    rows["received_at"] = rows["device_time"] + 7
    rows["phase"], rows["flags"], rows["sync_time"] = phase, inside, sync_time
    return Recording(example_header(), rows, dict(trailer))


def test_each_contact_in_the_trial_counts_and_none_outside_it() -> None:
    phases = [1, 1, 2, 3, 3, 3, 3, 3, 3, 4, 4, 5]
    touching = [1, 0, 0, 1, 1, 0, 1, 0, 1, 0, 1, 1]
    found = [(mark.name, mark.tick) for mark in marks(made(phases, touching, [0] * 12))]
    assert found == [
        ("homed", 2), ("trial", 3), ("contact", 3), ("contact", 6), ("contact", 8), ("release", 9), ("end", 11),
    ]  # fmt: skip


def test_edge_in_the_first_row_was_before_the_recording() -> None:
    recording = made([3, 3, 3], [0, 0, 0], [500, 500, 2_500_000])
    assert [(edge.device_time, edge.host_time, edge.tick) for edge in sync_edges(recording)] == [
        (2_500_000, None, 2)
    ]


def test_marks_of_a_recording_and_of_one_without_rows() -> None:
    recording = made([3, 3, 4], [0, 1, 0], [0, 1_500_000, 1_500_000])
    assert [mark.name for mark in marks(recording)] == ["trial", "sync", "contact", "release", "end"]
    assert marks(replace(recording, rows=recording.rows[:0])) == []


def date_edge(progress: np.ndarray, device_time: int, edge: int) -> int:
    state = np.zeros(len(STATE), np.int64)
    state[STATE.sync_time] = edge % WRAP
    progress["device_time"] = device_time
    return int(sync_time(progress, state))


@given(st.integers(1 << 33, 1 << 50), st.integers(-(1 << 24), WRAP - (1 << 24) - 1), st.integers(0, 3 * WRAP))
def test_edge_keeps_its_exact_date_when_the_clock_wraps(now: int, age: int, later: int) -> None:
    progress = Buffers.allocate().progress
    edge = now - age
    wanted = 0 if edge % WRAP == 0 else edge
    assert date_edge(progress, now, edge) == wanted
    assert date_edge(progress, now + later, edge) == wanted, "the clock wraps under it"


@pytest.mark.parametrize("text", ["now", "0.5,", "0", "-1", "2,1", "1,1", "nan", "inf"])
def test_invalid_times_of_edges_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="sync"):
        open_link(DeviceUrl.parse(f"sim://?sync={text}"), rotary_rig())
