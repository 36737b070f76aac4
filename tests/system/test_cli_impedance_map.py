"""`rig impedance map` as a person meets it: tables, JSON, pictures, going on, and what cannot be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

SMALL = (
    "impedance", "map", "-K", "5000,10000,400000", "-B", "60,120", "--realisations", "2",
    "--periods", "2", "--set", "excitation.settle_periods=1",
)  # fmt: skip
FDM = ("--scheme", "uniform:1k,estimator=fdm-butterworth,cutoff_hz=499")


def test_the_papers_four_estimators_stand_beside_the_paper(run: Any, tmp_path: Path) -> None:
    code, out, _ = run(*SMALL)
    assert code == 0
    for text in (
        "chawda-linear: passive from 1 to 250 Hz", "1 fdm-butterworth", "2 foaw-best", "3 kalman", "4 levant",
        "tuned: alpha, lambda", "all together", "each of 2", "paper, on its rig", "894.9", "fidelity at",
        "boundary search", "K 5000, B 60", "takes no part",
    ):  # fmt: skip
        assert text in out
    (place,) = (tmp_path / "maps").iterdir()
    assert place.name.startswith("impedance-map-chawda-linear-")
    files = {file.name for file in place.iterdir()}
    assert files == {"plan.json", "journal", "walls.parquet", "map.json", "impedance-map.png"}
    assert (place / "impedance-map.png").stat().st_size > 30_000


def test_json_is_one_document_and_the_same_command_reads_it_again(run: Any) -> None:
    arguments = (
        *SMALL,
        *FDM,
        "--json",
        "--no-plot",
        "--judged-band",
        "2:200",
        "--seed",
        "3",
        "--z-score",
        "3",
        "--effective-hz",
        "10",
        "-o",
        "here",
    )
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


def test_dual_rate_on_another_rig(run: Any) -> None:
    code, out, _ = run(
        "impedance", "map", "--rig", "koul-rigid", "--scheme", "dual:20k/2k,estimator=kalman",
        "-K", "5,10", "-B", "0", "--realisations", "1", "--periods", "1", "--set", "excitation.settle_periods=1",
        "--band", "5:200", "--judge", "true", "--amplitude", "0.05", "--no-plot",
    )  # fmt: skip
    assert code == 0
    assert "K in N·m/rad" in out
    assert "dual 20/2 kHz, kalman" in out
    assert "paper" not in out
    assert "one realisation" in out


@pytest.mark.parametrize(
    ("arguments", "message", "remedy"),
    [
        (("--band", "250:1"), "--band 250:1 is not a frequency band", "1:250"),
        (("--judged-band", "many"), "--judged-band many is not a frequency band", "1:250"),
        (("--judged-band", "300:400"), "no line lies between 300 and 400 Hz", "1 to 250"),
        (("-K", "10:100"), "--stiffness '10:100'", "first:last:count"),
        (("-K", "100,10"), "not in rising order", "lowest first"),
        (("--damping=-3",), "-3 is out of range", "at least 0"),
        (("--amplitude", "90"), "peak position", "reduce the excitation"),
        (("--amplitude", "500"), "rig.limits.effort, 100 N", "lower excitation.rms"),
        (("--realisations", "0"), "realisations", "1"),
        (("--scheme", "uniform:1k,estimator=levan"), "levan", "levant"),
        (("--rig", "chawda"), "chawda", "chawda-linear"),
        (("--workers", "2", "--scheduler", "tcp://127.0.0.1:1"), "scheduler", "either"),
    ],
)
def test_what_cannot_be_is_one_line_with_a_remedy(
    run: Any, arguments: tuple[str, ...], message: str, remedy: str
) -> None:
    code, out, err = run("impedance", "map", "--no-plot", *arguments)
    assert code not in (0, 70)
    assert out == ""
    assert message in err
    assert remedy in err
    assert err.strip().splitlines()[-1].startswith("rig: ")
