"""The picture of the latency ledger: any ledger can be drawn, without ticks, clocks or elapsed time."""

import itertools
from typing import Any

import numpy as np
import pytest

from rig.core.clock_fit import ClockFit
from rig.core.sample import ROW
from rig.core.shown import Picture
from rig.recording._timing_summary import summarise
from rig.recording.timing import NO_AGE, ledger
from rig.recording.timing_report import Timing
from tests.conformance.tiers import first_by_default
from tests.rig.views.conftest import check_axes

FIT = ClockFit(0, 10**12, 0.0, 10.0, 0.01, 1_000, 2_000, 0.0, 5.0, 10**9, 50, 1)


def rows_of(count: Any, *, spread: float = 1.0, seed: int = 1) -> Any:
    rows = np.zeros(count, ROW)
    number = np.arange(count)
    noise = np.random.default_rng(seed).exponential(5e4, (4, count)) * spread
    rows["tick"] = rows["sample_index"] = number
    rows["device_time"] = number * 1_000_000
    stamps = ("device_time", "received_at", "computed_at", "sent_at")
    for (before, name), wait in zip(itertools.pairwise(stamps), noise, strict=False):
        rows[name] = rows[before] + wait.astype(np.int64)
    for name in stamps[1:]:
        rows[name] += 10**12
    rows["lateness"] = noise[3]
    rows["command_sequence"] = number % 65536
    rows["command_active"] = (number - 2) % 65536
    rows["command_age"] = np.where(number < 2, NO_AGE, 1)
    return rows


def draw(rows: Any, fit: Any, name: str) -> Picture:
    found = ledger(rows, fit, 1e6)
    return Timing(found, summarise(found, None), name=name).plot()


@pytest.mark.parametrize(
    ("fit", "count", "spread"),
    first_by_default([(FIT, 0, 0.0), *itertools.product((FIT, None), (1, 2_001), (0.0, 1.0, -3.0))], 4),
)
def test_any_ledger_can_be_composed(count: int, fit: Any, spread: float) -> None:
    """No tick, one tick, no elapsed time (virtual time), or effects before causes (wrong clocks)."""
    figure = check_axes(draw(rows_of(count, spread=spread), fit, "\udcff").figure)
    assert figure._suptitle.get_text() == "\udcff"
    assert all(axes.lines or axes.patches or axes.texts for axes in figure.axes[:2]), "or it says why not"
