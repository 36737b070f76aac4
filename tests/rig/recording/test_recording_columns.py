"""A recording opened with some of its columns: the same numbers and verdicts, and memory for these columns only."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rig
from rig.core.errors import RecordingError
from rig.core.sample import Phase
from rig.experiments.trials.judgement import JUDGED, experiment_of, judge
from rig.recording._capture import write_capture
from rig.recording._parquet import write_parquet
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.views.plots.hit import DRAWN, hit_figure, xy_figure
from rig.views.plots.style import STRETCHES, visible

ROWS = 150_000


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("columns")
    path = rig.hit("koul-compliant", stiffness=300.0, damping=0.5, duration_s=0.6, output=place).path
    assert path is not None
    return Path(path)


@pytest.fixture(scope="module", params=["sealed", "capture"])
def stored(request: pytest.FixtureRequest, sealed: Path) -> Path:
    if request.param == "sealed":
        return sealed
    path = sealed.with_name("copy.rigcap")
    with open(path, "wb") as file:
        write_capture(file, open_recording(sealed))
    return path


def test_chosen_columns_are_those_of_the_whole(stored: Path) -> None:
    whole = open_recording(stored)
    part = open_recording(stored, ["velocity", "phase", "no such column"])
    assert set(part.names) == set(part.units) == {"velocity", "phase"}
    assert part.rows.dtype.itemsize == 16
    assert all(part.column(name).tobytes() == whole.column(name).tobytes() for name in part.names)
    assert (part.trailer, part.complete, part.lost) == (whole.trailer, whole.complete, whole.lost)
    with pytest.raises(RecordingError, match="no column 'effort_sent'"):
        part.column("effort_sent")


def test_a_part_is_a_recording_that_every_format_keeps(stored: Path, tmp_path: Path) -> None:
    part = open_recording(stored, ["position", "tick"])
    for name, write in (("a.parquet", write_parquet), ("b.rigcap", write_capture)):
        with open(tmp_path / name, "wb") as file:
            write(file, part)
    with pytest.raises(RecordingError, match="has no column"):  # a part is not enough for every command
        open_recording(tmp_path / "a.parquet")


def test_damage_in_a_column_that_is_not_kept_is_found(sealed: Path, tmp_path: Path) -> None:
    whole = open_recording(sealed)
    path = tmp_path / "damaged.parquet"
    with open(path, "wb") as file:
        write_parquet(file, whole)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(RecordingError):
        open_recording(path, ["tick"])


def test_judging_and_drawing_take_the_columns_that_they_name(stored: Path) -> None:
    whole = open_recording(stored)
    experiment = experiment_of(whole)
    assert repr(judge(open_recording(stored, JUDGED), experiment)) == repr(judge(whole, experiment))
    hit_figure(open_recording(stored, DRAWN))
    xy_figure(open_recording(stored, DRAWN))


def test_a_long_line_is_drawn_by_its_extremes() -> None:
    values = np.random.default_rng(1).normal(size=20 * STRETCHES + 7)
    values[12_345], values[-1] = 50.0, -60.0
    shown = visible(values)
    assert len(values[shown]) <= 2 * STRETCHES + 2
    assert {50.0, -60.0} <= set(values[shown])
    assert (np.diff(np.arange(len(values))[shown]) > 0).all()
    short = values[: 2 * STRETCHES]
    assert len(short[visible(short)]) == len(short)


def lengthen(recording: Recording, rows: int) -> Recording:
    """Return the recording with its trial repeated up to this number of rows."""
    (trial,) = np.nonzero(recording.rows["phase"] == Phase.TRIAL)
    places = np.concatenate((np.arange(trial[0]), np.resize(trial, rows)))
    found = recording.rows[places]
    found["tick"] = np.arange(len(found))
    found["device_time"] = found["device_time"][0] + 50_000 * np.arange(len(found))
    kept = {key: value for key, value in (recording.trailer or {}).items() if key != "verdict"}
    return replace(recording, rows=found, trailer=kept, path=None)


# Not ru_maxrss, which begins with the peak of the process that started this one, and cannot be reset.
SHOW = """
import re, sys
import rig.cli
from pathlib import Path
for path in sys.argv[1:]:
    Path("/proc/self/clear_refs").write_text("5")
    assert rig.cli.run(["show", path, "--plot", "--json"]) == 0
    print(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1], file=sys.stderr)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.exhaustive("::test_judging_and_drawing_take_the_columns_that_they_name")
def test_long_recording_is_judged_and_drawn_within_bytes_a_row(sealed: Path, tmp_path: Path) -> None:
    """Half way between the bytes that it takes (440, 550) and those with all columns in memory (620, 730)."""
    whole, paths = open_recording(sealed), []
    for ending, write in (("rigcap", write_capture), ("parquet", write_parquet)):
        for name, recording in (("short", whole), ("long", lengthen(whole, ROWS))):
            paths.append(tmp_path / f"{name}.{ending}")
            with open(paths[-1], "wb") as file:
                write(file, recording)
    done = subprocess.run(
        [sys.executable, "-c", SHOW, *map(str, paths)],
        capture_output=True, text=True, check=True, env={**os.environ, "ARROW_DEFAULT_MEMORY_POOL": "system"},
    )  # fmt: skip
    peaks = [1024 * int(peak) for peak in done.stderr.split()[-4:]]
    assert (peaks[1] - peaks[0]) / ROWS < 530
    assert (peaks[3] - peaks[2]) / ROWS < 640
