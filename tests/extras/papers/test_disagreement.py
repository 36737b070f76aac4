"""The rule that finds why theory and hits differ, by removing each non-linearity alone."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.control.bilateral import clinging_law
from rig.core.errors import PlanError
from rig.experiments.hits.hit_simulator import start_of
from rig.experiments.mapping import _maps as maps
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import MapPlan
from rig.extras.papers.disagreement.ablation import (
    CONTACT,
    EACH,
    FINER,
    FOUR,
    FRICTION,
    NONE,
    OTHERS,
    QUANTUM,
    SATURATION,
    cause_of,
    cures,
    without,
)
from rig.extras.papers.disagreement.disagreement import DisagreementPlan, edges_of
from rig.extras.papers.disagreement.report import paragraph
from rig.testing import reactions


@pytest.fixture(scope="module")
def experiment() -> Any:
    held = {"trial.kind": "human", "operator.grip": "normal", "rig.limits.human": False}
    return config.override(presets.load("koul-compliant"), held)


LADDER = StiffnessSearch(lowest=10.0, highest=90.0, ratio=3.0)


def plan_of(x: Any, scheme: str, dampings: Any, search: StiffnessSearch = LADDER) -> DisagreementPlan:
    schemes = (Scheme.parse(scheme),)
    return DisagreementPlan(map=MapPlan(experiment=x, schemes=schemes, dampings=dampings, search=search))


# --- the rule -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("differs", "sets", "cause"),
    [
        (lambda left: FRICTION in left, [(FRICTION,)], FRICTION),
        (lambda left: {FRICTION, QUANTUM} <= left, [(FRICTION,), (QUANTUM,)], EACH),
        (lambda left: bool({FRICTION, CONTACT} & left), [(FRICTION, CONTACT)], OTHERS),
        (bool, [FOUR], OTHERS),
        (lambda left: True, [], NONE),
    ],
)
def test_the_cause_is_the_smallest_sets_without_which_both_agree(differs: Any, sets: Any, cause: str) -> None:
    found = cures(lambda taken: not differs(set(FOUR) - set(taken)))
    assert list(found) == sets
    assert cause_of(found) == cause


# --- what is taken out --------------------------------------------------------------------------------------


def test_each_part_is_taken_out_alone(experiment: Any) -> None:
    smooth, fine, strong = (without(experiment, [one]) for one in (FRICTION, QUANTUM, SATURATION))
    assert smooth.rig.mechanics.motor_coulomb == smooth.rig.mechanics.link_coulomb == 0.0
    assert replace(smooth, rig=replace(smooth.rig, mechanics=experiment.rig.mechanics)) == experiment

    assert experiment.rig.encoder.resolution == pytest.approx(FINER * fine.rig.encoder.resolution)
    assert start_of(fine) == pytest.approx(start_of(experiment)), "the handle starts where it did"

    quantum = experiment.rig.amplifier.effort_quantum
    assert strong.rig.limits.effort == strong.rig.amplifier.effort_limit == 32767 * quantum
    assert strong.rig.mechanics == experiment.rig.mechanics
    assert strong.rig.encoder == experiment.rig.encoder
    assert without(experiment, [CONTACT]) == experiment, "that is the law's affair"


def test_a_clinging_wall_is_nothing_until_it_is_touched_and_then_bilateral() -> None:
    penetration = np.array([-1.0, -0.5, 0.0, 0.1, -0.2, -3.0])
    wall = {"stiffness": 10.0, "damping": 2.0}
    given = reactions(clinging_law(), penetration, np.ones(6), **wall)
    assert given.tolist() == pytest.approx([0.0, 0.0, 0.0, 3.0, 0.0, -28.0])


# --- physics ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scheme", "stiffness", "damping", "cause", "linear"),
    [
        ("dual:20k/2k", 620.0, 0.3, FRICTION, False),  # friction holds a wall that theory calls unstable
        ("uniform:20k", 200.0, 0.7, QUANTUM, True),  # one count buzzes in a wall that theory calls stable
    ],
)
def test_friction_stabilises_and_the_quantum_buzzes(
    experiment: Any, scheme: str, stiffness: float, damping: float, cause: str, linear: bool
) -> None:
    alone = StiffnessSearch(lowest=stiffness, highest=1.1 * stiffness, ratio=2.0)
    plan = plan_of(experiment, scheme, (damping,), alone)
    (wall,) = maps.zwidth(plan, workers=1).walls
    assert (wall.linear, wall.holds, wall.cause) == (linear, not linear, cause)
    assert wall.holds_without is linear, "without all four the rig does as theory says"


# --- shares -------------------------------------------------------------------------------------------------


def test_shares_are_areas_of_cells_that_fill_the_plane(experiment: Any) -> None:
    plan = plan_of(experiment, "dual:20k/2k", (0.0, 1.0, 3.0))
    agreed, failed = ({"radius": 0.9, "holds": holds, "holds_without": True} for holds in (True, False))
    one = {"cures": None, "hits": 1, "ticks": 1}
    column = [
        {**agreed, **one, "stiffness": 10.0},
        {**failed, **one, "stiffness": 30.0, "cures": [["quantum"]]},
        {**failed, **one, "stiffness": 90.0, "cures": [["friction"], ["contact"]]},
    ]
    found = plan.found([column] * 3)
    shares = found.shares(0)
    edges = [10.0, 300.0**0.5, 2700.0**0.5, 90.0]
    assert shares.differ.share == pytest.approx((edges[3] - edges[1]) / 80.0)
    assert shares.differ == shares.fails, "theory calls all of it stable"
    assert shares.beyond.share == 0.0
    each, quantum = ((edges[k + 1] - edges[k]) / (edges[3] - edges[1]) for k in (2, 1))
    assert shares.differ.causes == pytest.approx({EACH: each, QUANTUM: quantum})
    assert list(shares.sets) == ["friction; contact"]
    assert found.brief()[1].value == "90.8 % of the plane: each of several 52.3 %, quantum 47.7 %"


def test_the_paragraph_has_the_shares_and_causes_of_each_scheme(experiment: Any) -> None:
    alike = {"radius": 1.1, "holds_without": True, "hits": 1, "ticks": 1}
    column: list[Any] = [
        {**alike, "stiffness": 10.0, "holds": True, "cures": [["friction"]]},
        {**alike, "stiffness": 30.0, "holds": True, "cures": [["friction"]]},
        {**alike, "stiffness": 90.0, "holds": False, "cures": None},
    ]
    found = plan_of(experiment, "dual:20k/2k", (0.0, 1.0)).found([column] * 2)
    shares, text = found.shares(0), paragraph(found)
    assert 0.0 < shares.differ.share < 1.0 == shares.beyond.share
    assert f"200 Hz: theory and hits differ in {100 * shares.differ.share:.1f} % of the K–B plane." in text
    assert "Of the area that is stable in hits 100 % is unstable in theory (100 % friction)." in text
    assert "Quantum, saturation and contact alone are the cause of none." in text
    assert "Of the area that is stable by theory" not in text


def test_cells_end_half_way_to_their_neighbours() -> None:
    assert edges_of((0.0, 1.0, 3.0)).tolist() == [0.0, 0.5, 2.0, 3.0]
    assert edges_of((1.0, 4.0, 16.0), by_ratio=True).tolist() == [1.0, 2.0, 8.0, 16.0]
    assert edges_of((2.0,)).tolist() == [1.5, 2.5]


@pytest.mark.parametrize(("key", "value"), [("law", "bilateral"), ("damping_on", "entry")])
def test_a_wall_without_theory_is_refused(experiment: Any, key: str, value: str) -> None:
    plan = plan_of(config.override(experiment, {f"wall.{key}": value}), "dual:20k/2k", (0.0,))
    with pytest.raises(PlanError, match=f"wall.{key} = '{value}'"):
        _ = plan.tasks
