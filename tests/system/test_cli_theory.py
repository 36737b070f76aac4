"""`rig theory walls`: stability limits, passivity bounds, picture, JSON."""

import json
from pathlib import Path
from typing import Any

import pytest

from rig.analysis import theory
from rig.analysis.theory import _summary as summary

pytestmark = pytest.mark.usefixtures("few_curve_points")


def test_an_automated_trial_names_the_limit_in_a_normal_hand(run: Any) -> None:
    """K_max at B = 0 is 30 N·m/rad with the end mass of an automated trial, 519 in the normal hand of a map."""
    code, out, _ = run("theory", "walls", "--rig", "koul-compliant", "--no-plot", "--scheme", "dual:20k/2k")
    assert code == 0
    (line,) = (line for line in out.splitlines() if "--operator normal" in line)
    held = theory.k_max("koul-compliant", "dual:20k/2k", operator="normal").stiffness
    assert "in a normal hand" in line
    assert f"{held:.4g}" in line
    for more in (("--operator", "normal"), ("--operator", "none"), ("--set", "trial.kind=human")):
        code, out, _ = run("theory", "walls", "--no-plot", "--scheme", "uniform:20k", *more)
        assert code == 0
        assert "--operator normal" not in out
    assert "normal hand (the bounds do not include it)" in out


def test_rates_are_compared_with_the_same_filter_if_asked_and_a_difference_is_printed(run: Any) -> None:
    """Koul et al. filter at a tenth of the velocity rate; K_max at B = 0.5 is then 3360, else 589 N·m/rad."""
    asked = (
        "theory",
        "walls",
        *["--rig", "koul-rigid", "--no-plot", "--scheme", "uniform:20k", "-B", "0.5", "--json"],
    )
    found = {}
    for cutoff in ("as-in-the-paper", "same"):
        code, out, _ = run(*asked, "--cutoff", cutoff)
        assert code == 0
        found[cutoff] = json.loads(out)
    stated = theory.k_max("koul-rigid", "uniform:20k,cutoff_hz=200", 0.5).stiffness
    assert found["same"]["schemes"][0]["at_wall"]["limit"]["stiffness"] == pytest.approx(stated, rel=1e-12)
    assert "2000 Hz at 20 kHz" in found["as-in-the-paper"]["cutoffs"]
    assert found["same"]["cutoffs"] is None
    code, out, _ = run(*asked[:-1])
    assert found["as-in-the-paper"]["cutoffs"] in out


@pytest.mark.usefixtures("undrawn")
def test_schemes_that_are_not_linear_are_a_line_beside_those_that_are(run: Any, tmp_path: Path) -> None:
    schemes = (
        "dual:20k/2k,estimator=levant",
        "uniform:20k",
        "dual:20k/2k,slow_velocity_rate=500,slow_below=0.1",
    )
    arguments = [text for scheme in schemes for text in ("--scheme", scheme)]
    code, out, _ = run("theory", "walls", *arguments)
    assert code == 0
    assert "uniform 20 kHz" in out
    assert "levant: not linear: " in out
    assert "500 Hz below 0.1: not linear: " in out
    assert (tmp_path / "theory-koul-compliant.png").exists()
    code, out, _ = run("theory", "walls", "--json", "--no-plot", *arguments)
    facts = json.loads(out)
    assert [scheme["scheme"] for scheme in facts["schemes"]] == ["uniform:20k"]
    assert [refused["scheme"] for refused in facts["not_linear"]] == [schemes[0], schemes[2]]
    assert all(refused["reason"] for refused in facts["not_linear"])
    code, _, err = run("theory", "walls", "--no-plot", "--scheme", schemes[0], "--scheme", schemes[2])
    assert code == 2
    assert "not linear" in err


def test_a_delay_is_given_in_ticks_and_for_each_scheme(run: Any) -> None:
    late = ("--no-plot", "--set", "rig.simulation.computation_delay_ticks=2", "--rig", "koul-rigid")
    code, out, _ = run("theory", "walls", *late, "--scheme", "uniform:20k")
    assert code == 0
    assert "delay 2 ticks;" in out.splitlines()[0]
    code, out, _ = run("theory", "walls", *late, "--json")
    facts = json.loads(out)
    assert facts["delay_ticks"] == 2
    assert [scheme["delay_s"] for scheme in facts["schemes"]] == pytest.approx([1e-4, 1e-4, 1e-3])


@pytest.mark.usefixtures("undrawn")
def test_json_is_the_result_of_the_function(run: Any, tmp_path: Path) -> None:
    code, out, _ = run(
        "theory", "walls", "--json", "--scheme", "dual:20k/2k", "--scheme", "uniform:20k,estimator=kalman",
        "--operator", "firm", "--damping", "2", "-o", tmp_path / "new" / "place", "--format", "pdf",
    )  # fmt: skip
    assert code == 0
    facts = json.loads(out)
    assert facts["picture"] == str(tmp_path / "new" / "place" / "theory-koul-compliant.pdf")
    assert Path(facts["picture"]).exists()
    assert facts["operator"] == "firm"
    assert facts["damping"] == 2.0
    first, second = facts["schemes"]
    assert second["scheme"] == "uniform:20k,estimator=kalman"
    exact = theory.k_max("koul-compliant", "dual:20k/2k", 2.0, operator="firm")
    assert first["at_wall"]["limit"]["stiffness"] == pytest.approx(exact.stiffness, rel=1e-6)
    assert first["at_zero"]["binding"]
    assert len(first["curve"]) >= summary.CURVE_POINTS
