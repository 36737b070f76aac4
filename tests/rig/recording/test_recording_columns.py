"""A recording opened with some of its columns: the same numbers and verdicts, and memory for these columns only."""

from pathlib import Path

import numpy as np
import pytest

import rig
from rig.core.errors import RecordingError
from rig.experiments.trials.judgement import JUDGED, experiment_of, judge
from rig.recording._capture import write_capture
from rig.recording._parquet import write_parquet
from rig.recording.reader import open_recording
from rig.views.plots.hit import DRAWN, hit_figure, xy_figure
from rig.views.plots.style import STRETCHES, visible


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
