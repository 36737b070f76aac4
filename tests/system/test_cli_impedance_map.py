"""`rig impedance map`: tables, JSON, pictures, and a stored map that is read again."""

import json
from pathlib import Path
from typing import Any

import pytest

SMALL = (
    "impedance", "map", "-K", "5000,10000,400000", "-B", "60,120", "--realisations", "2",
    "--periods", "2", "--set", "excitation.settle_periods=1",
)  # fmt: skip
FDM = ("--scheme", "uniform:1k,estimator=fdm-butterworth,cutoff_hz=499")


@pytest.mark.exhaustive("::test_json_is_one_document_and_the_same_command_reads_it_again")
def test_the_papers_four_estimators_stand_beside_the_paper(run: Any, tmp_path: Path) -> None:
    code, out, _ = run(*SMALL)
    assert code == 0
    for text in (
        "chawda-linear: passive from 1 to 250 Hz", "1 fdm-butterworth", "2 foaw-best", "3 kalman", "4 levant",
        "tuned: alpha, lambda", "all together", "each of 2", "paper, on its rig", "894.9", "fidelity at",
        "boundary search", "K 5000, B 60", "left out of the fidelity",
    ):  # fmt: skip
        assert text in out
    (place,) = (tmp_path / "maps").iterdir()
    assert place.name.startswith("impedance-map-chawda-linear-")
    files = {file.name for file in place.iterdir()}
    assert files == {"plan.json", "journal", "walls.parquet", "map.json", "impedance-map.png"}
    assert (place / "impedance-map.png").stat().st_size > 30_000


def test_json_is_one_document_and_the_same_command_reads_it_again(run: Any) -> None:
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
