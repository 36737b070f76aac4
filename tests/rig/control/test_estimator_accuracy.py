"""No estimator becomes less accurate than the stored table without a failing test; the guide shows that table."""

import math
from typing import Any

import pytest

from rig.experiments.estimation.estimators import Variant, score
from tests.conformance import estimator_accuracy as accuracy
from tests.conformance.tiers import first_by_default

MARGIN = 0.05  # what a compiler or another order of sums may change on a chaotic estimator, and no more
SMALLEST = 1e-3  # of the motion's rms speed: below that, noise at rest and errors are equal to none
DELAY_MARGIN_S = 5e-6

TABLE = accuracy.read_table()
ROWS = {name: [r for r in TABLE["rows"] if r["estimator"] == name] for name in accuracy.scored()}


def differences(row: accuracy.Row) -> list[str]:
    """Return a text for each number of a row that has changed."""
    case = accuracy.case_of(row["case"], row["rate_hz"], row["resolution"])
    now = score(case, Variant(row["estimator"], row["settings"]))
    case_text = f"{row['case']} at {row['rate_hz']:g} Hz, {row['resolution']:g} a count"
    where = f"{row['estimator']} on {case_text}, {row['settings'] or 'defaults'}"
    if row.get("refused") or now.refused:
        return [] if row.get("refused") and now.refused else [f"{where}: {now.refused or 'realisable now'}"]
    changed = []
    for number in accuracy.NUMBERS:
        then, found = math.nan if row[number] is None else abs(row[number]), abs(getattr(now, number))
        least = DELAY_MARGIN_S if number == "delay_s" else SMALLEST * MARGIN * case.speed_rms
        if abs(found - then) > MARGIN * then + least or math.isnan(found) != math.isnan(then):
            changed.append(f"{where}: {number} {found:.4g}, in the table {then:.4g}")
    return changed


GRID = sorted(accuracy.grid(), key=lambda case: case[1])
FAST_CASES = sum(rate_hz <= 1000 for _, rate_hz, _ in GRID)


@pytest.mark.parametrize(("signal", "rate_hz", "resolution"), first_by_default(GRID, FAST_CASES))
def test_estimators_are_as_good_as_the_table_says(signal: str, rate_hz: int, resolution: float) -> None:
    """All estimators run on one case of up to 20 MB; cases cached per estimator took 260 MB."""
    key = (signal, rate_hz, resolution)
    rows = [row for row in TABLE["rows"] if (row["case"], row["rate_hz"], row["resolution"]) == key]
    changed = [text for row in rows for text in differences(row)]
    assert not changed, "\n".join([f"if that is meant, {accuracy.REGENERATE} ESTIMATOR", *changed])


@pytest.mark.parametrize("name", accuracy.scored())
def test_the_table_holds_every_case_of_the_grid(name: Any) -> None:
    """Review new rows before you commit them."""
    found = {(r["case"], r["rate_hz"], r["resolution"]) for r in ROWS[name] if r["tuned"] is None}
    assert found == set(accuracy.grid()), f"run {accuracy.REGENERATE} {name}"


def test_the_guide_shows_the_committed_table() -> None:
    assert accuracy.main(["--check"]) == 0, f"run {accuracy.REGENERATE} --guide"
    text = accuracy.GUIDE.read_text(encoding="utf-8")
    assert {text.count(f"<!-- generated: {section} -->") for section in accuracy.SECTIONS} == {1}
