"""Z-width in the frequency domain: the closed form on a linear rig, widths of given regions, the boundary search."""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.experiments.mapping import _maps as maps
from rig.experiments.mapping import _ranges as ranges
from rig.experiments.mapping._maps import zwidth
from rig.experiments.mapping._searches import connected, trace_grid
from rig.experiments.mapping.table_one import PAPER, FrequencyWidth, Spread, table_one
from rig.experiments.mapping.zwidth_frequency import TOGETHER, FrequencyMap
from rig.views.plots._zwidth_frequency import frequency_figure
from tests.rig.experiments.test_impedance_run import LINEAR as LINEAR_RIG
from tests.rig.views.conftest import check_axes

CHAWDA = presets.load("chawda-linear")
LINEAR = config.override(
    CHAWDA, LINEAR_RIG | {"excitation.high_hz": 250.0, "excitation.rms": 0.02, "excitation.periods": 2}
)
TWICE = {"excitation.periods": 2, "excitation.settle_periods": 1, "excitation.realisations": 2}
SHORT = config.override(CHAWDA, TWICE)
FDM, FILTERED = "uniform:1k,estimator=fdm", "uniform:1k,estimator=fdm-butterworth,cutoff_hz=499"


def plan(experiment: Any, schemes: Any, stiffnesses: Any, dampings: Any, **others: Any) -> Any:
    parsed = [Scheme.parse(text) for text in schemes]
    return ranges.frequency_plan(experiment, parsed, stiffnesses=stiffnesses, dampings=dampings, **others)


# ---------------------------------------------------------------------- closed forms on a linear rig


def test_with_damping_the_edge_is_that_of_the_closed_form() -> None:
    """At B = 40 and 80 an unfiltered difference is passive to some 32 kN/m up to 250 Hz, and stable far beyond."""
    asked = plan(LINEAR, [FDM], np.arange(26e3, 40e3, 2e3), [40.0, 80.0])
    found = zwidth(asked)
    _, stable, passive = ranges.linear_curves(asked, 2)[0]
    edges = connected(found.passive[0, -1]).sum(axis=1)
    for edge, exact in zip(edges, passive, strict=True):
        assert abs(asked.stiffnesses[edge - 1] - exact) <= 2000.0
    assert min(stable) > 2.0 * max(passive)


# ---------------------------------------------------------------------- friction


@pytest.fixture(scope="module")
def map_with_friction() -> Any:
    """Map the rig with its friction and 1 µm resolution: four estimators on a coarse grid."""
    schemes = [scheme.text for scheme in ranges.default_schemes(CHAWDA)]
    return zwidth(plan(SHORT, schemes, [5e3, 40e3, 60e3, 400e3], [60.0, 240.0]))


def test_friction_widens_what_is_passive_and_adds_damping_and_stiffness(map_with_friction: Any) -> None:
    """Friction damps: a difference is passive at 40 kN/m, where linear theory ends at 32; sticking adds stiffness."""
    _, _, passive = ranges.linear_curves(map_with_friction.plan, 2)[0]
    assert max(passive) < 35e3
    assert map_with_friction.passive[0, -1, 1, :3].all()
    soft = next(row for row in map_with_friction.columns[0] if row["realisation"] == TOGETHER)
    assert soft["damping_percent"] > 110.0
    assert 101.0 < soft["stiffness_percent"] < 120.0


def test_table_one_stands_beside_the_papers(map_with_friction: Any) -> None:
    table = table_one(map_with_friction)
    assert [row.estimator for row in table.rows] == list(ranges.PAPERS_ESTIMATORS)
    assert [len(row.tuned) for row in table.rows] == [1, 0, 1, 2]
    first = table.rows[0]
    assert first.paper == PAPER["fdm-butterworth"]
    assert first.widths.stiffness.count == len(first.widths.each) == 2
    assert len(first.common) == len(table.points)
    # The printed gains of Levant's differentiator hold least.
    cells = connected(map_with_friction.passive[:, -1]).sum(axis=(1, 2))
    assert cells[3] < cells[:3].min()
    assert 3 not in table.comparable
    assert math.isnan(table.rows[3].widths.together.damping)
    k, b = table.points[0]
    at = map_with_friction.plan.dampings.index(b), map_with_friction.plan.stiffnesses.index(k)
    assert first.common[0].mean == pytest.approx(map_with_friction.fidelity[(0, slice(0, 2), *at)].mean())
    json.dumps(plain(table), allow_nan=False)


