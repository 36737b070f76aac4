"""`rig estimators`: the list, a comparison with its picture, and tuned settings that a hit accepts."""

import json
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.control import estimators
from tests.firmware.build import compile_c

HIT = shlex.split("--duration 0.25 --set verdict.tail_s=0.1 --set trial.release_s=0.02 --no-plot --json")


@pytest.fixture
def recording(run: Any, tmp_path: Path) -> Any:
    assert run("hit", *HIT)[0] == 0
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


def test_tune_writes_a_fragment_that_an_experiment_can_use(run: Any, recording: Any, tmp_path: Path) -> None:
    code, out, _ = run("estimators", "tune", "fdm-butterworth", recording, "--objective", "rms+delay")
    assert code == 0
    for words in ("within 10 %", "before", "after", "fdm-butterworth-tuned.toml"):
        assert words in out
    text = (tmp_path / "fdm-butterworth-tuned.toml").read_text(encoding="utf-8")
    tuned = tomllib.loads(text)["controller"]["parameters"]
    (tmp_path / "mine.toml").write_text(f'preset = "koul-compliant"\n{text}', encoding="utf-8")
    assert config.load_experiment(tmp_path / "mine.toml").controller.parameters == tuned


@pytest.mark.exhaustive("tests/system/test_commands.py::test_a_good_run_ends_with_0_as_json_and_as_text")
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
