"""`rig session new`, `check` and `schema` as a person meets them."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.conformance.tiers import first_by_default

PLAN = """
[study]
title = "Short"
preset = "koul-compliant"
participants = 4
changes."operator.press" = 1.5
changes."trial.minimum_rest_counts" = 1.0
[[condition]]
name = "uniform"
scheme = "uniform:20k"
[[condition]]
name = "dual"
scheme = "dual:20k/2k"
[search]
lowest = 200
highest = 600
step = 50
"""


def test_a_new_protocol_is_written_once_and_passes(run: Any, tmp_path: Path) -> None:
    code, out, err = run("session", "new", "study.toml", "--template", "compare-schemes")
    assert code == 0, err
    assert "rig session check study.toml" in out
    text = (tmp_path / "study.toml").read_text()
    code, _, err = run("session", "new", "study.toml", "--template", "koul-fig6")
    assert code == 9
    assert "study.toml" in err
    assert "exist" in err
    assert (tmp_path / "study.toml").read_text() == text
    code, out, err = run("session", "check", "study.toml", "--participants", "3", "--unblind", "--json")
    assert code == 0, err
    plan = json.loads(out)
    assert plan["ok"]
    assert len(plan["orders"]) == 3
    assert {cell["condition"] for cell in plan["cells"]} == {"uniform 20 kHz", "dual-rate 20/2 kHz"}


def test_templates_are_listed_and_an_unknown_one_is_refused(run: Any, tmp_path: Path) -> None:
    code, out, _ = run("session", "new", "--list")
    assert code == 0
    assert out.split()[0] == "brown-factorial"
    assert json.loads(run("session", "new", "--list", "--json")[1]).keys() >= {"koul-fig6"}
    code, _, err = run("session", "new", "--template", "koul-fig5")
    assert code == 2
    assert "did you mean koul-fig6" in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("blind", first_by_default(["both", "none", "operator", "participant"], 2))
def test_a_blinded_operator_who_checks_the_plan_learns_no_order(run: Any, tmp_path: Path, blind: str) -> None:
    """Whose turn is which condition's is what the console hides."""
    (tmp_path / "study.toml").write_text(
        PLAN.replace("participants = 4", f'participants = 4\nblind = "{blind}"')
    )
    hidden = blind in ("both", "operator")
    _, out, _ = run("session", "check", "study.toml")
    assert ("A: " in out, "participant   blocks" in out) == (not hidden, not hidden)
    assert (
        "The person who plans the study and never operates a session can show it with --unblind" in out
    ) == hidden
    _, unblinded, _ = run("session", "check", "study.toml", "--unblind")
    assert "A: " in unblinded
    told = json.loads(run("session", "check", "study.toml", "--json")[1])
    assert (told["orders"] is None) == hidden


def test_what_is_refused_is_printed_and_ends_with_an_error(run: Any, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(PLAN + "[stop]\ntrials = 2\n")
    code, out, err = run("session", "check", "study.toml")
    assert code == 2
    assert "no stop.trials" in out
    assert "refused: stop.trials" in err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "[study]: is missing"),
        ("[study", "not valid TOML"),
        (PLAN.replace("dual:20k/2k", "dual:20k/3k"), 'condition 2, "dual"'),
        (PLAN.replace("step", "stepp"), "did you mean step?"),
    ],
)
def test_a_bad_file_is_refused_in_words(run: Any, tmp_path: Path, text: Any, words: str) -> None:
    Path(tmp_path / "study.toml").write_text(text)
    code, out, err = run("session", "check", "study.toml")
    assert (code, out) == (2, "")
    assert words in err
    assert "study.toml" in err
    assert "Traceback" not in err
