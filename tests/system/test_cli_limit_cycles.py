"""`rig theory limit-cycles` as a person meets it: errors, a table of walls, JSON, and what is refused."""

import json
from typing import Any

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

WALL = ["theory", "limit-cycles", "--scheme", "uniform:20k", "-K", "400", "-B", "0.6"]


def test_it_prints_errors_and_walls_and_json_has_both(run: Any) -> None:
    code, out, err = run(*WALL)
    assert code == 0, err
    heading, free, rubbed, head, *walls = out.splitlines()
    assert heading == "limit cycles of the quantum on koul-compliant, predicted and simulated"
    assert free.startswith("  without friction  1 sinusoids: amplitude ")
    assert rubbed.startswith("  with friction     1 sinusoids: amplitude ")
    assert head.split()[:3] == ["scheme", "B", "K"]
    assert len(walls) == 2
    code, out, _ = run(*WALL, "--json")
    facts = json.loads(out)
    assert [wall["friction"] for wall in facts["walls"]] == [False, True]
    assert facts["tallies"][0]["sinusoids"]["walls"] == 1
    assert facts["walls"][0]["amplitude_error"] == pytest.approx(
        facts["tallies"][0]["sinusoids"]["amplitude"][0], abs=0.2
    )


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["-K", "10"], "give --stiffness and --damping, or neither"),
        (["-K", "0", "-B", "1"], "choose a stiffness above zero"),
        (["-K", "x", "-B", "1"], "--stiffness 'x' is not a list of numbers"),
        (["--scheme", "uniform:20k,estimator=levant"], "is not linear"),
    ],
)
def test_what_cannot_be_predicted_is_refused(run: Any, arguments: list[str], text: str) -> None:
    code, out, err = run("theory", "limit-cycles", *arguments)
    assert (code, out) == (2, "")
    assert text in err
