"""`rig estimators` as a person meets it: the list, a comparison with its picture, a tuned fragment that runs."""

import json
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig.cli
from rig import config
from rig.control import estimators
from tests.firmware.build import compile_c

HIT = [
    "--duration",
    "0.25",
    "--set",
    "verdict.tail_s=0.1",
    "--set",
    "trial.release_s=0.02",
    "--no-plot",
    "--json",
]


@pytest.fixture
def recording(run: Any, tmp_path: Path) -> Any:
    code, _, _ = run("hit", *HIT)
    assert code == 0
    (path,) = tmp_path.glob("recordings/*.parquet")
    return path


def test_list_shows_every_estimator_with_its_parameters_delay_and_source(run: Any) -> None:
    code, out, _ = run("estimators", "list")
    assert code == 0
    for name in estimators.names():
        each = estimators.get(name)
        assert f"{name}: {each.summary}" in out
        assert each.source in out
        for setting in each.settings:
            assert setting.name in out
            assert setting.meaning in out
    assert "200 Hz   (0.1 to 1e+06) -3 dB frequency" in out
    assert "1.338 ms at 2000 Hz" in out


def test_compare_takes_variants_signals_and_json(run: Any, tmp_path: Path) -> None:
    code, out, _ = run(
        "estimators", "compare", "--json", "--signal", "sine", "--signal", "slow-reversal", "--rate", "2k",
        "--estimator", "fdm-butterworth:cutoff_hz=100,order=1", "--estimator", "fdm", "-o", "sines.png",
    )  # fmt: skip
    assert code == 0
    facts = json.loads(out)
    assert [(s["case"], s["estimator"]) for s in facts["scores"]] == [
        (signal, name) for signal in ("sine", "slow-reversal") for name in ("fdm-butterworth", "fdm")
    ]
    assert facts["scores"][0]["settings"] == {"cutoff_hz": 100.0, "order": 1.0}
    assert facts["scores"][0]["ns_per_sample"] > 0.0
    assert (tmp_path / facts["picture"]).stat().st_size > 20_000


def test_compare_judges_a_recording_against_its_truth(run: Any, recording: Any, tmp_path: Path) -> None:
    code, out, _ = run("estimators", "compare", recording, "--json", "--no-plot", "--no-time")
    assert code == 0
    facts = json.loads(out)
    (case,) = facts["cases"]
    assert case["reference"] == "the simulation's truth"
    assert (case["motion"], case["rate_hz"]) == ("rotary", 2000.0)
    scores = {s["estimator"]: s for s in facts["scores"]}
    assert scores["fdm-butterworth"]["delay_s"] == pytest.approx(1.3e-3, rel=0.25)
    assert not list(tmp_path.glob("*.png"))
    code, out, _ = run(
        "estimators", "compare", recording, "--rate", "20k", "--estimator", "fdm", "-o", "one.png"
    )
    assert code == 0
    assert "rad/s" in out
    assert (tmp_path / "one.png").exists()


def test_tune_writes_a_fragment_that_an_experiment_can_use(run: Any, recording: Any, tmp_path: Path) -> None:
    code, out, _ = run("estimators", "tune", "fdm-butterworth", recording, "--objective", "rms+delay")
    assert code == 0
    for words in ("within 10 %", "before", "after", "fdm-butterworth-tuned.toml"):
        assert words in out
    text = (tmp_path / "fdm-butterworth-tuned.toml").read_text(encoding="utf-8")
    tuned = tomllib.loads(text)["controller"]["parameters"]
    (tmp_path / "mine.toml").write_text(f'preset = "koul-compliant"\n{text}', encoding="utf-8")
    assert config.load_experiment(tmp_path / "mine.toml").controller.parameters == tuned
    code, _, err = run("estimators", "tune", "fdm-butterworth", recording)
    assert code == 2
    assert "exists" in err
    code, out, _ = run(
        "estimators", "tune", "fdm-butterworth", "--overwrite", "--json", "--free", "cutoff_hz"
    )
    found = json.loads(out)
    assert code == 0
    assert found["case"] == "wall-bounce"
    (within,) = found["ranges"]
    assert within["low"] <= within["value"] == found["settings"]["cutoff_hz"] <= within["high"]
    assert np.isfinite(found["objective_best"])
    assert found["objective_best"] <= found["objective_start"]


def test_an_estimator_is_exported_with_the_recording_it_was_tuned_on(run: Any, tmp_path: Path) -> None:
    wall = ("--estimator", "kalman", "--set", "controller.parameters.gain=steady")
    recorded = json.loads(run("hit", "--rig", "koul-rigid", *HIT, *wall)[1])["hits"][0]["recording"]
    code, out, err = run("estimators", "export", "kalman", recorded, "--no-costs", "--json")
    assert code == 0, err
    made = json.loads(out)
    assert made["settings"] == {"gain": "steady"}
    assert (made["rig"], made["unit"]) == ("koul-rigid", "rad/s")
    assert Path(recorded).stem in made["motion"]
    program = compile_c(tmp_path / "tried", [tmp_path / made["test"]], [])
    done = subprocess.run([program], capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 0, done.stdout
    code, _, err = run("estimators", "export", "kalman:gain=steady", "--no-costs")
    assert (code, "kalman.h" in err) == (9, True)
    code, _, err = run("estimators", "export", "period", "--rig", "koul-rigid")
    assert (code, "cannot be exported as C" in err) == (2, True)


def test_the_lipschitz_constant_of_a_recorded_hit_can_be_put_into_levant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    quick = ["--duration", "0.3", "--set", "verdict.tail_s=0.1"]
    assert rig.cli.run(["hit", "--rig", "chawda-linear", "--no-plot", "--json", *quick]) == 0
    (hit,) = json.loads(capfd.readouterr().out)["hits"]
    assert rig.cli.run(["estimators", "lipschitz", hit["recording"], "--json"]) == 0
    fit = json.loads(capfd.readouterr().out)
    assert 60.0 < fit["lipschitz"] < 100.0, "an impact at 0.4 m/s on 20 kN/m: 80 m/s²"
    assert fit["lipschitz_with_one_more_sine"] == pytest.approx(fit["lipschitz"], rel=0.1)
    given = ["--estimator", "levant", "--set", f"controller.parameters.lipschitz={fit['lipschitz']}"]
    assert rig.cli.run(["recording", "replay", hit["recording"], "--json", *given]) == 0
    assert json.loads(capfd.readouterr().out)["estimator"] == "levant"