def test_a_wall_that_throws_the_handle_out_has_time_and_reason() -> None:
    tight = config.override(SHORT, {"rig.limits.speed": 0.3, "excitation.realisations": 1})
    found = zwidth(plan(tight, [FDM], [5e3, 2e6], [100.0]))
    soft, _, hard, _ = found.columns[0]
    assert soft["ended_s"] is None
    assert (hard["passive"], hard["fidelity"], 0.0 < hard["ended_s"] < 3.0) == (False, None, True)
    assert "limit" in hard["reason"] or "window" in hard["reason"]


def test_dual_rate_goes_through_the_same_plan() -> None:
    """On a two-mass rig the handle's true motion is measured, because the encoder is on the other mass."""
    once = dict.fromkeys(("excitation.periods", "excitation.settle_periods", "excitation.realisations"), 1)
    koul = config.override(presets.load("koul-compliant"), {**once, "excitation.low_hz": 5.0})
    asked = plan(koul, ["dual:20k/2k,estimator=kalman"], [20.0], [0.0])
    assert asked.signal == "truth"
    found = zwidth(asked)
    assert np.isfinite(found.fidelity).all()
    assert table_one(found).rows[0].paper is None
    for preset in ("koul-rigid", "koul-compliant"):
        k, b = ranges.default_grid(presets.load(preset), asked.schemes)
        assert (len(k), len(b), b[0]) == (60, 16, 0.0)
        assert k[0] == pytest.approx(k[1] - k[0])
    assert [s.estimator for s in ranges.default_schemes(koul)] == list(ranges.PAPERS_ESTIMATORS)


# ---------------------------------------------------------------------- the same bytes, files, refusals


def test_files_hold_units_and_every_wall_and_a_finished_map_is_read(tmp_path: Path) -> None:
    asked = plan(SHORT, [FILTERED], [5e3, 10e3], [60.0])
    place = maps.directory_for(asked, tmp_path, "impedance-map")
    first = maps.map_into(asked, place)
    progress = []
    again = maps.map_into(asked, place, watch=progress.append)
    assert progress[-1].kept == progress[-1].total == 1
    assert (again.passive == first.passive).all()
    written = pq.read_table(place / "walls.parquet")
    assert written.num_rows == 2 * 3
    assert written.schema.field("stiffness").metadata[b"unit"] == b"N/m"
    assert written.schema.field("fidelity").metadata[b"unit"] == "N·s/m".encode()
    frame = written.to_pandas()
    assert frame["realisation"].isna().sum() == 2
    document = json.loads((place / "map.json").read_text())
    stiffness = document["table_one"]["rows"][0]["widths"]["together"]["stiffness"]
    assert stiffness == table_one(again).rows[0].widths.together.stiffness
    assert document["judging"]["band_hz"] == [1.0, 250.0]
    assert document["excitation"]["rms"] == 2.0  # ten times the friction, or a fiftieth of the limit


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stiffnesses": []}, r"stiffnesses \(`stiffness`\): the list is empty"),
        ({"stiffnesses": [2.0, 1.0]}, r"`stiffness`\) are not in rising order"),
        ({"schemes": [FDM, FDM]}, "is given twice"),
    ],
)
def test_an_impossible_map_is_refused(changes: Any, message: str) -> None:
    with pytest.raises(PlanError, match=message):
        plan(CHAWDA, **({"schemes": [FDM], "stiffnesses": [1e3], "dampings": [0.0]} | changes))


def test_an_excitation_beyond_the_limits_is_refused_before_anything_runs() -> None:
    loud = config.override(SHORT, {"excitation.rms": 60.0})
    with pytest.raises(PlanError, match="peak position"):
        zwidth(plan(loud, [FDM], [1e3], [0.0]))


def test_pictures_of_any_number_of_schemes(map_with_friction: Any) -> None:
    check_axes(frequency_figure(map_with_friction, theory=ranges.linear_curves(map_with_friction.plan, 2)))
    shape = (1, 2, 1, 2)
    asked = plan(SHORT, [FDM], [1e3, 2e3], [0.0])
    nothing = FrequencyMap(asked, [], np.zeros(shape, bool), np.full(shape, math.nan))
    check_axes(frequency_figure(nothing, realisation=0))


# ---------------------------------------------------------------------- widths of made-up regions


def parse_region(text: Any) -> Any:
    """Parse a drawn region: rows are dampings, # is passive, stiffness rises to the right."""
    return np.array([[mark == "#" for mark in row] for row in text.split()])


