"""`rig impedance measure` and `map`: JSON, a measurement on a device, and a stored map that is read again."""

import json
from pathlib import Path
from typing import Any

import pytest

SHORT = ("--periods", "2", "--realisations", "2", "--set", "excitation.settle_periods=1")


def test_json_is_one_document_with_every_line(run: Any) -> None:
    code, out, _ = run(
        "impedance", "measure", "--json", "--no-plot", *SHORT, "-K", "5000,10000", "-B", "20", "--band", "2:100",
        "--judged-band", "5:50", "--effective-hz", "12",
        "--scheme", "uniform:1k,estimator=kalman", "--scheme", "uniform:1k,estimator=levant", "--amplitude", "1.5",
        "--judge", "true", "-o", "here",
    )  # fmt: skip
    assert code == 0
    facts = json.loads(out)
    assert facts["picture"] is None
    assert Path(facts["table"]).exists()
    assert [(r["stiffness"], r["damping"]) for r in facts["results"]] == [(5000.0, 20.0), (10000.0, 20.0)] * 2
    first = facts["results"][0]
    assert first["scheme"].startswith("uniform:1k,estimator=kalman")
    assert first["excitation"]["rms"] == 1.5
    assert (first["excitation"]["low_hz"], first["excitation"]["high_hz"]) == (2.0, 100.0)
    assert first["impedance"]["lines_hz"] == [float(f) for f in range(2, 101)]
    assert first["impedance"]["realisations"] == 2
    assert first["judgement"]["passivity"]["band_hz"] == [5.0, 50.0]
    assert first["fidelity"]["band_hz"] == [5.0, 50.0]
    assert first["fidelity"]["effective_band_hz"] == [5.0, 12.0]


def test_the_exit_code_reports_whether_the_rig_is_passive(run: Any) -> None:
    bare = ("impedance", "measure", "--bare", "--no-plot", *SHORT)
    assert run(*bare, "-q", "--expect", "passive") == (0, "", "")
    code, out, err = run(*bare, "--expect", "not-passive")
    assert code == 17
    assert "every line" in out
    assert "is passive, expected not-passive; look at the frequencies of this wall in the table" in err


@pytest.mark.exhaustive("tests/system/test_commands.py::test_a_good_run_ends_with_0_as_json_and_as_text")
def test_over_the_link_the_rigs_motor_excites_and_every_run_is_recorded(run: Any, tmp_path: Path) -> None:
    code, out, _ = run("impedance", "measure", "--url", "sim://", *SHORT, "-K", "10000", "-B", "20")
    assert code == 0
    assert "K = 10000 N/m" in out
    (place,) = (tmp_path / "impedances").iterdir()
    recordings = [file for file in place.glob("*.parquet") if file.name != "impedance.parquet"]
    assert len(recordings) == 2
    summary = json.loads((place / "impedance.json").read_text())["results"][0]
    assert summary["excitation"]["channel"] == "motor"
    assert sorted(summary["recordings"]) == sorted(str(file.relative_to(tmp_path)) for file in recordings)


def test_a_wall_that_ends_every_run_gives_an_exit_code(run: Any) -> None:
    code, out, err = run(
        "impedance", "measure", "-K", "200000", "-B", "0", "--set", "rig.limits.speed=0.2", "--no-plot"
    )
    assert code != 0
    assert "ended" in out
    assert "estimated speed" in out
    assert "softer wall" in err


SMALL = (
    "impedance", "map", "-K", "5000,10000,400000", "-B", "60,120", "--realisations", "2",
    "--periods", "2", "--set", "excitation.settle_periods=1",
)  # fmt: skip
FDM = ("--scheme", "uniform:1k,estimator=fdm-butterworth,cutoff_hz=499")


def test_a_map_is_one_document_and_the_same_command_reads_it_again(run: Any) -> None:
    more = "--json --no-plot --judged-band 2:200 --seed 3 --z-score 3 --effective-hz 10 -o here"
    arguments = (*SMALL, *FDM, *more.split())
    code, out, _ = run(*arguments)
    assert code == 0
    facts = json.loads(out)
    assert facts["picture"] is None
    assert Path(facts["directory"], "walls.parquet").exists()
    assert facts["stiffnesses"] == [5e3, 1e4, 4e5]
    judging = {"band_hz": [2.0, 200.0], "z_score": 3.0, "residual_threshold": 0.1, "effective_hz": 10.0}
    assert facts["judging"] == judging
    assert facts["excitation"]["seed"] == 3
    (row,) = facts["table_one"]["rows"]
    assert row["paper"]["stiffness"] == 24000.0
    assert row["widths"]["together"]["stiffness"] == 1e4
    assert row["widths"]["stiffness"]["count"] == 2
    assert row["search"]["of"] == 6
    assert facts["passive"] == [[[True, True, False], [True, True, False]]]
    journal = Path(facts["directory"], "journal")
    before = journal.read_bytes()
    assert json.loads(run(*arguments)[1]) == facts
    assert journal.read_bytes() == before
