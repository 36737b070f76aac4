"""`rig compare` as a person meets it: the table, the picture, JSON, and what it refuses."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

import rig.cli

QUICK = ["--duration", "0.2", "--set", "verdict.tail_s=0.05"]
BRIEF = ["--duration", "0.06", "--set", "verdict.tail_s=0.02"]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run a command line in an empty directory: exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: Any) -> Any:
        code = rig.cli.run(["compare", *(str(argument) for argument in arguments)])
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return call


def test_it_prints_a_table_and_draws_a_picture_and_records_nothing(run: Any, tmp_path: Path) -> None:
    code, out, err = run("--rig", "koul-rigid", *QUICK)
    assert code == 0, err
    assert "koul-rigid: K = 300 N·m/rad, B = 0.5 N·m·s/rad, the same hit, mean over 4 encoder offsets" in out
    lines = [line.split() for line in out.splitlines()]
    assert [line[:2] for line in lines[2:5]] == [["no", "damping"], ["uniform", "20"], ["dual", "20/2"]]
    (picture,) = (tmp_path / "recordings").iterdir()
    assert picture.name == "koul-rigid-compare.png"
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_json_has_every_number_of_every_scheme_and_offset(run: Any, tmp_path: Path) -> None:
    code, out, _ = run(
        "--json", "--no-plot", "-K", "200", "-B", "0.3", "--scheme", "none",
        "--scheme", "dual:20k/2k", "--scheme", "dual:20k/4k,estimator=fdm", *QUICK,
    )  # fmt: skip
    assert code == 0
    facts = json.loads(out)
    assert (facts["rig"], facts["wall"]["stiffness"], facts["wall"]["damping"]) == (
        "koul-compliant",
        200.0,
        0.3,
    )
    assert facts["start"]["motor_effort"] == 0.15
    none, dual, raw = facts["outcomes"]
    assert [s["name"] for s in facts["outcomes"]] == ["none", "dual:20k/2k", "dual:20k/4k,estimator=fdm"]
    assert (none["damping"], dual["damping"], raw["damping"]) == (0.0, 0.3, 0.3)
    assert none["numbers"]["peak"] > dual["numbers"]["peak"]
    assert len({s["numbers"]["impact_velocity"] for s in facts["outcomes"]}) == 1
    assert len(dual["impacts"]) == 4
    assert facts["picture"] is None
    assert not list(tmp_path.iterdir())


@pytest.mark.exhaustive("::test_it_prints_a_table_and_draws_a_picture_and_records_nothing")
def test_the_conditions_of_the_paper_give_figures_7_and_8(run: Any, tmp_path: Path) -> None:
    code, out, _ = run("--as-in-the-paper", "-o", "figures")
    assert code == 0
    for words in ("57.00 (57…57)", "39.75 (35…45)", "29.00 (29…29)", "fs/20", "figure 8"):
        assert words in out
    assert len(re.findall(r"^ +\d+ \*", out, re.MULTILINE)) == 2
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {"koul-figure-7.png", "koul-figure-8.png"}
    code, out, _ = run("--as-in-the-paper", "--json", "--no-plot")
    facts = json.loads(out)
    assert code == 0
    assert [panel["position_rate"] for panel in facts["figure_7"]] == [20000, 10000] * 2
    assert len(facts["word_lengths"]) == 18
    assert [p["velocity_rate"] for p in facts["figure_8"]["profiles"]] == [2000, 20000] * 2


WRONG = [
    (["--set", "trial.repeats=3"], "trial.repeats = 3: a compared hit has no noise"),
    (["--as-in-the-paper", "-K", "100"], "has its own rig, wall, start and schemes"),
    (["--scheme", "triple:20k"], "no such kind of sampling"),
    (["--scheme", "none", "--scheme", "none"], "scheme none is named twice"),
    (["--scheme", "dual:20k/3k"], "velocity_rate"),
    (["--estimator", "fmd"], "fmd"),
    (["--rig", "nobody"], "nobody"),
    (["--start", "-0.4", *BRIEF], "never reached the wall within 0.06 s"),
    (["--set", "trial.kind=human"], "in automated trials, without a hand"),
]


@pytest.mark.parametrize(("arguments", "text"), WRONG)
def test_what_cannot_be_meant_is_refused_in_one_line(
    run: Any, tmp_path: Path, arguments: Any, text: Any
) -> None:
    code, out, err = run(*arguments)
    assert code == 2
    assert err.startswith("rig: ")
    assert text in err
    assert out == ""
    assert not list(tmp_path.iterdir())
