"""The conformance suite over every format, read back as users would; recordings opened with some of their columns."""

import csv
import itertools
import json
import os
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

import rig
from rig.core.errors import RecordingError
from rig.core.sample import COLUMNS, Phase
from rig.experiments.trials.judgement import JUDGED, experiment_of, judge
from rig.recording._capture import write_capture
from rig.recording._parquet import write_parquet
from rig.recording.data import Recording
from rig.recording.export import export
from rig.recording.header import VERSION, dtype_of
from rig.recording.reader import open_facts, open_recording
from rig.views.plots.hit import DRAWN, hit_figure, xy_figure
from rig.views.plots.style import STRETCHES, visible
from tests.conformance.recording import Limits, check_recording_format, example_header, example_rows


def write_rigcap(recording: Recording, path: Path) -> None:
    with open(path, "wb") as file:
        write_capture(file, recording)


def read_csv(path: Path) -> Recording:
    sidecar = json.loads(path.with_name(path.name + ".json").read_text("utf-8"))
    with open(path, newline="", encoding="utf-8") as file:
        names, *lines = csv.reader(file)
    dtype = dtype_of(sidecar["header"]["schema"])
    assert names == list(dtype.names or ())
    rows = np.zeros(len(lines), dtype)
    for name, values in zip(names, zip(*lines, strict=True), strict=False):
        parse = float if dtype[name].kind == "f" else int
        rows[name] = [parse(text) for text in values]
    return Recording(sidecar["header"], rows, sidecar["trailer"], sidecar["complete"])


def read_mat(path: Path) -> Recording:
    contents = loadmat(path, simplify_cells=True, chars_as_strings=True)
    header = json.loads(str(contents["header"]))
    dtype = dtype_of(header["schema"])
    data = {name: np.atleast_1d(column) for name, column in contents["data"].items()}
    rows = np.zeros(len(data[(dtype.names or ())[0]]), dtype)
    for name in dtype.names or ():
        assert data[name].dtype == dtype[name]
        rows[name] = data[name]
    assert contents["units"] == {column["name"]: column["unit"] for column in header["schema"]["columns"]}
    return Recording(header, rows, json.loads(str(contents["trailer"])), bool(contents["complete"]))


FORMATS: dict[str, tuple[Any, Any, Limits]] = {
    "rigcap": (write_rigcap, open_recording, Limits(losses=False)),
    "parquet": (export, open_recording, Limits()),
    "csv": (export, read_csv, Limits(nan_bits=False, losses=False, damage=False)),
    "mat": (export, read_mat, Limits(losses=False, damage=False)),
}


@pytest.mark.parametrize("name", FORMATS)
def test_format_keeps_what_a_recording_is(name: str, tmp_path: Path) -> None:
    write, read, limits = FORMATS[name]
    numbers = itertools.count()

    def write_somewhere(recording: Recording) -> Path:
        path = tmp_path / f"{next(numbers)}.{name}"
        write(recording, path)
        return path

    check_recording_format(write_somewhere, read, limits)


@pytest.mark.parametrize("name", ["rigcap", "parquet"])
def test_a_recording_without_a_column_is_refused(name: str, tmp_path: Path) -> None:
    columns = [column for column in COLUMNS if column.name != "edge_age"]
    dtype = np.dtype([(column.name, column.dtype) for column in columns], align=True)
    path = tmp_path / f"lacking.{name}"
    FORMATS[name][0](Recording(example_header(columns=columns), example_rows(5, dtype=dtype), {}), path)
    with pytest.raises(RecordingError, match=r"lacking.* has no column 'edge_age'"):
        open_recording(path)


def test_a_sealed_recording_of_another_format_version_is_refused(tmp_path: Path) -> None:
    header = {**example_header(), "version": VERSION + 1}
    path = export(Recording(header, example_rows(5), {}), tmp_path / "other.parquet")
    with pytest.raises(RecordingError, match=f"format version {VERSION + 1}, .* reads version {VERSION}"):
        open_recording(path)


def test_a_change_of_the_columns_is_another_format_version() -> None:
    """If a column changes, increment `rig.recording.header.VERSION`, then update this number."""
    described = [(column.name, column.dtype, column.unit) for column in COLUMNS]
    assert (VERSION, len(COLUMNS), zlib.crc32(repr(described).encode())) == (2, 36, 1874533501)


@pytest.mark.parametrize("ending", ["rigcap", "parquet"])
def test_facts_are_those_of_the_whole_recording(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"one.{ending}"
    whole = Recording(example_header(), example_rows(5), {"reason": "finished"})
    FORMATS[ending][0](whole, path)
    facts, opened = open_facts(path), open_recording(path)
    assert (facts.header, facts.names, len(facts)) == (opened.header, opened.names, 0)
    if ending == "parquet":  # of a capture the trailer stands behind its rows
        assert (facts.trailer, facts.complete) == (opened.trailer, True)
    else:
        assert (facts.trailer, facts.complete) == (None, False)


@pytest.mark.parametrize("ending", ["rigcap", "parquet"])
def test_facts_are_refused_as_the_whole_is(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"one.{ending}"
    FORMATS[ending][0](Recording(example_header(), example_rows(5), {}), path)
    whole = path.read_bytes()
    for data in (b"", whole[:40], b"text", whole[:4] + bytes(100)):
        path.write_bytes(data)
        with pytest.raises(RecordingError):
            open_facts(path)


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


ROWS = 150_000


def lengthen(recording: Recording) -> Recording:
    (trial,) = np.nonzero(recording.rows["phase"] == Phase.TRIAL)
    found = recording.rows[np.concatenate((np.arange(trial[0]), np.resize(trial, ROWS)))]
    found["tick"] = np.arange(len(found))
    found["device_time"] = found["device_time"][0] + 50_000 * np.arange(len(found))
    return replace(recording, rows=found, trailer={**(recording.trailer or {}), "verdict": {}}, path=None)


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
def test_a_long_recording_is_judged_and_drawn_within_bytes_a_row(sealed: Path, tmp_path: Path) -> None:
    """Half way between the bytes that it takes (440, 570) and those with all columns in memory (620, 730).

    One process shows all files, because its first Parquet file leaves memory that it does not need again.
    """
    whole, paths = open_recording(sealed), []
    for ending, write in (("rigcap", write_capture), ("parquet", write_parquet)):
        for name, recording in (("short", whole), ("long", lengthen(whole))):
            paths.append(tmp_path / f"{name}.{ending}")
            with open(paths[-1], "wb") as file:
                write(file, recording)
    environment = {**os.environ, "ARROW_DEFAULT_MEMORY_POOL": "system"}
    command = [sys.executable, "-c", SHOW, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    peaks = [1024 * int(peak) for peak in done.stderr.split()[-4:]]
    assert (peaks[1] - peaks[0]) / ROWS < 530
    assert (peaks[3] - peaks[2]) / ROWS < 640
