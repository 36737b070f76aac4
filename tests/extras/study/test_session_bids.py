"""Exports of a study's raw data: a BIDS-motion dataset that describes the recordings, and CSV that reads back equal."""

import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from rig import config
from rig.cli import rig
from rig.config import presets
from rig.core.errors import ConfigError, RecordingError
from rig.core.sample import Phase, RowFlag
from rig.devices.framed import FramedDevice
from rig.extras.study import read_study
from rig.extras.study.bids import BidsOptions, export_bids, label_of
from rig.extras.study.bids_motion import TYPES, channels, spans
from rig.extras.study.export import Exported, export_trials
from rig.extras.study.study import Study
from rig.recording.reader import open_recording
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.started import LEASH
from tests.conformance.studies import Person, protocol, sitting, without_sync
from tests.conformance.trials import trial_on

QUICK = {
    "controller.position_rate": 2000,
    "controller.velocity_rate": 2000,
    "trial.duration_s": 0.12,
    "trial.release_s": 0.02,
    "homing.settle_s": 0.01,
    "verdict.tail_s": 0.05,
}
CODES = "P[-_]?[0-9]+"
NASTY = "half\tasleep\nand <b>bored</b>"
TAKEN = [
    "HED", "sex", "handedness", "species", "strain", "strain_rrid", "participant_id", "group", "session_id",
]  # fmt: skip
REQUIRED = {"TaskName", "SamplingFrequency"}  # of a motion file's JSON, BIDS 1.10
UNITS = {"s", "rad", "rad/s", "m", "m/s", "N.m", "N", "A"}


def record_hit(directory: Any, preset: Any, **changes: Any) -> Any:
    experiment = config.override(presets.load(preset), {**QUICK, **changes})
    with FramedDevice(MemoryLink(SimulatedDevice(config.rig_model(experiment)))) as device:
        return trial_on(device, experiment, directory / f"{preset}.rigcap").recording


@pytest.fixture(scope="module")
def hit(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return record_hit(tmp_path_factory.mktemp("hit"), "koul-compliant")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory, hit: Any) -> Any:
    """Two people with a practice trial each, one redone and one amended trial, and a questionnaire."""
    where = tmp_path_factory.mktemp("study")
    mapping = protocol(
        study={"code": CODES},
        search={"settings": {"turns": 2, "most": 3}, "step": 100.0},
        order={"repeats": 1},
        practice={"stiffness": [100.0]},
        question=[
            {"name": "age", "text": "How old are you?", "when": "start", "kind": "scale", "highest": 99},
            {"name": "tired", "text": "Tired?", "when": "block", "kind": "scale"},
            *(
                {"name": name, "text": "A name that BIDS has taken", "when": "start", "kind": "scale"}
                for name in TAKEN
            ),
        ],
    )
    person = Person(threshold=lambda condition, damping: 430.0)
    with without_sync():
        for row, code in enumerate(("P01", "P-02")):
            with sitting(where / code, mapping, person, code=code, row=row, recorded=hit) as one:
                one.record("opened", device="bench", simulated=False, serial_number="E661")
                one.run(4)
                one.record("redone", trial=one.state.newest)
                one.run()
                one.record("note", text=NASTY, trial=0)
    return where


