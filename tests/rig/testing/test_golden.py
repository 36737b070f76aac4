"""Comparison with a golden recording tolerates rounding; other differences name row, column, value and unit."""

from dataclasses import replace

import numpy as np
import pytest

from rig.core.errors import RecordingError
from rig.recording.data import Recording
from rig.testing import Experiments, Hits
from rig.testing.golden import difference


@pytest.fixture
def golden(rig_hit: Hits, rig_experiment: Experiments) -> Recording:
    return rig_hit(rig_experiment.short()).recording


def with_column(recording: Recording, name: str, values: object) -> Recording:
    rows = recording.rows.copy()
    rows[name] = values
    return replace(recording, rows=rows)


def test_two_runs_are_the_same(golden: Recording, rig_hit: Hits, rig_experiment: Experiments) -> None:
    assert difference(golden, rig_hit(rig_experiment.short()).recording, {}) == ""


def test_rounding_in_every_tick_is_no_difference(golden: Recording) -> None:
    velocity = golden.column("velocity")
    drift = np.arange(len(velocity)) * 16 * np.spacing(np.abs(velocity).max())
    assert difference(golden, with_column(golden, "velocity", velocity + drift), {}) == ""
    message = difference(golden, with_column(golden, "velocity", velocity + 100.0 * drift), {})
    assert message.startswith("differs from the golden recording from row ")


def test_one_count_is_a_difference_unless_it_is_tolerated(golden: Recording) -> None:
    count = golden.column("count").copy()
    count[20] += 1
    today = with_column(golden, "count", count)
    first, line = difference(golden, today, {}).split("\n")
    assert first.startswith("differs from the golden recording from row 20 on (20 ms, ")
    assert line == f"  count: {count[20]} count, was {count[20] - 1} (by 1, allowed 0)"
    assert difference(golden, today, {"count": 1}) == ""
    with pytest.raises(RecordingError, match="unknown column 'counts'"):
        difference(golden, today, {"counts": 1})


def test_a_value_that_is_not_finite_is_a_difference_unless_both_have_it(golden: Recording) -> None:
    torn = golden.column("velocity").copy()
    torn[5] = np.nan
    assert "  velocity: nan rad/s, was " in difference(golden, with_column(golden, "velocity", torn), {})
    assert difference(with_column(golden, "velocity", torn), with_column(golden, "velocity", torn), {}) == ""


def test_a_run_that_ends_sooner_is_a_difference(golden: Recording) -> None:
    shorter = replace(golden, rows=golden.rows[:-3])
    rows = len(golden)
    assert difference(golden, shorter, {}) == f"{rows - 3} rows, and {rows} in the golden recording"
