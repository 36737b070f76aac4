"""Exports: read back with the tools that they are made for; an existing file is never overwritten."""

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rig.core.errors import RecordingError
from rig.core.sample import Phase
from rig.recording._mcap import ROWS
from rig.recording.data import Recording
from rig.recording.export import EXPORTERS, export, sidecar_of
from rig.recording.reader import open_recording
from rig.recording.seal import with_truth
from tests.conformance.recording import example_header, example_rows, example_truth


@pytest.fixture
def recording() -> Recording:
    rows = example_rows(25)
    rows["sample_index"] = np.arange(len(rows))
    plain = Recording(example_header(), rows, {"reason": "finished"})
    return with_truth(plain, example_truth(rows["sample_index"]))


def test_csv_has_its_meaning_beside_it(tmp_path: Path, recording: Recording) -> None:
    path = export(recording, tmp_path / "trial.csv")
    sidecar = json.loads(sidecar_of(path).read_text("utf-8"))
    assert sidecar["units"] == recording.units
    assert sidecar["descriptions"] == recording.descriptions
    assert sidecar["header"] == recording.header
    assert sidecar["trailer"] == {"reason": "finished"}


def test_long_csv_is_written_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.recording.export._ROWS_AT_ONCE", 100)
    rows = example_rows(301)
    path = export(Recording(example_header(), rows), tmp_path / "trial.csv")
    frame = pd.read_csv(path, usecols=["count", "device_time"])
    assert frame["count"].tolist() == rows["count"].tolist()
    assert frame["device_time"].tolist() == rows["device_time"].tolist()


def test_xy_is_force_over_penetration_in_the_trial(tmp_path: Path, recording: Recording) -> None:
    recording.rows["phase"][:] = Phase.SETTLE
    recording.rows["phase"][3:7] = Phase.TRIAL
    path = export(recording, tmp_path / "trial.xy")
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    units = recording.units
    assert head == f"penetration ({units['penetration']}),effort_wall ({units['effort_wall']})"
    read = [[float(cell) for cell in line.split(",")] for line in lines]
    trial = recording.rows[3:7]
    np.testing.assert_array_equal(read, np.column_stack([trial["penetration"], trial["effort_wall"]]))


def test_mcap_has_every_row_at_its_time_and_describes_itself(tmp_path: Path, recording: Recording) -> None:
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed (pip install mcap)")
    rows = recording.rows
    rows["device_time"] = 1000 + 50_000 * np.arange(len(rows))
    rows["velocity"][2] = np.nan
    path = export(recording, tmp_path / "trial.mcap")
    with path.open("rb") as file:
        read = reader.make_reader(file)
        found = [message for _, channel, message in read.iter_messages() if channel.topic == ROWS]
        (metadata,) = list(read.iter_metadata())
        schemas = {schema.name: json.loads(schema.data) for schema in read.get_summary().schemas.values()}
    assert len(found) == len(rows)
    assert np.diff([message.log_time for message in found]).tolist() == [50_000] * (len(rows) - 1)
    began = datetime.fromisoformat(recording.header["created"]).timestamp()
    assert found[0].log_time == pytest.approx(began * 1e9, abs=1e6)
    content = [json.loads(message.data) for message in found]
    assert [row["count"] for row in content] == rows["count"].tolist()
    sent = np.array([row["effort_sent"] for row in content], dtype=np.float64)
    np.testing.assert_array_equal(sent, rows["effort_sent"])
    assert content[2]["velocity"] is None
    assert schemas["rig.rows"]["properties"]["velocity"]["unit"] == recording.units["velocity"]
    assert json.loads(metadata.metadata["header"]) == recording.header


@pytest.mark.parametrize("name", EXPORTERS)
def test_files_are_replaced_only_when_asked(tmp_path: Path, recording: Recording, name: str) -> None:
    if name == "mcap":
        pytest.importorskip("mcap", reason="mcap is not installed (pip install mcap)")
    path = tmp_path / f"trial.{name}"
    path.write_text("precious")
    with pytest.raises(RecordingError, match="File exists"):
        export(recording, path)
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]
    export(recording, path, overwrite=True)
    assert path.read_bytes() != b"precious"


def test_a_sidecar_in_the_way_stops_the_csv(tmp_path: Path, recording: Recording) -> None:
    path = tmp_path / "trial.csv"
    sidecar_of(path).write_text("precious")
    with pytest.raises(RecordingError, match="File exists"):
        export(recording, path)
    assert list(tmp_path.iterdir()) == [sidecar_of(path)]


def test_the_format_may_differ_from_the_suffix(tmp_path: Path, recording: Recording) -> None:
    path = export(recording, tmp_path / "trial.dat", "parquet")
    assert open_recording(path).rows.tobytes() == recording.rows.tobytes()
    export(path, tmp_path / "trial.csv")
    assert (tmp_path / "trial.csv").read_text().startswith("tick,sample_index,")


def test_impossible_exports_are_one_clear_line(tmp_path: Path, recording: Recording) -> None:
    with pytest.raises(
        RecordingError, match=r"unknown export format 'xlsx'; the formats are csv, xy, parquet, mat, mcap"
    ):
        export(recording, tmp_path / "trial.xlsx")
    with pytest.raises(RecordingError, match="make the directory first"):
        export(recording, tmp_path / "absent" / "trial.csv")
    with pytest.raises(RecordingError, match="Is a directory"):
        export(recording, tmp_path, "csv", overwrite=True)
    with pytest.raises(RecordingError, match="No such file"):
        export(tmp_path / "absent.rigcap", tmp_path / "trial.csv")
    assert list(tmp_path.iterdir()) == []