@pytest.fixture(scope="module")
def dataset(study: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    out = tmp_path_factory.mktemp("out") / "bids"
    found = export_bids(read_study([study]), out, BidsOptions(authors=("A. Author",), licence="CC0"))
    assert not found.left_out
    return out


def table(path: Any) -> Any:
    """Return head and rows of a tab-separated file; every row is as long as the head."""
    lines = path.read_text(encoding="utf-8").split("\n")
    assert lines.pop() == ""  # it ends with a line end
    head, *rows = (line.split("\t") for line in lines)
    assert all(len(row) == len(head) and "" not in row for row in rows)
    return [dict(zip(head, row, strict=True)) for row in rows]


def runs_of(dataset: Any) -> Any:
    return sorted(dataset.glob("sub-*/motion/*_motion.tsv"))


def test_the_root_says_what_it_is(dataset: Any) -> None:
    described = json.loads((dataset / "dataset_description.json").read_text())
    assert described["Name"] == "A study"
    assert described["DatasetType"] == "raw"
    assert re.fullmatch(r"1\.10\.\d+", described["BIDSVersion"])
    assert (described["Authors"], described["License"]) == (["A. Author"], "CC0")
    assert len((dataset / "README.md").read_text()) > 150  # required by the standard's validator
    people = table(dataset / "participants.tsv")
    assert [row["participant_id"] for row in people] == ["sub-P01", "sub-P02"]
    assert [row["code"] for row in people] == ["P01", "P-02"]
    assert {name for name in TAKEN if people[0].get(name) != "1"} == {"HED", "participant_id"}
    assert people[0]["HED_answer"] == people[0]["participant_id_answer"] == "1"
    assert people[0]["age"] == people[0]["tired_block1"] == "1"
    sidecar = json.loads((dataset / "participants.json").read_text())
    assert set(people[0]) - {"participant_id"} == set(sidecar)


@pytest.mark.exhaustive("::test_the_root_says_what_it_is")
def test_the_official_validator_finds_no_error(dataset: Any, tmp_path: Path) -> None:
    pytest.importorskip("bids_validator_deno", reason="bids-validator-deno is not installed")
    command = "from bids_validator_deno import cli; cli()"
    done = subprocess.run(
        [*LEASH, sys.executable, "-c", command, str(dataset), "--json"],
        env={**os.environ, "DENO_DIR": str(tmp_path), "DENO_NO_UPDATE_CHECK": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    found = json.loads(done.stdout)
    assert [one for one in found["issues"]["issues"] if one["severity"] == "error"] == []
    assert sorted(found["summary"]["subjects"]) == ["P01", "P02"]
    assert done.returncode == 0, done.stderr


def test_a_run_holds_the_recording_and_says_what_each_column_is(dataset: Any, hit: Any) -> None:
    recording = open_recording(hit)
    for path in runs_of(dataset):
        stem = path.name.removesuffix("_motion.tsv")
        described = table(path.with_name(f"{stem}_channels.tsv"))
        values = np.loadtxt(path, delimiter="\t")
        assert values.shape == (len(recording), len(described))
        columns = dict(zip((row["name"] for row in described), values.T, strict=True))
        np.testing.assert_array_equal(columns["angle"], recording.column("position"))
        np.testing.assert_array_equal(columns["angular_velocity"], recording.column("velocity"))
        np.testing.assert_array_equal(columns["effort_applied"], recording.column("effort_applied"))
        np.testing.assert_allclose(columns["latency"], recording.time_s, atol=0.5e-6)
        types = {row["name"]: (row["type"], row["component"], row["units"]) for row in described}
        assert types["angle"] == ("ORNT", "z", "rad")
        assert types["angular_velocity"] == ("GYRO", "z", "rad/s")
        assert types["latency"] == ("LATENCY", "n/a", "s")
        sidecar = json.loads(path.with_name(f"{stem}_motion.json").read_text())
        assert set(sidecar) >= REQUIRED
        assert (sidecar["TaskName"], sidecar["DeviceSerialNumber"]) == ("wallhit", "E661")
        assert sidecar["SamplingFrequency"] == sidecar["SamplingFrequencyEffective"] == 2000.0
        assert sidecar["MotionChannelCount"] == len(described)
        assert [sidecar[f"{kind}ChannelCount"] for kind in TYPES] == [
            sum(row["type"] == kind for row in described) for kind in TYPES
        ]
    first = runs_of(dataset)[0].read_text().splitlines()[0].split("\t")
    assert re.fullmatch(r"\d+\.\d{6}", first[0])  # seconds, as the standard writes latencies


def test_scans_have_the_wall_and_the_verdict_of_each_trial(dataset: Any, study: Any) -> None:
    session = read_study([study]).sessions[0]
    rows = table(dataset / "sub-P01" / "sub-P01_scans.tsv")
    assert len(rows) == len(session.state.trials) == len(list(dataset.glob("sub-P01/motion/*_motion.tsv")))
    for row, trial in zip(rows, session.state.trials, strict=True):
        assert (dataset / "sub-P01" / row["filename"]).is_file()
        assert row["filename"].endswith(f"run-{trial.trial:04d}_motion.tsv")
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z", row["acq_time"])
        assert (float(row["stiffness"]), row["condition"]) == (trial.stiffness, trial.condition)
        assert row["verdict"] == trial.verdict
        assert row["counts"] == str(int(not trial.void and not trial.practice))
    assert [row["void"] for row in rows if row["void"] != "n/a"] == ["redone"]
    assert [row["practice"] for row in rows].count("1") == 1
    sidecar = json.loads((dataset / "sub-P01" / "sub-P01_scans.json").read_text())
    assert sidecar["stiffness"]["Units"] == "N.m/rad"


def test_events_are_in_order_and_lie_in_the_recording(dataset: Any, hit: Any) -> None:
    length = open_recording(hit).time_s[-1]
    levels = json.loads((dataset / "task-wallhit_tracksys-rig_events.json").read_text())["trial_type"][
        "Levels"
    ]
    for path in sorted(dataset.glob("sub-*/motion/*_events.tsv")):
        rows = table(path)
        onsets = [float(row["onset"]) for row in rows]
        assert onsets == sorted(onsets)
        assert 0.0 <= onsets[0] <= onsets[-1] <= length
        kinds = [row["trial_type"] for row in rows]
        assert kinds[:1] == ["homing"]
        assert kinds[-1] == "verdict"
        assert {"settle", "hit", "contact", "release"} < set(kinds) <= set(levels)
        contact, hitting = rows[kinds.index("contact")], rows[kinds.index("hit")]
        assert float(contact["onset"]) >= float(hitting["onset"])
        assert rows[-1]["verdict"] in {"stable", "buzz", "unstable"}
        assert float(rows[-1]["response_time"]) > 0.0


def test_spans_are_those_of_the_rows(hit: Any) -> None:
    recording = open_recording(hit)
    rows = recording.rows[:12].copy()
    rows["phase"] = (
        [Phase.HOMING] * 3 + [Phase.SETTLE] * 2 + [Phase.FREE] * 2 + [Phase.TRIAL] * 4 + [Phase.RELEASE]
    )
    rows["flags"] = [0] * 7 + [int(RowFlag.INSIDE)] * 2 + [0, int(RowFlag.INSIDE), 0]
    rows["device_time"] = 500_000 * np.arange(12) + 7
    rows["inputs"], rows["sync_time"] = 0, [0] * 4 + [500_000 * 3 + 107] * 8
    found = spans(replace(recording, rows=rows))
    assert [(kind, round(1e3 * onset, 6), round(1e3 * duration, 6)) for kind, onset, duration in found] == [
        ("homing", 0.0, 1.5),
        ("settle", 1.5, 1.0),
        ("sync", 1.5001, 0.0),
        ("baseline", 2.5, 1.0),
        ("hit", 3.5, 2.0),
        ("contact", 3.5, 1.0),
        ("release", 5.5, 0.5),
    ]


@pytest.mark.parametrize("motion", ["rotary", "linear"])
def test_channels_have_types_components_and_units_of_the_standard(motion: str) -> None:
    found = channels(motion, "foaw")
    types = {channel.type for channel in found}
    assert types == (
        {"LATENCY", "ORNT", "GYRO", "MISC"} if motion == "rotary" else {"LATENCY", "POS", "VEL", "MISC"}
    )
    for channel in found:
        assert channel.unit in UNITS
        assert (channel.component == "n/a") == (channel.type in {"LATENCY", "MISC"})
        assert list(channel.as_row())[:5] == ["name", "component", "type", "tracked_point", "units"]


def test_less_can_be_kept_and_dates_can_be_moved(study: Any, tmp_path: Path, hit: Any) -> None:
    export_bids(read_study([study / "P01"]), tmp_path / "bids", BidsOptions(every=3, shift_dates=True))
    path = runs_of(tmp_path / "bids")[0]
    kept = np.loadtxt(path, delimiter="\t")
    np.testing.assert_array_equal(kept[:, 1], open_recording(hit).column("position")[::3])
    sidecar = json.loads(path.with_name(path.name.replace("_motion.tsv", "_motion.json")).read_text())
    assert (sidecar["SamplingFrequency"], sidecar["Decimation"]) == (2000.0 / 3, 3)
    dates = [row["acq_time"] for row in table(tmp_path / "bids" / "sub-P01" / "sub-P01_scans.tsv")]
    assert all(date.startswith("1925-01-01T") for date in dates)


def test_missing_and_changed_recordings_are_left_out_and_listed(hit: Any, tmp_path: Path) -> None:
    person = Person(threshold=lambda condition, damping: 430.0)
    mapping = protocol(search={"settings": {"turns": 2, "most": 4}, "step": 100.0}, order={"repeats": 1})
    with without_sync(), sitting(tmp_path / "P01", mapping, person, recorded=hit) as one:
        one.run(4)
    (tmp_path / "P01/trials/t0001.parquet").unlink()
    (tmp_path / "P01/trials/t0002.parquet").write_bytes(b"something else")
    study = read_study([tmp_path])
    for export, out in ((export_bids, tmp_path / "bids"), (to_csv, tmp_path / "csv")):
        found = export(study, out)
        assert found.recordings == 2
        assert found.left_out == (
            "P01, trial 1: its recording is missing",
            "P01, trial 2: its recording is changed",
        )
        with pytest.raises(RecordingError, match="exists"):
            export(study, out)
    (tmp_path / "P01/trials/t0003.parquet").write_bytes(b"no recording")
    careless = read_study([tmp_path], hashes=False)
    with pytest.raises(RecordingError):
        export_bids(careless, tmp_path / "other")
    assert not [path for path in tmp_path.iterdir() if "other" in path.name]  # nothing half done


def to_csv(study: Study, directory: Path) -> Exported:
    return export_trials(study, directory, "csv")


@pytest.mark.parametrize(
    ("export", "codes"), [(export_bids, ("P-1", "P_1")), (to_csv, ("P!1", "P?1")), (to_csv, ("P1", "p1"))]
)
def test_codes_that_an_export_cannot_tell_apart_are_refused(
    export: Callable[[Study, Path], Any], codes: tuple[str, str], tmp_path: Path
) -> None:
    """Case is not a difference, because a directory may be copied to a case-insensitive file system."""
    person = Person(threshold=lambda condition, damping: 430.0)
    mapping = protocol(study={"code": "[Pp].?1|P2"})
    with without_sync():
        for row, code in enumerate((*codes, "P2")):
            with sitting(tmp_path / str(row), mapping, person, code=code, row=row) as one:
                one.run(1)
    with pytest.raises(ConfigError, match=f"{re.escape(', '.join(codes))};") as refused:
        export(read_study([tmp_path]), tmp_path / "out")
    assert "P2" not in refused.value.message
    assert not (tmp_path / "out").exists()


def test_a_code_without_letters_or_digits_has_no_label_in_bids() -> None:
    with pytest.raises(ConfigError, match="is not possible in BIDS"):
        label_of("-_")


def test_csv_reads_back_equal_and_a_table_says_what_each_file_is(
    study: Any, tmp_path: Path, hit: Any
) -> None:
    export_trials(read_study([study]), tmp_path / "csv", "csv")
    with open(tmp_path / "csv/trials.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["participant"] for row in rows} == {"P01", "P-02"}
    with open(tmp_path / "csv" / rows[0]["file"], newline="", encoding="utf-8") as file:
        positions = [float(row["position"]) for row in csv.DictReader(file)]
    assert positions == open_recording(hit).column("position").tolist()
    with open(tmp_path / "csv/columns.csv", newline="", encoding="utf-8") as file:
        meanings = {row["column"]: row["unit"] for row in csv.DictReader(file)}
    assert meanings["stiffness"] == "N·m/rad"
    assert set(rows[0]) - {"participant", "file"} == set(meanings)


def test_the_command_says_what_it_wrote(study: Any, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        rig, ["session", "export", str(study / "P01"), "--bids", str(tmp_path / "bids"), "--json"]
    )
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["bids"]["recordings"] == len(runs_of(tmp_path / "bids"))
    nothing = CliRunner().invoke(rig, ["session", "export", str(study)])
    assert isinstance(nothing.exception, ConfigError)
