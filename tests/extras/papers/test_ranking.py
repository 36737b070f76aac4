"""The ranking of estimators and laws: rendered walls, areas, win and tie, resumption, and a small complete ranking."""

import json
import math
from dataclasses import asdict, astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import rig.cli
from rig import config
from rig.config import presets
from rig.core.errors import ConfigError
from rig.experiments.design import _listing
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.extras.papers.ranking import compare, measure, rule
from rig.extras.papers.ranking.compare import Ratio, RigResults, compare_areas
from rig.extras.papers.ranking.page import is_new, page
from rig.extras.papers.ranking.rule import Ground, Pair, Tuned
from sim_backend.bare.hits import render
from tests.conformance.guides import ROOT

PAGE = ROOT / "rig" / "docs" / "reference" / "ranking.md"
FINE: dict[str, Any] = {"rig.encoder.quantum": 1e-9, "rig.amplifier.current_quantum_a": 4e-4}


def test_the_fit_is_that_of_least_squares_over_the_contact() -> None:
    random = np.random.default_rng(3)
    penetration, rate = random.normal(0.0, 1e-3, 500), random.normal(0.0, 0.1, 500)
    effort = 2e4 * penetration + 70.0 * rate + random.normal(0.0, 1.0, 500)
    found = np.zeros(3)
    render(effort, penetration, rate, found)
    inside = penetration > 0.0
    columns = np.column_stack([penetration, rate])[inside]
    np.testing.assert_allclose(found[:2], np.linalg.lstsq(columns, effort[inside], rcond=None)[0], rtol=1e-9)
    render(effort, penetration, 2.0 * penetration, found)
    assert np.isnan(found[:2]).all()  # a rate in proportion to the penetration determines nothing


def test_a_fine_encoder_renders_the_commanded_wall_also_with_a_wrong_effort_constant() -> None:
    x = config.override(
        presets.load("chawda-linear"),
        {**FINE, "controller.position_rate": 20_000, "controller.velocity_rate": 20_000,
         "controller.parameters": {"cutoff_hz": 8000.0}, "rig.limits.slew": 1e7},
    )  # fmt: skip
    model = config.rig_model(x)
    stronger = replace(model, amplifier=replace(model.amplifier, effort_per_ampere=12.0))
    lighter = replace(model, mechanics=replace(model.mechanics, motor_inertia=0.52 / 1.2, motor_damping=13.2 / 1.2,
                                               motor_coulomb=0.19 / 1.2))  # fmt: skip
    for one in (model, stronger):
        found = HitSimulator(x, rig=one).hit(20_000.0, 60.0).rendering
        assert found.stiffness == pytest.approx(20_000.0, rel=0.01)
        assert found.damping == pytest.approx(60.0, rel=0.05)
    # 1.2 times the effort on a mass is the same motion as the effort on the mass over 1.2.
    hits = [HitSimulator(x, rig=one).hit(20_000.0, 60.0) for one in (stronger, lighter)]
    one, other = (float(hit.true.numbers["impact_velocity"]) for hit in hits)
    assert one == pytest.approx(other, rel=1e-6)


def test_a_late_estimator_renders_less_damping_and_has_a_larger_error() -> None:
    x = presets.load("chawda-linear")
    early, late = (config.override(x, {"controller.parameters": {"cutoff_hz": hz}}) for hz in (400.0, 20.0))
    found = [HitSimulator(one).hit(8_000.0, 40.0).rendering for one in (early, late)]
    assert found[0].damping > 2.0 * found[1].damping
    assert found[0].velocity_error < found[1].velocity_error


@pytest.mark.parametrize(("stiffness", "damping", "fits"), [
    (0.71, 0.51, True), (1.39, 1.99, True), (0.69, 1.0, False), (1.41, 1.0, False), (1.0, 0.49, False),
    (1.0, 2.01, False), (math.nan, 1.0, False), (1.0, math.nan, False),
])  # fmt: skip
def test_a_wall_counts_within_the_limits_of_the_rule(stiffness: float, damping: float, fits: bool) -> None:
    hit = HitSimulator(presets.load("chawda-linear")).hit(20_000.0, 60.0)
    assert hit.recorded.passes("heard")
    rendering = replace(hit.rendering, stiffness=20_000.0 * stiffness, damping=60.0 * damping)
    assert rule.counts(replace(hit, rendering=rendering), 20_000.0, 60.0) is fits
    undamped = replace(hit.rendering, stiffness=20_000.0, damping=math.nan)
    assert rule.counts(replace(hit, rendering=undamped), 20_000.0, 0.0)


