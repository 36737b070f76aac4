"""A map on disk: units, a table that others open, and a finished map that is read instead of computed."""

import json

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

import pandas as pd
import pyarrow.parquet as pq

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import RecordingError
from rig.experiments import map_files, zwidth
from rig.experiments.ladder import Search
from rig.experiments.sweep import executors
from rig.experiments.zwidth import MapPlan

SHORT = {"trial.duration_s": 0.3, "verdict.tail_s": 0.1, "homing.settle_s": 0.02}
PLAN = MapPlan(
    experiment=config.override(presets.load("koul-compliant"), SHORT),
    schemes=(Scheme.parse("uniform:20k"),),
    dampings=(0.0, 0.3),
    search=Search(lowest=10.0, highest=100.0, ratio=3.0),
    offsets=(0.1,),
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    directory = map_files.directory_for(PLAN, tmp_path_factory.mktemp("maps"), "zwidth")
    map_files.map_into(PLAN, directory)
    return directory


def test_the_table_opens_with_pandas_and_has_a_row_for_each_hit(place):
    table = pd.read_parquet(place / map_files.TABLE)
    summary = json.loads((place / map_files.SUMMARY).read_text())
    assert len(table) == summary["hits"]
    assert set(table["damping"]) == {0.0, 0.3}
    assert table["passes_any_true"].dtype == bool
    assert (table["peak_penetration_true"] > 0.0).all()


def test_columns_carry_their_units(place):
    schema = pq.read_schema(place / map_files.TABLE)
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert units["stiffness"] == "N·m/rad"
    assert units["damping"] == "N·m·s/rad"
    assert units["heard"] == units["heard_true"] == "N·m"
    assert (units["contact_s"], units["kind"]) == ("s", "")


def test_the_summary_holds_the_whole_experiment(place):
    summary = json.loads((place / map_files.SUMMARY).read_text())
    assert config.experiment_from_mapping(summary["experiment"], "map.json") == PLAN.experiment


def test_a_finished_map_is_read_again_without_a_hit(place, monkeypatch):
    monkeypatch.setattr(zwidth, "run_climb", None)
    monkeypatch.setattr(executors, "find_work", None)
    found = map_files.map_into(PLAN, place)
    assert found.hits == json.loads((place / map_files.SUMMARY).read_text())["hits"]


def test_the_place_depends_on_all_that_decides_and_on_the_device(tmp_path):
    first = map_files.directory_for(PLAN, tmp_path, "zwidth")
    assert first == map_files.directory_for(PLAN, tmp_path, "zwidth")
    assert first.name.startswith("zwidth-koul-compliant-")
    other = config.override(PLAN.experiment, {"trial.seed": 7})
    places = {
        first,
        map_files.directory_for(PLAN, tmp_path, "zwidth", "serial:///dev/ttyACM0"),
        map_files.directory_for(MapPlan(**{**_fields(PLAN), "experiment": other}), tmp_path, "zwidth"),
        map_files.directory_for(MapPlan(**{**_fields(PLAN), "repeats": 2}), tmp_path, "zwidth"),
    }
    assert len(places) == 4


def _fields(plan):
    return {name: getattr(plan, name) for name in plan.__dataclass_fields__}


def test_a_place_that_cannot_be_made_is_one_clear_error(tmp_path):
    (tmp_path / "maps").write_text("in the way")
    with pytest.raises(RecordingError, match="cannot make"):
        map_files.map_into(PLAN, tmp_path / "maps" / "zwidth")
