"""The measured paddle and the cut-off: rules on numbers made up to reach every verdict; the data; the rigs drawn."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from rig.config.schemes import Scheme
from rig.experiments.hit_simulator import HitSimulator
from rig.papers.cutoff import rigs as cutoff_rigs
from rig.papers.cutoff import rules as cutoff_rules
from rig.papers.cutoff.reproduction import CutoffPlan
from rig.papers.paddle import data, parts, rigs, rules
from rig.papers.paddle.reproduction import PaddlePlan
from rig.papers.paddle.results import Paddle
from rig.papers.rules import Status

STEP = 1.1
DAMPINGS = (0.0, 2.0, 4.0, 6.0)
AS_MEASURED: rules.Curves = {
    data.DIFFERENCE: (1000.0, 1500.0, 0.0, 0.0),
    data.FOAW: (1000.0, 2000.0, 500.0, 0.0),
    data.KALMAN: (1000.0, 1800.0, 700.0, 0.0),
    data.LEVANT: (1000.0, 2500.0, 2000.0, 300.0),
}


def turned(**changes: tuple[float, ...]) -> rules.Curves:
    """The curves above with some replaced, by name."""
    named = {"difference": data.DIFFERENCE, "foaw": data.FOAW, "kalman": data.KALMAN, "levant": data.LEVANT}
    return {**AS_MEASURED, **{named[name]: curve for name, curve in changes.items()}}


def test_the_data_is_that_of_the_file() -> None:
    assert {name: data.peak(name) for name in data.ESTIMATORS} == {
        data.DIFFERENCE: 3000, data.FOAW: 5800, data.KALMAN: 4000, data.LEVANT: 6200,
    }  # fmt: skip
    assert [data.damping_range(name) for name in data.ESTIMATORS] == [16.0, 18.0, 20.0, 24.0]
    assert data.measured(data.DIFFERENCE, 6.0) == 3000
    assert data.measured(data.DIFFERENCE, 18.0) == 0.0


def test_every_statement_can_hold() -> None:
    found = [AS_MEASURED] * 10
    assert rules.leads(found, STEP).status is Status.REPRODUCED
    assert rules.peak_order(found, STEP).status is Status.REPRODUCED
    assert rules.widest(found, DAMPINGS).status is Status.REPRODUCED
    assert rules.range_order(found, DAMPINGS).status is Status.REPRODUCED
    assert rules.above_difference(found, STEP).status is Status.REPRODUCED
    assert rules.first_rise(found, STEP).status is Status.REPRODUCED
    assert rules.apart([turned(levant=(2000.0,))] * 10, STEP).status is Status.REPRODUCED
    assert rules.told_apart([(3000.0, 5400.0, 5200.0, 1800.0)] * 10, STEP).status is Status.REPRODUCED
    assert rules.predicted({data.FOAW: (1.0, 2.0), data.LEVANT: (1.0, 2.0)}).status is Status.REPRODUCED


def test_every_statement_can_fail() -> None:
    last = [turned(levant=(1000.0, 0.0, 0.0, 0.0), difference=(1000.0, 2000.0, 800.0, 500.0))] * 10
    assert rules.leads(last, STEP).status is Status.NOT
    assert rules.peak_order(last, STEP).status is Status.NOT
    assert rules.widest(last, DAMPINGS).status is Status.NOT
    assert rules.range_order(last, DAMPINGS).status is Status.NOT
    assert rules.above_difference(last, STEP).status is Status.NOT
    flat = [turned(kalman=(2000.0, 2000.0, 0.0, 0.0))] * 10
    assert rules.first_rise(flat, STEP).status is Status.NOT
    assert rules.apart([AS_MEASURED] * 10, STEP).status is Status.NOT
    nothing = dict.fromkeys(data.ESTIMATORS, (0.0, 0.0, 0.0, 0.0))
    assert rules.apart([nothing] * 10, STEP).status is Status.NOT
    assert rules.told_apart([(3000.0, 3000.0, 3000.0, 2900.0)] * 10, STEP).status is Status.NOT
    assert rules.predicted({data.FOAW: (1.0, 2.0), data.LEVANT: (3.0, 2.0)}).status is Status.NOT
    assert rules.leads([], STEP).status is Status.NOT


def test_a_rung_is_a_tie_and_is_counted_as_one() -> None:
    tie = turned(levant=(1000.0, 1900.0, 0.0, 0.0))
    assert rules.count_leads([AS_MEASURED, tie, turned(levant=(1000.0, 1000.0, 0.0, 0.0))], STEP) == {
        "ahead": 1, "tie": 1, "behind": 1,
    }  # fmt: skip


def test_a_plausible_rig_is_of_the_paddles_size_by_the_difference() -> None:
    dampings = data.dampings(14)

    def curve(peak: float, columns: int) -> Any:
        return {**AS_MEASURED, data.DIFFERENCE: tuple(peak if n < columns else 0.0 for n in range(14))}

    assert rules.plausible(curve(3000.0, 9), dampings)
    assert not rules.plausible(curve(10_000.0, 9), dampings)
    assert not rules.plausible(curve(3000.0, 4), dampings)
    assert not rules.plausible(curve(3000.0, 14), dampings)


def test_the_rigs_are_the_same_at_every_scale_and_within_their_priors() -> None:
    for number in range(20):
        rig = rigs.Rig.drawn(number)
        assert rig == rigs.Rig.drawn(number)
        for name, prior in rigs.PRIORS.items():
            assert prior.low <= rig.values[name] <= prior.high
    plans = {scale.name: PaddlePlan(scale).parts() for scale in (rigs.QUICK,)}
    json.dumps([task.payload for part in plans["quick"].values() for task in part.tasks], allow_nan=False)
    for scheme in rigs.Rig.drawn(3).schemes():
        assert Scheme.parse(scheme.text).applied(rigs.Rig.drawn(3).experiment()) is not None


def test_without_damping_no_estimator_enters_the_wall() -> None:
    """The one thing of the measured curves that no rig can give: other limits at B = 0 by estimator."""
    rig = rigs.Rig.drawn(3)
    found = set()
    for scheme in rig.schemes():
        hit = HitSimulator(scheme.applied(rig.experiment())).hit(2000.0, 0.0)
        found.add(hit.true.numbers.tobytes())
    assert len(found) == 1


def test_an_estimate_that_turns_round_ten_times_a_second_oscillates() -> None:
    time_s = np.arange(1430) / rigs.RATE
    assert parts.oscillates(0.1 * np.sign(np.sin(2 * np.pi * 20.0 * time_s)), 1430)
    assert not parts.oscillates(0.1 * np.sign(np.sin(2 * np.pi * 3.0 * time_s)), 1430)
    assert not parts.oscillates(0.005 * np.sign(np.sin(2 * np.pi * 20.0 * time_s)), 1430)


def test_three_curves_are_fitted_and_the_fourth_is_that_of_the_same_rig() -> None:
    """A rig that is the measured one predicts each of its curves without error."""
    dampings = rigs.FULL.dampings
    truth = {name: [data.measured(name, b) for b in dampings] for name in data.ESTIMATORS}
    other = {name: [2.0 * k for k in curve] for name, curve in truth.items()}
    drawn = (rigs.Rig.drawn(0), rigs.Rig.drawn(1))
    told = tuple(dict.fromkeys(data.ESTIMATORS, 1.0) for _ in drawn)
    paddle = Paddle(scale=rigs.FULL, drawn=drawn, curves=(other, truth), capped=0, told=told, hits=1)
    for fit in paddle.fits:
        assert (fit.rig, fit.fitted, fit.predicted) == (1, 0.0, 0.0)
        assert fit.mean > 0.0
    assert paddle.plausible == [0, 1]
    assert paddle.decides == []  # of two rigs nothing can be said


# --- the cut-off ---------------------------------------------------------------------------------------------


def test_a_best_cut_off_lies_inside_and_is_clearly_best() -> None:
    inside, edge, flat = [1.0, 2.0, 1.0], [3.0, 2.0, 1.0], [1.0, 1.05, 1.0]
    assert cutoff_rules.exists({("fine", "felt"): inside}).status is Status.REPRODUCED
    mixed = {("fine", "felt"): edge, ("coarse", "felt"): inside, ("coarse", "any"): inside}
    assert cutoff_rules.exists(mixed).verdict == "reproduced only with coarse"
    assert cutoff_rules.exists({("fine", "felt"): flat}).status is Status.NOT
    assert cutoff_rules.exists({("fine", "felt"): edge}).status is Status.NOT


def test_a_model_predicts_the_cut_off_or_its_neighbour() -> None:
    low, middle, high = [2.0, 1.0, 1.0, 1.0], [1.0, 1.0, 2.0, 1.0], [1.0, 1.0, 1.0, 2.0]
    assert cutoff_rules.predicts(middle, {"mass": middle, "friction": high}).status is Status.REPRODUCED
    assert cutoff_rules.predicts(middle, {"mass": low, "friction": high}).failed == ["mass"]
    assert cutoff_rules.predicts(high, {"mass": high}).failed == ["the rig has one"]


def test_the_models_miss_the_rig_by_a_fifth() -> None:
    assert cutoff_rigs.model("mass + 20%")["rig.mechanics.motor_inertia"] == pytest.approx(1.2 * 0.52)
    assert len(CutoffPlan(cutoff_rigs.QUICK).parts()) == len(cutoff_rigs.QUANTA) + len(cutoff_rigs.MODELS)
