"""Sealing a recording: the capture is removed only after an equal sealed file has replaced it."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from rig.core import deferred
from rig.core.clock_fit import ClockFit
from rig.core.errors import RecordingError
from rig.core.present import plain
from rig.core.sample import COLUMNS, TRUTH_COLUMNS
from rig.recording import seal as seal_module
from rig.recording._capture import write_capture
from rig.recording._parquet import write_parquet
from rig.recording.data import Recording
from rig.recording.export import export
from rig.recording.reader import open_recording
from rig.recording.seal import seal
from rig.recording.timing import NO_AGE
from tests.conformance.recording import example_header, example_rows, example_truth

CLOCK = ClockFit(10_000, 5_000_000, -40.0, 12.5, 0.25, 900, 1_800, 0.1, 7.0, 10**9, 20, 2)


@pytest.fixture
def recording() -> Recording:
    rows = example_rows(50)
    rows["sample_index"] = 100 + 2 * np.arange(50)
    return Recording(example_header(), rows, {"reason": "finished", "recorder": {"rows": 50}})


@pytest.fixture
def capture(tmp_path: Path, recording: Recording) -> Path:
    return write(tmp_path / "trial.rigcap", recording)


def write(path: Path, recording: Recording) -> Path:
    with open(path, "wb") as file:
        write_capture(file, recording, block_rows=20)
    return path


def sealed_file(capture: Path, *given: Any, **options: Any) -> Path:
    """Seal a capture, check that the returned recording equals its file, and return the path."""
    sealed = seal(open_recording(capture), *given, **options)
    assert sealed.path is not None
    again = open_recording(sealed.path)
    assert (again.header, again.trailer, again.lost) == (sealed.header, sealed.trailer, sealed.lost)
    assert again.rows.tobytes() == sealed.rows.tobytes()
    return sealed.path


def test_sealing_replaces_the_capture_by_an_equal_file(capture: Path, recording: Recording) -> None:
    sealed = sealed_file(capture)
    assert sealed == capture.with_suffix(".parquet")
    assert list(sealed.parent.iterdir()) == [sealed]
    found = open_recording(sealed)
    assert found.rows.dtype == recording.rows.dtype
    assert found.rows.tobytes() == recording.rows.tobytes()
    assert (found.header, found.trailer, found.complete) == (recording.header, recording.trailer, True)


def test_a_sealed_recording_is_not_sealed_once_more_and_lost(capture: Path) -> None:
    sealed = sealed_file(capture)
    content = sealed.read_bytes()
    with pytest.raises(RecordingError, match="is not a capture"):
        sealed_file(sealed)
    assert sealed.read_bytes() == content


def timed(**trailer: Any) -> Recording:
    """Return fifty ticks of a millisecond in which each command became active with the next sample."""
    rows = example_rows(50)
    number = np.arange(50)
    rows["tick"], rows["sample_index"], rows["elapsed_ticks"], rows["flags"] = number, 100 + number, 1, 0
    rows["device_time"] = 10_000 + number * 1_000_000
    rows["received_at"] = rows["device_time"] + 5_080_000
    rows["computed_at"], rows["sent_at"] = rows["received_at"] + 2_000, rows["received_at"] + 9_000
    rows["lateness"] = rows["sampled_at"] = rows["applied_at"] = 0
    rows["command_sequence"], rows["command_active"] = number, np.maximum(number - 2, 0)
    rows["command_age"] = np.where(number < 2, NO_AGE, 1)
    trailer = {"reason": "finished", "counters": {"late": 3, "stale": 1}, **trailer}
    return Recording(example_header(experiment={"controller": {"position_rate": 1000}}), rows, trailer)


def test_the_ledger_is_filled_in_where_clocks_were_compared(tmp_path: Path) -> None:
    recording = timed(clock=plain(CLOCK))
    found = open_recording(sealed_file(write(tmp_path / "trial.rigcap", recording)))
    device = recording.rows["device_time"]
    assert found.column("sampled_at").tolist() == CLOCK.host_of(device).tolist()
    assert found.column("applied_at").tolist() == [*CLOCK.host_of(device[1:-1]).tolist(), 0, 0]
    for name in recording.names:
        if name not in ("sampled_at", "applied_at"):
            assert found.column(name).tobytes() == recording.column(name).tobytes()
    assert found.trailer is not None
    timing = found.trailer["timing"]
    assert timing["stages"]["law"]["quantiles"]["p50"]["value"] == 2_000
    assert timing["stages"]["transport_in"]["maximum"] == pytest.approx(80_000, abs=2_100)
    assert (timing["counts"]["late"], timing["counts"]["stale"], timing["counts"]["lost"]) == (3, 1, None)
    assert timing["clock"] == plain(CLOCK)
    assert found.trailer["clock"] == plain(CLOCK)


def test_a_ledger_sealed_twice_or_after_a_crash_is_the_same(tmp_path: Path) -> None:
    recording = timed(clock=plain(CLOCK))
    files = [sealed_file(write(tmp_path / f"{run}.rigcap", recording), keep_capture=True) for run in range(2)]
    before = files[0].read_bytes()
    assert files[1].read_bytes() == before
    assert sealed_file(tmp_path / "0.rigcap").read_bytes() == before


def test_without_a_clock_rows_stay_and_the_hosts_share_is_known(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = []
    for number, clock in enumerate(({}, {"clock": None}, {"clock": {"drift_ppm": "much"}})):
        recording = timed(**clock)
        found.append(open_recording(sealed_file(write(tmp_path / f"{number}.rigcap", recording))))
        assert found[-1].rows.tobytes() == recording.rows.tobytes()
    absent, incomparable, _ = found
    assert absent.trailer == timed().trailer
    assert incomparable.trailer is not None
    stages = incomparable.trailer["timing"]["stages"]
    assert stages["send"]["maximum"] == 7_000
    assert stages["transport_in"] is stages["whole"] is None
    assert "the latency ledger stays empty" in caplog.text  # after the invalid one


def test_other_programs_find_units_in_the_fields(capture: Path) -> None:
    """pyarrow alone reads unit and meaning of each field, and header and trailer as JSON metadata."""
    file = parquet.ParquetFile(sealed_file(capture))
    for field, column in zip(file.schema_arrow, COLUMNS, strict=True):
        assert field.name == column.name
        assert field.metadata[b"description"].decode() == column.description
    assert file.schema_arrow.field("effort_wall").metadata[b"unit"].decode() == "N·m"
    assert json.loads(file.metadata.metadata[b"rig.header"])["seed"] == 7
    assert json.loads(file.metadata.metadata[b"rig.trailer"])["reason"] == "finished"
    column = file.metadata.row_group(0).column(8)
    assert (column.path_in_schema, column.compression) == ("position", "ZSTD")
    assert "BYTE_STREAM_SPLIT" in column.encodings


def test_truth_is_joined_by_sample_index(capture: Path, recording: Recording) -> None:
    """Truth rows may be in any order or missing on either side; of two for a sample the later one counts."""
    index = recording.rows["sample_index"]
    truth = example_truth(np.concatenate([[index[3]], index[40:9:-1] + 1, index[40:9:-1], [7, 999]]))
    truth["position_true"][0] = -1.0
    again = example_truth(index[3:4])
    found = open_recording(sealed_file(capture, np.concatenate([truth, again])))
    assert found.has_truth
    known = np.isin(np.arange(50), [3, *range(10, 41)])
    for number, column in enumerate(TRUTH_COLUMNS):
        values = found.column(column.name)
        assert np.isnan(values[~known]).all()
        assert (values[known] == index[known] + number / 8).all()
        assert found.descriptions[column.name] == column.description
    assert found.units["velocity_true"] == "rad/s"
    for name in recording.names:
        assert found.column(name).tobytes() == recording.column(name).tobytes()


def test_a_capture_cut_off_is_sealed_with_its_losses(capture: Path) -> None:
    capture.write_bytes(capture.read_bytes()[:-3000])
    before = open_recording(capture)
    found = open_recording(sealed_file(capture))
    assert before.lost
    assert (found.lost, found.complete, found.trailer) == (before.lost, False, None)
    assert found.rows.tobytes() == before.rows.tobytes()


def test_sealing_again_after_a_crash_finishes(capture: Path, recording: Recording) -> None:
    """Both files exist if the process died between the two steps."""
    truth = example_truth(recording.rows["sample_index"])
    sealed = sealed_file(capture, truth, keep_capture=True)
    before = sealed.read_bytes()
    assert sealed_file(capture) == sealed
    assert not capture.exists()
    assert sealed.read_bytes() == before


def test_another_recording_of_that_name_stays(tmp_path: Path, capture: Path, recording: Recording) -> None:
    other = Recording(recording.header, example_rows(50, seed=9), recording.trailer)
    sealed = sealed_file(write(tmp_path / "other.rigcap", other)).rename(capture.with_suffix(".parquet"))
    with pytest.raises(RecordingError, match=r"differs from .*rigcap"):
        sealed_file(capture)
    assert capture.exists()
    assert open_recording(sealed).rows.tobytes() == other.rows.tobytes()


def test_a_write_that_fails_leaves_the_capture_alone(capture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(file: Any, recording: Recording) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(seal_module, "write_parquet", fail)
    with pytest.raises(
        RecordingError, match=r"cannot write .*\.parquet: No space left on device; free some space"
    ):
        sealed_file(capture)
    assert list(capture.parent.iterdir()) == [capture]


def test_file_that_reads_back_wrong_never_replaces_the_capture(
    capture: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(file: Any, recording: Recording) -> None:
        recording.rows["count"][7] += 1
        write_parquet(file, Recording(recording.header, recording.rows.copy(), recording.trailer))
        recording.rows["count"][7] -= 1

    monkeypatch.setattr(seal_module, "write_parquet", wrong)
    with pytest.raises(RecordingError, match=r"differs from .*rigcap"):
        sealed_file(capture)
    assert open_recording(capture).rows.tobytes() == recording.rows.tobytes()
    assert list(capture.parent.iterdir()) == [capture]


def test_foreign_parquet_is_not_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "foreign.parquet"
    parquet.write_table(pa.table({"a": [1, 2]}), path)
    with pytest.raises(RecordingError, match=r"foreign\.parquet is not a recording"):
        open_recording(path)


def test_without_pyarrow_the_capture_serves(
    tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The capture stores truth and trailer, CSV export works, and a message names the missing library."""
    capture = write(tmp_path / "trial.rigcap", recording)
    torn = tmp_path / "torn.rigcap"
    torn.write_bytes(capture.read_bytes()[:-3000])
    before = torn.read_bytes()
    for name in ("pyarrow", "parquet", "csv"):
        monkeypatch.setattr(getattr(deferred, name), "_module", None)
    for name in ("pyarrow", *(name for name in sys.modules if name.startswith("pyarrow."))):
        monkeypatch.setitem(sys.modules, name, None)
    truth = example_truth(np.arange(100, 200))
    for path in (capture, torn):
        sealed = seal(open_recording(path), truth, judge=lambda _: {"verdict": {"kind": "stable"}})
        assert sealed.path == path
        assert open_recording(path).rows.tobytes() == sealed.rows.tobytes()
    found = open_recording(capture)
    assert found.column("position_true").tolist() == found.column("sample_index").tolist()
    assert found.trailer is not None
    assert found.trailer["verdict"]["kind"] == "stable"
    assert found.complete
    export(found, f"{capture}.csv")
    with pytest.raises(RecordingError, match=r"needs pyarrow, which is not installed; pip install pyarrow"):
        export(found, f"{capture}.parquet")
    assert f"pyarrow is not installed: {capture} stays a capture" in caplog.text
    assert torn.read_bytes() == before
    names = ["torn.rigcap", "trial.rigcap", "trial.rigcap.csv", "trial.rigcap.csv.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
