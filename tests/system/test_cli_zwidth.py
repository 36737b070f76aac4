"""`rig zwidth`: bounds in the table, and a map on a device."""

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

from rig.recording.reader import open_recording

BRIEF = [
    "--set", "trial.duration_s=0.3", "--set", "verdict.tail_s=0.1", "--set", "homing.settle_s=0.02",
    "--operator", "none", "--offsets", "0.1",
]  # fmt: skip
TINY = [*BRIEF, "--search", "bisection", "--ratio", "3", "--scheme", "uniform:10k", "-B", "0.1,0.3"]


def test_a_bound_is_marked(run: Any) -> None:
    code, out, _ = run("zwidth", *TINY, "-K", "10:40", "--no-plot")
    assert code == 0
    felt = next(line for line in out.splitlines() if " felt " in line)
    assert felt.count("≥") == 3  # peak, range and area; there is no column at B = 0
    assert "≥ before K" in out
    assert "≥ before B" in out


ON_DEVICE = [*TINY[:-1], "0.3", "-K", "40:200"]


def test_a_device_is_hit_by_recorded_hits_and_the_same_command_resumes(run: Any, tmp_path: Path) -> None:
    code, out, err = run("zwidth", "--url", "sim://", *ON_DEVICE, "--no-plot", "--json")
    assert code == 0, err
    facts = json.loads(out)
    assert (facts["judged"], facts["offsets"]) == ("recorded", [0.1])
    place = Path(facts["directory"])
    assert len(list((place / "hits").glob("*.parquet"))) == facts["hits"]
    assert "series 1 of 1: uniform 10 kHz, fdm-butterworth 1000 Hz, B = 0.3 N·m·s/rad" in err
    assert "hit 1: K = 40 N·m/rad" in err
    assert re.search(r"(stable|unstable|limit cycle); passes: ", err)

    code, again, err = run("zwidth", "--url", "sim://", *ON_DEVICE, "--no-plot", "--json")
    assert (code, again) == (0, out)
    assert "hit 1" not in err, "it was read"


@pytest.mark.parametrize(("answers", "hits"), [("q\n", 0), ("\nwhat?\nn\n", 1), ("\n", 1)])
def test_a_person_who_does_not_agree_ends_the_session(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answers: str, hits: int
) -> None:
    reading, writing = os.pipe()
    os.write(writing, answers.encode())
    os.close(writing)
    with open(reading) as answering:
        monkeypatch.setattr(sys, "stdin", answering)
        code, out, err = run("zwidth", "--url", "sim://", *ON_DEVICE, "--confirm", "each")
    assert (code, out) == (130, "")
    assert "ended between two hits by the operator; the effort is zero; 0 of 1 series are done" in err
    assert "Enter: continue, q: end" in err
    assert len(list(tmp_path.glob("maps/*/hits/*.parquet"))) == hits


@pytest.mark.quiet
def test_in_real_time_a_simulated_device_is_a_process(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.experiments.mapping._zwidth_rig.CALM_S", 0.0)
    search = ["--search", "bisection", "--ratio", "1.2", "-K", "30:31", "--scheme", "uniform:1k", "-B", "0.1"]
    code, _, err = run(
        "zwidth", "--realtime", *BRIEF, *search, "--set", "verdict.late_fraction=0.9", "--no-plot", "--json"
    )
    assert code == 0, err
    recording = open_recording(next(tmp_path.glob("maps/*/hits/*.parquet")))
    assert recording.header["clocks"]["kind"] == "monotonic"
    assert recording.header["identity"]["url"].startswith("unix://")
    assert recording.header["identity"]["simulated"]
