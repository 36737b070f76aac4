"""`rig session new` and `rig session check`: protocol files from templates, and messages about wrong ones."""

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
step = 100
"""


def test_a_new_protocol_is_written_once_and_passes(run: Any, tmp_path: Path) -> None:
    code, out, err = run("session", "new", "study.toml", "--template", "compare-schemes")
    assert code == 0, err
    assert "rig session check study.toml" in out
    text = (tmp_path / "study.toml").read_text()
    assert run("session", "new", "study.toml", "--template", "koul-fig6")[0] == 9
    assert (tmp_path / "study.toml").read_text() == text
    code, out, err = run("session", "check", "study.toml", "--participants", "3", "--unblind", "--json")
    assert code == 0, err
    plan = json.loads(out)
    assert plan["ok"]
    assert len(plan["orders"]) == 3
    assert {cell["condition"] for cell in plan["cells"]} == {"uniform 20 kHz", "dual-rate 20/2 kHz"}


@pytest.mark.parametrize("blind", first_by_default(["both", "none", "operator", "participant"], 2))
def test_the_plan_hides_the_order_from_a_blinded_operator(run: Any, tmp_path: Path, blind: str) -> None:
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
    plan = json.loads(run("session", "check", "study.toml", "--json")[1])
    assert (plan["orders"] is None) == hidden


def test_a_refused_rule_is_printed_and_ends_with_an_error(run: Any, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(PLAN + "[stop]\ntrials = 2\n")
    code, out, err = run("session", "check", "study.toml")
    assert code == 2
    assert "no stop.trials" in out
    assert "refused by the checks stop.trials" in err
