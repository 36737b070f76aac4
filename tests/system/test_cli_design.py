"""`rig design`: the configuration section to paste, files, JSON, error messages, and a search for a device."""

import json
from pathlib import Path
from typing import Any

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

from rig import config
from rig.cli import design as command
from rig.experiments.design import _margin as margin
from rig.experiments.design import _search as search
from rig.experiments.design import _whole as whole
from rig.experiments.design._search import Round

BRIEF = [
    "--set", "trial.duration_s=0.3", "--set", "verdict.tail_s=0.1", "--set", "homing.settle_s=0.02",
    "--operator", "none",
]  # fmt: skip
FEW = [*BRIEF, "--scheme", "uniform:10k,estimator=fdm-butterworth,cutoff_hz=400"]


@pytest.fixture(autouse=True)
def quick_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(margin, "SAMPLES", 1)
    monkeypatch.setattr(margin, "RATIO", 1.7)
    monkeypatch.setattr(margin, "OFFSETS", (0.1,))
    monkeypatch.setattr(whole, "COLUMNS", 3)
    monkeypatch.setattr(whole, "RATIO", 2.0)
    monkeypatch.setattr(command, "ON_RIG_COLUMNS", 1)
    monkeypatch.setattr(command, "ON_RIG_RATIO", 4.0)
    monkeypatch.setattr(
        search,
        "ROUNDS",
        (
            Round(name="first", enter=4, ratio=3.0, columns=3, offsets=(0.1,)),
            Round(name="last", enter=2, ratio=2.0, columns=3, offsets=(0.1,)),
        ),
    )


@pytest.mark.exhaustive("::test_a_design_is_printed_as_json")
def test_a_design_is_a_section_to_paste_with_picture_page_and_numbers(run: Any, tmp_path: Path) -> None:
    code, out, err = run("design", *FEW, "--paper", "-o", "mine.toml")
    assert code == 0, err
    assert out.startswith("design of koul-compliant: ")
    (place,) = (tmp_path / "designs").iterdir()
    assert {"controller.toml", "design.json", "design.png", "design.html"} <= {
        path.name for path in place.iterdir()
    }
    section = (tmp_path / "mine.toml").read_text()
    assert section == (place / "controller.toml").read_text()
    assert section in out
    (tmp_path / "pasted.toml").write_text(f'preset = "koul-compliant"\n{section}')
    assert config.load_experiment(tmp_path / "pasted.toml").controller.position_rate in (10_000, 20_000)
    page = (place / "design.html").read_text()
    assert "fitted on the stability limits" in page, "the numbers of this preset are the paper's"
    assert "data:image/png" in page
    found = json.loads((place / "design.json").read_text())
    assert found["toml"] == section
    (against,) = found["against"]
    assert against["listed"] == 1, "the paper's scheme is the preset's own"
    assert against["text"] in out
    assert against["text"] in page
    assert page.count(found["recommended"]["label"].split(",")[0]) >= 1
    again = json.loads(run("design", *FEW, "--paper", "--json", "--no-plot")[1])
    assert {name: again[name] for name in found if name != "files"} == {
        name: value for name, value in found.items() if name != "files"
    }


def test_a_design_is_printed_as_json(run: Any) -> None:
    code, out, err = run("design", *FEW, "--json", "--no-plot")
    assert code == 0, err
    found = json.loads(out)
    assert found["files"]["picture"] is None
    assert found["on_rig"] == []
    assert found["recommended"]


@pytest.mark.exhaustive("::test_a_design_is_printed_as_json")
def test_with_a_device_the_recommended_scheme_is_hit_there(run: Any, tmp_path: Path) -> None:
    code, out, err = run("design", *FEW, "--url", "sim://koul-compliant", "--json", "--no-plot")
    assert code == 0, err
    found = json.loads(out)
    assert found["on_rig"][0]["schemes"][0]["scheme"] == found["recommended"]["scheme"]
    assert all(one["hits"] > 0 for one in found["on_rig"])
    assert list(tmp_path.glob("designs/*/zwidth-*/hits/*.parquet"))
