"""Stored maps: units, a table that other programs open, and a finished map that is read instead of recomputed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest

from rig import config
from rig.core.errors import RecordingError
from rig.experiments.mapping import _maps as maps
from rig.experiments.sweep import _executors as executors
from rig.experiments.sweep._journal import read_on
from rig.recording.reader import open_recording
from tests.conformance.maps import short_map

PLAN = short_map(0.1)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Any:
    directory = maps.directory_for(PLAN, tmp_path_factory.mktemp("maps"), "zwidth")
    maps.map_into(PLAN, directory)
    return directory


def test_the_table_opens_with_pandas_and_has_a_row_for_each_hit(place: Any) -> None:
    table = pd.read_parquet(place / "hits.parquet")
    summary = json.loads((place / maps.SUMMARY).read_text())
    assert config.experiment_from_mapping(summary["experiment"], "map.json") == PLAN.experiment
    assert len(table) == summary["hits"]
    assert set(table["damping"]) == {0.0, 0.3}
    assert table["passes_any_true"].dtype == bool
    assert (table["peak_penetration_true"] > 0.0).all()
    units = {field.name: field.metadata[b"unit"].decode() for field in pq.read_schema(place / "hits.parquet")}
    of_rows = {"stiffness": "N·m/rad", "damping": "N·m·s/rad", "heard": "N·m", "contact_s": "s", "kind": ""}
    assert of_rows.items() <= units.items()


def test_a_finished_map_is_read_again_without_a_hit(place: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "Threads", None)
    found = maps.map_into(PLAN, place)
    assert found.hits == json.loads((place / maps.SUMMARY).read_text())["hits"]


def test_the_directory_depends_on_plan_and_device(tmp_path: Path) -> None:
    first = maps.directory_for(PLAN, tmp_path, "zwidth")
    assert first == maps.directory_for(PLAN, tmp_path, "zwidth")
    assert first.name.startswith("zwidth-koul-compliant-")
    other = config.override(PLAN.experiment, {"trial.seed": 7})
    places = {
        first,
        maps.directory_for(PLAN, tmp_path, "zwidth", "serial:///dev/ttyACM0"),
        maps.directory_for(replace(PLAN, experiment=other), tmp_path, "zwidth"),
        maps.directory_for(replace(PLAN, repeats=2), tmp_path, "zwidth"),
    }
    assert len(places) == 4


def test_a_place_that_cannot_be_made_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "maps").write_text("in the way")
    with pytest.raises(RecordingError, match="cannot make"):
        maps.map_into(PLAN, tmp_path / "maps" / "zwidth")


def test_plan_and_journal_are_readable_while_the_map_grows(place: Any, tmp_path: Path) -> None:
    assert maps.read_plan(place) == (PLAN, "")
    entries, end = read_on(place / maps.JOURNAL)
    assert {key for key, _ in entries} == {series.key for series in PLAN.series()}, "as each is finished"
    assert read_on(place / maps.JOURNAL, end) == ([], end)
    torn = tmp_path / "journal"
    torn.write_bytes((place / maps.JOURNAL).read_bytes()[:-5])
    first, place_of_second = read_on(torn)
    assert first == entries[:1]
    torn.write_bytes((place / maps.JOURNAL).read_bytes())
    assert read_on(torn, place_of_second) == (entries[1:], end)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"version": 1, "work": "x"}', '{"version": 2}'])
def test_an_invalid_plan_is_refused_by_its_file_name(tmp_path: Path, text: str) -> None:
    (tmp_path / maps.PLAN).write_text(text)
    with pytest.raises(RecordingError, match=r"plan\.json"):
        maps.read_plan(tmp_path)


def test_the_ends_of_a_series_are_judged_as_recorded_hits_to_the_bit(place: Any, tmp_path: Path) -> None:
    """Repeat wall, offset and seed over the byte link; compare the verdicts by recording and by truth."""
    journal, _ = read_on(place / maps.JOURNAL)
    series_of = {series.key: series for series in PLAN.series()}
    for number, (key, rows) in enumerate(journal):
        for row in rows[-1:] if number else (rows[0], rows[-1]):
            path = maps.recorded_hit(PLAN, series_of[key], row["stiffness"], tmp_path)
            trailer = open_recording(path).trailer or {}
            for suffix in ("", "_true"):
                verdict = trailer[f"verdict{suffix}"]
                same = ("kind", "peak_penetration", "heard", "moved", "contact_s", "growth")
                assert [verdict[name] for name in same] == [row[name + suffix] for name in same]
    assert maps.recorded_hit(PLAN, series_of[key], row["stiffness"], tmp_path) == path
