"""How results display: ten lines at a prompt, tables in a notebook, a picture, columns with their units."""

import sys
from typing import Any

import numpy as np
import pytest

import rig
from rig.control.estimators import _kalman as kalman
from rig.core import deferred
from rig.core.errors import ConfigError, RecordingError, RigError
from rig.core.shown import LINES, WIDTH
from rig.experiments.mapping._ranges import frequency_plan
from rig.experiments.mapping.zwidth_frequency import FrequencyMap
from tests.conformance.own_parts import stiffening
from tests.conformance.pages import ParsedPage
from tests.conformance.tiers import first_by_default


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    place = tmp_path_factory.mktemp("shown")
    hit = rig.hit("koul-compliant", duration_s=0.25, changes={"verdict.tail_s": 0.1}, output=place)
    # Linear theory, which takes seconds, does not apply.
    levant = rig.Scheme.parse("uniform:1k,estimator=levant")
    walls = {"stiffnesses": [1000.0, 2000.0], "dampings": [0.0, 5.0]}
    plan = frequency_plan(rig.load("chawda-linear"), [levant], **walls)
    shape = (len(plan.schemes), plan.realisations + 1, 2, 2)
    return {
        "hit": hit,
        "recording": hit.recording,
        "column": hit.recording["effort_sent"],
        "experiment": hit.experiment,
        "plan": rig.plan("koul-compliant"),
        "replay": rig.replay(hit.recording, estimator="fdm"),
        "comparison": rig.compare("koul-rigid", offsets=[0.4], duration_s=0.2, changes={"verdict.tail_s": 0.05}),
        "zwidth": rig.zwidth(
            "koul-compliant", [levant], dampings=[0.0, 0.5], lowest=100.0, highest=120.0, search="bisection", ratio=1.1,
            offsets=[0.1],
        ),
        "frequency": FrequencyMap(plan, [], np.ones(shape, np.bool_), np.full(shape, 3.0)),
        "impedance": rig.impedance(walls=[(5e3, 20.0)], excitation={"realisations": 1})[0],
        "thrown out": rig.impedance(walls=[(2e5, 0.0)], excitation={"realisations": 1})[0],
        "estimators": rig.compare_estimators(rig.recording_case(hit.recording), ["fdm", "levant:lipschitz=1"]),
        "tuning": rig.tune_estimator("fdm-butterworth", rig.recording_case(hit.recording), free=["cutoff_hz"]),
        "law": stiffening(),
        "estimator": kalman.ESTIMATOR,
        "theory": rig.theory.theory_of("koul-compliant", ["dual:20k/2k", "uniform:1k,estimator=levant"]),
    }  # fmt: skip


def test_a_result_takes_ten_lines_at_a_prompt(results: dict[str, Any]) -> None:
    for name, result in results.items():
        lines = repr(result).splitlines()
        assert 2 <= len(lines) <= LINES, name
        assert max(map(len, lines)) <= WIDTH, name


def test_a_notebook_is_shown_tables_in_whole_elements(results: dict[str, Any]) -> None:
    for name, result in results.items():
        assert ParsedPage(result._repr_html_()).tables, name
    assert "estimated velocity, held between velocity samples" in results["recording"]._repr_html_()
    assert "<td>controller.velocity_rate</td><td>2000</td>" in results["experiment"]._repr_html_()


def test_a_text_of_a_rig_is_text_in_a_notebook() -> None:
    odd = rig.load("koul-compliant", changes={"rig.description": "<script>1</script>"})
    assert "<script>" not in odd._repr_html_()


def test_a_column_has_its_unit_and_meaning_and_is_an_array_to_numpy(results: dict[str, Any]) -> None:
    column, rows = results["column"], results["recording"].rows
    assert (column.name, column.unit) == ("effort_sent", "N·m")
    assert column.description.startswith("effort of the command sent")
    assert np.abs(column).max() == np.abs(rows["effort_sent"]).max()
    assert (np.asarray(column, dtype=np.float32) == rows["effort_sent"].astype(np.float32)).all()
    assert len(column) == len(rows)
    assert column.time_s[-1] == results["recording"].time_s[-1]
    with pytest.raises(RecordingError, match=r"no column 'effort_snt'; did you mean effort_sent\?"):
        results["recording"]["effort_snt"]


# The last five are also drawn by tests/rig/views and test_zwidth_frequency.py.
DRAWN = [
    "column", "comparison", "impedance", "estimators", "theory", "hit", "recording", "replay", "zwidth", "frequency",
]  # fmt: skip


def test_a_picture_is_a_png_and_a_plan_has_none(results: dict[str, Any]) -> None:
    assert {name for name, result in results.items() if hasattr(result, "plot")} == {*DRAWN, "thrown out"}
    assert results["column"].plot()._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match="a Plan cannot be drawn; give a hit"):
        rig.plot(results["plan"])


@pytest.mark.parametrize("name", first_by_default(DRAWN, 5))
def test_each_has_its_picture(name: str, results: dict[str, Any]) -> None:
    assert results[name].plot().figure.axes


def test_other_libraries_get_the_units_with_the_numbers(results: dict[str, Any]) -> None:
    recording = results["recording"]
    assert recording.to_pandas().attrs["units"]["velocity"] == "rad/s"


@pytest.mark.exhaustive("::test_other_libraries_get_the_units_with_the_numbers")
def test_xarray_gets_units_meanings_and_numbers(results: dict[str, Any]) -> None:
    recording = results["recording"]
    xarray = pytest.importorskip("xarray")
    found = recording.to_xarray()
    assert isinstance(found, xarray.Dataset)
    assert found.velocity.attrs["units"] == "rad/s"
    assert found.velocity.attrs["long_name"] == recording.descriptions["velocity"]
    assert (found.velocity.values == recording.rows["velocity"]).all()
    assert (found.time.values == recording.time_s).all()


@pytest.mark.parametrize("library", ["pandas", "xarray"])
def test_a_library_that_is_not_there_is_named_with_what_installs_it(
    library: str, results: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.setattr(getattr(deferred, library), "_module", None)
    with pytest.raises(RigError, match=rf"{library} is not installed; .* pip install 'haptic-rig\[data\]'"):
        getattr(results["recording"], f"to_{library}")()


def test_a_recording_that_was_cut_off_shows_what_is_missing(results: dict[str, Any]) -> None:
    whole = results["recording"]
    cut = rig.Recording(whole.header, whole.rows[:0], complete=False)
    assert "cut off" in repr(cut)
    assert "none" in repr(cut)
    ParsedPage(cut._repr_html_())
    assert "rows" in repr(cut["velocity"])
