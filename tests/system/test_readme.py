"""Examples, links and names in the README, changelog and guides are correct; `test_docs` tests the site's pages."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.views.plots import style
from tests.conformance.guides import ROOT, examples

README = ROOT / "README.md"
GUIDES = {path.parent.name: examples(path) for path in (README, *sorted((ROOT / "rig").rglob("README.md")))}


def names_of(guide: str, number: int, directory: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.chdir(directory)
    names: dict[str, Any] = {"__name__": f"example_{number}"}
    exec(compile(GUIDES[guide][number], f"{guide}, example {number}", "exec"), names)
    return names


def test_the_example_of_a_new_law_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(style, "DPI", 20)
    names = names_of(README.parent.name, 0, tmp_path, monkeypatch)
    output = capsys.readouterr().out.split()
    assert output[0] in {"stable", "limit"}
    assert "N·m" in output
    assert list(tmp_path.glob("recordings/*.parquet"))
    assert (tmp_path / "hit.png").stat().st_size > 2_000
    assert not names["again"].exact, "fdm is another estimator"


@pytest.mark.exhaustive("::test_the_example_of_a_new_law_runs")
def test_the_estimators_of_the_guide_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = names_of("estimators", 0, tmp_path, monkeypatch)
    slope = 1e-3 / 300 * np.cos(np.arange(2000) / 300) * 20_000
    assert names["velocity"][500:] == pytest.approx(slope[500:], abs=0.03 * slope.max())
    logged = names_of("estimators", 1, tmp_path, monkeypatch)["velocity"]
    assert logged[1:] == pytest.approx(0.03), "30 counts of 1 µm in 1 ms, across the wrap and the lost sample"
    own = names_of("estimators", 2, tmp_path, monkeypatch)["result"]
    assert own.experiment.controller.parameters == {"weight": 0.9}
    assert own.recording.header["initial_state"]["estimator"]["name"] == "smoothed"


def test_the_search_rule_of_the_guide_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = names_of("search", 0, tmp_path, monkeypatch)
    assert names["probe"].level in range(100, 825, 25)


PAGES = (README, ROOT / "rig" / "DESIGN.md", *sorted((ROOT / ".github").rglob("*.md")))
PATH = re.compile(r"(?<![\w./])((?:rig|tests|sim_backend|firmware_protocol|\.ci|\.github)/[\w./-]*\w)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_a_page_of_the_repository_names_exist(page: Path) -> None:
    """A path that contains NAME stands for a file that the reader adds."""
    text = page.read_text(encoding="utf-8")
    links = [page.parent / target for target in re.findall(r"\]\(([^)#:]+)", text)]
    named = [ROOT / path for path in PATH.findall(text) if "NAME" not in path]
    assert [path for path in links + named if not path.exists()] == []


def test_tests_and_tables_that_a_recipe_names_exist() -> None:
    """A recipe in CONTRIBUTING.md names a table with its file, and a test by its function."""
    text = " ".join((ROOT / ".github" / "CONTRIBUTING.md").read_text(encoding="utf-8").split())
    tables = re.findall(r"`([A-Z_]{3,})` of `([\w/.]+/[\w.]+)`", text)
    tables += [(name, path) for path, name in re.findall(r"`([\w/.]+\.py)`: a line of `([A-Z_]{3,})`", text)]
    assert len(tables) >= 5
    for name, path in tables:
        assert re.search(rf"^{name}\b", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE), (name, path)
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    for name in re.findall(r"`(test_\w+)`", text):
        assert f"def {name}(" in tests, name


def test_a_release_needs_its_version_with_a_date_in_the_changelog(tmp_path: Path) -> None:
    for folder in (tmp_path / ".ci", tmp_path / "rig" / "docs"):
        folder.mkdir(parents=True)
    script = shutil.copy(ROOT / ".ci" / "release-notes", tmp_path / ".ci")
    (tmp_path / "pyproject.toml").write_text('version = "1.2.0"\n')
    changes = tmp_path / "rig" / "docs" / "changelog.md"

    def notes(tag: str) -> str:
        done = subprocess.run(["bash", script, tag], capture_output=True, text=True, check=False)
        return done.stdout.strip() or f"refused: {done.stderr}"

    changes.write_text("## 1.2.0, not released\n\n* This.\n")
    assert "refused: rig/docs/changelog.md has no section '## 1.2.0, YYYY-MM-DD'" in notes("v1.2.0")
    changes.write_text("## 1.2.0, 2027-01-31\n\n* This.\n\n## 1.1.0, 2026-01-31\n\n* That.\n")
    assert notes("v1.2.0") == "* This."
    assert "refused: the tag is v1.1.0 and the version 1.2.0" in notes("v1.1.0")
