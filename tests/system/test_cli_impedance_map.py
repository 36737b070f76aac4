"""`rig impedance map`: tables, JSON, pictures, and a stored map that is read again."""

import json
from pathlib import Path
from typing import Any

SMALL = (
    "impedance", "map", "-K", "5000,10000,400000", "-B", "60,120", "--realisations", "2",
    "--periods", "2", "--set", "excitation.settle_periods=1",
)  # fmt: skip
FDM = ("--scheme", "uniform:1k,estimator=fdm-butterworth,cutoff_hz=499")


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
