"""`rig theory` as a person meets it: numbers, bounds, picture, JSON; and without the simulation on the machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

import rig.cli
from rig import theory


@pytest.fixture
def run(capfd, tmp_path, monkeypatch):
    """Run a command line in an empty directory: exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        code = rig.cli.run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return call


def test_it_prints_limits_and_what_binds_and_draws_a_picture(run, tmp_path):
    code, out, _ = run("theory", "--rig", "koul-compliant")
    assert code == 0
    for text in (
        "koul-compliant, no hand", "dual 20/2 kHz", "uniform 20 kHz", "uniform 2 kHz", "K_max at B = 0 ",
        "K_max at B = 0.5", "(binds)", "islands up to", "0.479", "necessary", "Hz there",
    ):  # fmt: skip
        assert text in out
    picture = tmp_path / "theory-koul-compliant.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 20_000


def test_json_is_the_result_of_the_function(run, tmp_path):
    code, out, _ = run(
        "theory", "--json", "--scheme", "dual:20k/2k", "--scheme", "uniform:20k,estimator=kalman",
        "--operator", "firm", "--damping", "2", "-o", tmp_path / "new" / "place",
    )  # fmt: skip
    assert code == 0
    facts = json.loads(out)
    assert (tmp_path / "new" / "place" / "theory-koul-compliant.png").exists()
    assert facts["operator"] == "firm"
    assert facts["damping"] == 2.0
    first, second = facts["schemes"]
    assert second["scheme"] == "uniform:20k,estimator=kalman"
    exact = theory.k_max("koul-compliant", "dual:20k/2k", 2.0, operator="firm")
    assert first["at_wall"]["limit"]["stiffness"] == pytest.approx(exact.stiffness, rel=1e-6)
    assert first["at_zero"]["binding"]
    assert len(first["curve"]) >= 41


def test_a_linear_rig_has_its_units_and_no_picture_is_drawn_unless_wanted(run, tmp_path):
    code, out, _ = run("theory", "--rig", "chawda-linear", "--no-plot", "--set", "wall.damping=0")
    assert code == 0
    assert "N/m" in out
    assert "N·m" not in out
    assert out.count("K_max at") == 1
    assert not list(tmp_path.iterdir())


def test_a_file_and_its_own_scheme(run, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('preset = "koul-rigid"\n[controller]\nposition_rate = 4000\nvelocity_rate = 4000\n')
    code, out, _ = run("theory", file, "--no-plot", "--json")
    assert code == 0
    (only,) = json.loads(out)["schemes"]
    assert only["label"].startswith("uniform 4 kHz")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--scheme", "uniform:20k,estimator=levant"), "levant is not linear"),
        (("--scheme", "triple:1k"), "triple"),
        (("--operator", "iron"), "no grip 'iron'"),
        (("--rig", "koul-complaint"), "koul-compliant"),
    ],
)
def test_what_cannot_be_meant_is_one_line_with_a_remedy(run, arguments, message):
    code, _, err = run("theory", "--no-plot", *arguments)
    assert code == 2
    assert message in err
    assert err.strip().splitlines()[-1].startswith("rig: ")


def test_it_needs_no_simulation(tmp_path):
    """Where sim_backend is not installed. (Plain Python kernels: another set of files would compile anew.)"""
    script = (
        "import sys\n"
        "sys.modules['sim_backend'] = None\n"
        "from rig import theory\n"
        "found = theory.theory_of('koul-rigid', ['dual:20k/2k'], operator='normal')\n"
        "assert found.schemes[0].at_zero.limit.stiffness > 0.0\n"
        "print([m for m in sys.modules if m.startswith('sim_backend.')])\n"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "HAPTIC_RIG_CACHE": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env=environment,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
