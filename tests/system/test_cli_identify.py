"""`rig identify`: parameters with confidence intervals, an experiment file that `rig hit` accepts, and a plan."""

import json
from pathlib import Path
from typing import Any

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)


@pytest.mark.exhaustive("tests/system/test_commands.py::test_a_good_run_ends_with_0_as_json_and_as_text")
def test_the_file_can_be_hit_and_identified_again(run: Any, tmp_path: Path) -> None:
    assert run("identify", "--rig", "chawda-linear", "--realisations", 2, "-o", "a.toml", "--no-plot")[0] == 0
    assert run("experiment", "plan", "a.toml")[0] == 0
    code, out, _ = run("identify", "a.toml", "--realisations", 2, "--no-plot", "--json")
    assert code == 0
    found = json.loads(out)
    mass = found["dynamics"]["inertia"]
    assert mass["value"] == pytest.approx(0.52, rel=0.01)
    assert 0.0 < mass["ci95"] < 0.05
    assert found["signs"]["ok"]
    assert found["plan"]["ok"]
    assert found["picture"] is None
    assert found["dynamics"]["coherence_median"] > 0.9
    assert set(found["recordings"]) == {"signs", "sliding", "dynamics"}
    assert not list((tmp_path / "recordings").glob("*.png"))