@pytest.mark.parametrize("length", [1, 2, 7, 33])
def test_the_edge_is_found_from_any_start_in_few_tests(length: int) -> None:
    for edge in range(-1, length):
        for start in range(length):
            tried: list[int] = []

            def passes(index: int, edge: int = edge, tried: list[int] = tried) -> bool:
                tried.append(index)
                return index <= edge

            assert measure.find_edge(passes, start, length) == edge
            assert len(tried) == len(set(tried)) <= 2 * math.log2(length) + 3


def test_the_area_is_that_of_a_triangle_and_ends_after_two_empty_dampings() -> None:
    dampings, rungs = [0.1 * n for n in range(24)], [1.005**n for n in range(1000)]
    limits = measure.trace_limits(lambda k, b: k <= 100.0 * (1.0 - b), dampings, rungs)
    assert len(limits) == 12  # the limit at 1.0 is 0, and that at 1.1
    assert measure.area_under(limits, dampings, rungs[0]) == pytest.approx(50.0, rel=0.02)
    assert measure.area_under([0.0] * 3, dampings, 1.0) == pytest.approx(0.05)


def compared(first: Any, second: Any) -> Ratio:
    return compare_areas(tuple(first), tuple(second))


def test_win_and_tie() -> None:
    rigs = np.random.default_rng(1).lognormal(0.0, 1.0, 9)
    assert astuple(compared(1.3 * rigs, rigs)) == pytest.approx((1.3, 1.3, 1.3))
    assert compared(1.3 * rigs, rigs).outcome == "wins"
    assert compared(rigs, 1.3 * rigs).outcome == "loses"
    assert compared(1.2 * rigs, rigs).outcome == "ties"  # clear, but too small
    assert compared(1.2 * rigs, rigs).low > 1.0
    found = compared(rigs * np.array([10.0, *[0.95] * 8]), rigs)  # large, but of a single rig
    assert found.low < 1.0 < found.mean
    assert found.outcome == "ties"
    # Against the normal interval of a mean, which the bootstrap approaches for logarithms without outliers.
    logs = np.random.default_rng(2).normal(0.5, 0.2, 9)
    found = compared(np.exp(logs), np.ones(9))
    half = 1.96 * logs.std() / 3.0
    assert math.log(found.low) == pytest.approx(logs.mean() - half, abs=0.02)
    assert math.log(found.high) == pytest.approx(logs.mean() + half, abs=0.02)


def make_results(rig: str, **areas: float) -> RigResults:
    """Return results in which each pair has the same area under all conditions."""
    keys = [f"{grip}/{delay}" for grip in rule.CONDITIONS for delay in rule.DELAYS]
    cells = {pair: {key: [[area] * 9, 1.0, 0.0, 0] for key in keys} for pair, area in areas.items()}
    return RigResults(rig, {}, [], {}, cells)


def test_the_best_pair_is_recommended_and_ties_are_not() -> None:
    found = make_results("a", x=2.0, y=1.0, z=0.5)
    assert found.recommended("0") == ["x"]
    assert make_results("a", x=2.0, y=1.9).recommended("0") == []
    assert make_results("a", x=2.0, y=1.9).never_lose("0") == ["x", "y"]
    assert found.best("firm", "0", ["y", "z"]) == "y"
    tied = make_results("a", **{"x": 2.0, "x, passive": 1.9, "y": 1.0})
    assert tied.recommended("0") == []
    assert tied.recommended("0", own_laws=False) == ["x", "x, passive"]


def test_the_stability_is_the_tau_of_the_rankings() -> None:
    same, other = make_results("a", x=3.0, y=2.0, z=1.0), make_results("b", x=1.0, y=2.0, z=30.0)
    assert compare.stability([same, same, same], "0")["a"] == pytest.approx(1.0)
    taus = compare.stability([same, other], "0")  # both: z, y, x; b alone z, y, x; a alone x, y, z
    assert taus == {"a": pytest.approx(1.0), "b": pytest.approx(-1.0)}


def test_variations_stay_within_a_fifth_and_the_controller_keeps_its_values() -> None:
    model = config.rig_model(presets.load("koul-compliant"))
    assert rule.vary(model, 0) == model
    factors = []
    for number in range(1, 9):
        varied = rule.vary(model, number)
        assert varied == rule.vary(model, number)
        factors += [varied.mechanics.motor_inertia / model.mechanics.motor_inertia,
                    varied.amplifier.effort_per_ampere / model.amplifier.effort_per_ampere,
                    varied.encoder.resolution / model.encoder.resolution]  # fmt: skip
    assert len(set(factors)) == len(factors)
    assert 0.8 <= min(factors) < 0.9
    assert 1.1 < max(factors) <= 1.2


