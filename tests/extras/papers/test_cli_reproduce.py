"""`rig reproduce koul --quick` on the command line: one complete report, the same when repeated."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig.extras.papers.rules import ClaimStatus

SECTIONS = (
    "figure-5", "figure-6-koul-compliant", "figure-6-koul-rigid", "hands", "ways", "figure-7", "figure-8", "theory",
    "effects", "plants", "ideas",
)  # fmt: skip
CHAWDA_SECTIONS = (
    "figure-1", "figure-3", "hits", "figure-4", "figure-5", "figure-6", "figure-7", "table-1", "readings", "theory",
    "variants", "dual",
)  # fmt: skip
# Two that share an interpreter cost a tenth more, and other tests need the other core.
ALONE = ("--workers", "1")
VERDICTS = tuple(ClaimStatus)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return tmp_path_factory.mktemp("reproduction")


@pytest.mark.usefixtures("coarse")
@pytest.mark.timeout(300)  # compiles everything when it is cold
@pytest.mark.exhaustive(
    "tests/extras/papers/test_reproduction.py::test_the_command_writes_one_report_and_resumes_from_its_journal"
)
def test_quick_reproduces_the_paper_in_one_report_and_resumes_from_its_journal(
    place: Any, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert rig.cli.run(["reproduce", "koul", "--quick", *ALONE, "-o", str(place)]) == 0
    out, err = capfd.readouterr()
    assert "Traceback" not in err
    assert str(place / "koul.html") in out
    first = json.loads((place / "koul.json").read_text(encoding="utf-8"))
    for claim in first["claims"]:
        assert claim["claim"] in out
        assert claim["verdict"].startswith(VERDICTS)
    page = (place / "koul.html").read_text(encoding="utf-8")
    for section in SECTIONS:
        assert f'id="{section}"' in page
    assert page.count("data:image/png;base64,") == 12
    assert "(no picture)" not in page

    # Facts of the reproduction that no grid is too coarse for.
    by_key = {claim["key"]: claim["verdict"] for claim in first["claims"]}
    assert by_key["rises"] == by_key["noisier"] == "reproduced"
    assert by_key["same-range-plants"] == "follows from the method"
    assert by_key["levels-off"] == "reproduced only with the electrical lag"
    assert by_key["penetration"] == "reproduced only with fixed point"

    # Of the same results: the same pictures.
    monkeypatch.setattr("rig.extras.papers.reproduction.draw", lambda found, on_failure: {})
    assert rig.cli.run(["reproduce", "koul", "--quick", "--json", "-o", str(place)]) == 0
    again = json.loads(capfd.readouterr().out)
    assert again["kept"] > 0  # nothing was computed twice
    assert {name: again[name] for name in ("claims", "numbers", "provenance")} == {
        name: first[name] for name in ("claims", "numbers", "provenance")
    }


@pytest.mark.usefixtures("coarse")
@pytest.mark.timeout(300)
@pytest.mark.exhaustive(
    "tests/extras/papers/test_reproduction.py::test_the_command_writes_one_report_and_resumes_from_its_journal"
)
def test_quick_reproduces_the_second_paper_too(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert rig.cli.run(["reproduce", "chawda", "--quick", "--json", *ALONE, "-o", str(tmp_path)]) == 0
    found = json.loads(capfd.readouterr().out)
    page = (tmp_path / "chawda.html").read_text(encoding="utf-8")
    for section in CHAWDA_SECTIONS:
        assert f'id="{section}"' in page
    assert page.count("data:image/png;base64,") == 11
    assert "(no picture)" not in page

    # Facts of the reproduction that no grid is too coarse for.
    by_key = {claim["key"]: claim["verdict"] for claim in found["claims"]}
    assert by_key["levant-limited"].startswith("reproduced in part: the direction, by a factor of")
    for key in ("regions", "filter-holds", "control-undamped", "control-bare"):
        assert by_key[key] == "reproduced", key
    for key in ("order", "levant-stiffest", "both", "widths"):
        assert by_key[key] == "not reproduced", key


@pytest.mark.exhaustive("tests/system/test_commands.py::test_a_good_run_ends_with_0_as_json_and_as_text")
def test_the_conditions_of_the_paper_give_figures_7_and_8(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ["reproduce", "koul", "--impacts"]
    monkeypatch.chdir(tmp_path)
    assert rig.cli.run([*command, "--plot", "-o", "figures"]) == 0
    out = capfd.readouterr().out
    for words in ("57.00 (57…57)", "39.75 (35…45)", "29.00 (29…29)", "fs/20", "figure 8"):
        assert words in out
    assert len(re.findall(r"^ +\d+ \*", out, re.MULTILINE)) == 2
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {"koul-figure-7.png", "koul-figure-8.png"}
    assert rig.cli.run([*command, "--json"]) == 0
    facts = json.loads(capfd.readouterr().out)
    assert [panel["position_rate"] for panel in facts["figure_7"]] == [20000, 10000] * 2
    assert len(facts["word_lengths"]) == 18
    assert [p["velocity_rate"] for p in facts["figure_8"]["profiles"]] == [2000, 20000] * 2
