"""`rig identify` as a person meets it: numbers with intervals, a file, a picture, JSON, and one line for each error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

from rig import config


def test_it_prints_parameters_and_writes_file_recordings_and_picture(run: Any, tmp_path: Path) -> None:
    code, out, _ = run("identify", "--rig", "chawda-linear", "--realisations", 2, "-o", "new/rig.toml")
    assert code == 0
    for text in (
        "a positive effort raises the position", "Coulomb friction", "up, down", "viscous damping", "N·s/m", "mass",
        "±", "delay", "mode", "coherence", "median", "recordings",
    ):  # fmt: skip
        assert text in out
    assert "--verified" not in out, "a simulated rig has nothing to verify"
    experiment = config.load_experiment(tmp_path / "new" / "rig.toml")
    assert experiment.rig.mechanics.motor_inertia == pytest.approx(0.52, rel=0.01)
    (picture,) = (tmp_path / "recordings").glob("*.png")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert len(list((tmp_path / "recordings").glob("*.parquet"))) == 4


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


def test_the_plan_touches_nothing(run: Any, tmp_path: Path) -> None:
    code, out, _ = run("identify", "--rig", "koul-rigid", "--plan")
    assert code == 0
    for text in ("pushes", "strokes", "excitation", "peak effort of the excitation", "N·m, limit 1.3"):
        assert text in out
    assert not list(tmp_path.iterdir())
    assert json.loads(run("identify", "--plan", "--json")[1])["ok"]


@pytest.mark.parametrize(
    ("arguments", "message", "code"),
    [
        (("--rig", "chawda-linaer"), "chawda-linear", 2),
        (("--realisations", "1"), "too few for an interval", 2),
        (("--period", "0.0001"), "period", 2),
        (("--set", "rig.limits.speeed=3"), "rig.limits.speeed: is not a known key", 2),
        (("--rig", "chawda-linear", "--rate", "50"), "50 Hz", 2),
        (("--url", "serial:///dev/does-not-exist"), "does-not-exist", 3),
        (("-o", "."), "is a directory", 2),
        (("--cogging", "7", "--weight", "0.5"), "more than the", 2),
        (("--cogging", "7", "--arm", "0.1"), "--weight KG with --arm M", 2),
        (("--cogging", "7"), "position zero: is where the handle happens to stand", 2),
    ],
)
def test_what_cannot_be_meant_is_one_line_with_a_remedy(
    run: Any, arguments: tuple[str, ...], message: str, code: int
) -> None:
    found, _, err = run("identify", "--no-plot", *arguments)
    assert found == code
    assert message in err
    assert err.strip().splitlines()[-1].startswith("rig: ")


def test_a_refusal_is_json_too(run: Any) -> None:
    code, out, _ = run("identify", "--json", "--no-plot", "--realisations", "1")
    assert code == 2
    assert "too few for an interval" in json.loads(out)["error"]["error"]