def test_widths_count_what_is_connected_and_list_the_rest() -> None:
    passive = parse_region("##..#. .###.. ###### ...#.. ##.#.#")
    fidelity = np.arange(30.0).reshape(5, 6)
    k, b = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [0.0, 10.0, 20.0, 30.0, 40.0]
    width = FrequencyWidth.of(passive, fidelity, k, b)
    assert (width.stiffness, width.at_damping, width.stiffness_capped) == (6.0, 20.0, True)
    assert width.stiffness_undamped == 2.0
    assert (width.damping, width.damping_capped) == (40.0, True)
    assert width.gaps == (10.0, 30.0)
    assert (width.worst_fidelity, width.worst_stiffness, width.worst_damping) == (25.0, 2.0, 40.0)
    assert width.cells == 2 + 6 + 2
    assert [(i.damping, i.lowest, i.highest) for i in width.islands] == [
        (0.0, 5.0, 5.0), (10.0, 2.0, 4.0), (30.0, 4.0, 4.0), (40.0, 4.0, 4.0), (40.0, 6.0, 6.0)
    ]  # fmt: skip


def test_a_map_without_a_passive_wall_has_no_widths() -> None:
    fidelity = np.full((2, 4), math.nan)
    width = FrequencyWidth.of(parse_region("..#. ...."), fidelity, [1.0, 2.0, 3.0, 4.0], [5.0, 6.0])
    assert (width.stiffness, width.cells, width.stiffness_undamped) == (0.0, 0, None)
    assert math.isnan(width.damping)
    assert math.isnan(width.worst_fidelity)
    assert plain(width)["damping"] is None
    assert not width.stiffness_capped
    assert not width.damping_capped


def test_spread_leaves_out_nan() -> None:
    spread = Spread.of([1.0, math.nan, 3.0])
    assert (spread.mean, spread.lowest, spread.highest, spread.count) == (2.0, 1.0, 3.0, 2)
    assert spread.deviation == pytest.approx(math.sqrt(2.0))
    assert math.isnan(Spread.of([4.0]).deviation)
    assert Spread.of([math.nan]).count == 0


# ---------------------------------------------------------------------- the boundary search

EDGES = st.integers(1, 12).flatmap(
    lambda stiffnesses: st.tuples(
        st.just(stiffnesses), st.lists(st.integers(0, stiffnesses), min_size=1, max_size=12)
    )
)


@given(EDGES)
def test_the_search_finds_the_edge_where_each_damping_has_one(case: Any) -> None:
    """Each wall is tested at most once."""
    stiffnesses, heights = case
    heights[0] = max(1, heights[0])
    passive = np.arange(stiffnesses) < np.array(heights)[:, None]
    found = trace_grid(passive)
    path = found.path
    assert len(set(path)) == len(path)
    ends = next((b for b, height in enumerate(heights) if height == 0), None)
    seen = heights if ends is None else heights[: ends + 1]
    assert list(found.edge) == [(b, height - 1) for b, height in enumerate(seen)]
    assert found.ending == ("last damping" if ends is None else "no stiffness left")
    assert found.above == found.below == 0
    assert set(found.capped) == {b for b, height in enumerate(seen) if height == stiffnesses}
    turns = sum(abs(second - first) for first, second in pairwise(seen))
    assert len(path) <= heights[0] + 2 * len(seen) + turns


@given(st.lists(st.lists(st.booleans(), min_size=5, max_size=5), min_size=1, max_size=8), st.booleans())
def test_on_any_region_the_search_ends_and_requests_no_wall_twice(rows: Any, looks: bool) -> None:
    passive = np.array(rows)
    found = trace_grid(passive, looks=looks)
    path = found.path
    assert len(set(path)) == len(path) <= passive.size
    assert all(0 <= b < len(rows) and 0 <= k < 5 for b, k in path)
    for b, k in found.edge:
        assert k == -1 or passive[b, k]


def test_the_search_moves_up_to_an_island_and_stays() -> None:
    """From the first edge at 2 the search meets an island above the next edge, and stays on the island."""
    passive = parse_region("###..... ##.###.. ##..##.. ##......")
    found = trace_grid(passive)
    assert dict(found.edge) == {0: 2, 1: 5, 2: 5, 3: 1}
    assert found.connected == (2, 1, 1, 1)
    assert (found.above, found.below, found.unseen) == (2, 0, 0)
    assert found.highest == 5


def test_the_search_ends_at_a_start_or_a_damping_without_a_passive_wall() -> None:
    passive = parse_region(".### .##. ###. ##..")
    blind = trace_grid(passive, looks=False)
    assert (len(blind.path), blind.ending, blind.highest) == (1, "start not passive", -1)
    assert blind.unseen == 2
    found = trace_grid(passive)
    assert found.edge == ((0, -1), (1, -1), (2, 2), (3, 1))
    assert found.path[:3] == ((0, 0), (1, 0), (2, 0))
    assert trace_grid(parse_region("... ...")).ending == "start not passive"
    beyond = trace_grid(parse_region("###. .... ####"))
    assert (beyond.ending, beyond.unseen) == ("no stiffness left", 1)
