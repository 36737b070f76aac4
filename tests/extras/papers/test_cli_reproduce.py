"""`rig reproduce PAPER --quick` on the command line: one complete report."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import rig.cli
from rig.extras.papers.chawda.reproduction import CHAWDA
from rig.extras.papers.cli import PAPERS
from rig.extras.papers.koul.reproduction import KOUL
from rig.extras.papers.rules import ClaimStatus

SECTIONS = {
    "koul": (
        "figure-5", "figure-6-koul-compliant", "figure-6-koul-rigid", "hands", "ways", "figure-7", "figure-8", "theory",
        "effects", "plants", "ideas",
    ),
    "chawda": (
        "figure-1", "figure-3", "hits", "figure-4", "figure-5", "figure-6", "figure-7", "table-1", "readings", "theory",
        "variants", "dual",
    ),
}  # fmt: skip
# Still coarser than `--quick`.
SCALES = {
    "koul": replace(KOUL.quick, ratio=2.0, range_ratio=2.0, idea_ratio=3.0, plants=2, state_bits=(4, 16)),
    "chawda": replace(CHAWDA.quick, dampings=(0.0, 60.0, 700.0), hit_dampings=(0.0, 100.0, 400.0, 800.0),
                      dual_dampings=(0.0,), coarse=4),
}  # fmt: skip
PICTURES = {"koul": 12, "chawda": 11}
# Facts of the reproductions that no grid is too coarse for (patterns).
VERDICTS = {
    "koul": {
        "rises": "reproduced",
        "noisier": "reproduced",
        "same-range-plants": "follows from the method",
        "levels-off": "reproduced only with the electrical lag",
        "penetration": "reproduced only with fixed point",
    },
    "chawda": {
        "levant-limited": "reproduced in part: the direction, by a factor of .*",
        **dict.fromkeys(("regions", "filter-holds", "control-undamped", "control-bare"), "reproduced"),
        **dict.fromkeys(("order", "levant-stiffest", "both", "widths"), "not reproduced"),
    },
}


@pytest.mark.usefixtures("coarse")
@pytest.mark.timeout(300)  # compiles everything when it is cold
@pytest.mark.exhaustive(
    "tests/extras/papers/test_reproduction.py::test_the_command_writes_one_report_and_resumes_from_its_journal"
)
@pytest.mark.parametrize("paper", SECTIONS)
def test_quick_reproduces_a_paper_in_one_report(
    paper: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PAPERS, paper, replace(PAPERS[paper], quick=SCALES[paper]))
    # Two workers that share an interpreter cost a tenth more, and other tests need the other core.
    command = ["reproduce", paper, "--quick", "--json", "--workers", "1", "-o", str(tmp_path)]
    assert rig.cli.run(command) == 0
    out, err = capfd.readouterr()
    assert "Traceback" not in err
    found = json.loads(out)
    by_key = {claim["key"]: claim["verdict"] for claim in found["claims"]}
    assert all(verdict.startswith(tuple(ClaimStatus)) for verdict in by_key.values())
    for key, verdict in VERDICTS[paper].items():
        assert re.fullmatch(verdict, by_key[key]), key
    page = (tmp_path / f"{paper}.html").read_text(encoding="utf-8")
    for section in SECTIONS[paper]:
        assert f'id="{section}"' in page
    assert page.count("data:image/png;base64,") == PICTURES[paper]
    assert "(no picture)" not in page


@pytest.mark.exhaustive(
    "tests/extras/papers/test_koul_figures.py::test_few_bits_of_state_take_the_damping_from_a_uniform_wall_alone"
)
def test_figures_7_and_8_of_koul_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert rig.cli.run(["reproduce", "koul", "--impacts", "--plot", "-o", "figures"]) == 0
    printed = capfd.readouterr().out
    assert all(words in printed for words in ("57.00 (57…57)", "39.75 (35…45)", "29.00 (29…29)", "figure 8"))
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {"koul-figure-7.png", "koul-figure-8.png"}
    assert rig.cli.run(["reproduce", "koul", "--impacts", "--json"]) == 0
    assert {"figure_7", "word_lengths", "figure_8"} <= set(json.loads(capfd.readouterr().out))