def test_the_page_shows_the_committed_results_and_the_design_lists_no_new_scheme_without_a_win() -> None:
    found = compare.read_results()
    remedy = "run: rig estimators rank, and copy results and page"
    assert PAGE.read_text(encoding="utf-8") == page(found), remedy
    assert compare.RESULTS.stat().st_size <= 200_000
    wins = {pair for one in found for n in one.delays for pair in one.recommended(n) if is_new(pair)}
    listed = {name for name, _ in _listing._estimators(presets.load("chawda-linear"), 1000)}
    assert {pair.split(", ")[0] for pair in wins} == listed & {"tracking", "disturbance"}
    assert {name for name in rule.ESTIMATORS if not is_new(name)} == listed & {*rule.ESTIMATORS}
    assert is_new("disturbance-two-mass"), "an entry"


def test_an_unknown_rig_or_estimator_is_refused() -> None:
    with pytest.raises(ConfigError, match="no-rig is not in the ranking"):
        Ground.of("no-rig")
    entry = Tuned(estimator="two-mass", parameter="frequency_hz", low=40.0, high=2000.0, per_rate=False)
    with pytest.raises(ConfigError, match=r"^unknown estimator 'two-mass'"):
        measure.measure_rig("chawda-linear", **{**SMALL, "pairs": (), "entries": [entry]})


PAIRS = (Pair("disturbance", law=rule.ESTIMATED),)
ENTRY = Tuned(estimator="disturbance", parameter="frequency_hz", low=10.0, high=12.0, per_rate=False)
SMALL: dict[str, Any] = {
    "pairs": PAIRS,
    "entries": [ENTRY],
    "grips": ("none",),
    "delays": (0,),
    "variations": 1,
}


def test_a_small_ranking_resumes_from_its_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rule, "OFFSETS", (0.6,))
    whole = measure.measure_rig("chawda-linear", directory=tmp_path, **SMALL)
    assert list(whole["conditions"]) == [*(pair.name for pair in PAIRS), ENTRY.estimator]
    assert all(len(cells["none/0"][0]) == 2 for cells in whole["conditions"].values())
    assert 10.0 <= whole["tuned"]["disturbance"]["frequency_hz"] <= 13.0  # the entry's range, not the table's
    assert json.loads(json.dumps(whole)) == whole
    journal = tmp_path / "chawda-linear-judging.journal"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:-2]))  # stopped before the last two tasks
    again: list[float] = []
    original = measure.series

    def series(*given: Any) -> dict[str, Any]:
        again.append(given[2])
        return original(*given)

    monkeypatch.setattr(measure, "series", series)
    assert measure.measure_rig("chawda-linear", directory=tmp_path, **SMALL) == whole
    assert again == [*rule.OFFSETS, *rule.OFFSETS]


def test_the_command_writes_results_and_their_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    areas = {pair.name: 2.0**n for n, pair in enumerate(Ground.of("hapkit").pairs)}
    found = asdict(make_results("hapkit", **areas))
    asked: list[Any] = []

    def measure_rig(rig: str, **given: Any) -> dict[str, Any]:
        asked.append((rig, given["entries"]))
        return found

    monkeypatch.setattr(measure, "measure_rig", measure_rig)
    monkeypatch.setattr(measure, "estimate_s", lambda rig: 60.0)
    words = ["estimators", "rank", "hapkit", "--entry", "mine:gain=0.1:10", "-o", str(tmp_path)]
    result = CliRunner().invoke(rig.cli.rig, words)
    assert result.exit_code == 0, result.output
    mine = Tuned(estimator="mine", parameter="gain", low=0.1, high=10.0, per_rate=False)
    assert asked == [("hapkit", [mine])]
    text = (tmp_path / "ranking.md").read_text(encoding="utf-8")
    assert text == page(compare.read_results(tmp_path / "results.json"))
    assert "| hapkit | **disturbance, estimated position** |" in text
    assert "not measured: koul-rigid" in text
    for entry in ("mine", "mine:gain", "mine:gain=1", "mine:gain=1:x", "mine:gain=2:1"):
        assert CliRunner().invoke(rig.cli.rig, [*words[:4], entry]).exit_code != 0
