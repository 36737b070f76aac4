"""`rig compare` as a person meets it: the table, the picture, JSON, and what it refuses."""

import json
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
