"""Default ranges of maps: stiffnesses that the push can show, that a device may hit, and that theory allows."""

from dataclasses import replace
from typing import Any

import pytest

import rig
from rig import config
from rig.analysis import theory
from rig.config import presets, push_at_rest
from rig.config.schemes import Scheme
from rig.core.check import Outcome
from rig.core.errors import PlanError
from rig.experiments.identification.identify import IdentifyRequest, plan_of
from rig.experiments.mapping import _ranges as ranges
from rig.experiments.trials.plan import make_plan

PUSHED = presets.load("koul-compliant")
HELD = config.override(PUSHED, {"trial.kind": "human"})
DUAL = Scheme.parse("dual:20k/2k")


@pytest.mark.parametrize("experiment", [PUSHED, HELD, presets.load("chawda-linear")])
def test_the_push_rests_the_least_number_of_counts_deep_in_the_stiffest_wall(experiment: Any) -> None:
    stiffest = ranges.highest_stiffness(experiment)
    walled = replace(experiment, wall=replace(experiment.wall, stiffness=stiffest))
    counts = push_at_rest(walled) / stiffest / experiment.rig.encoder.resolution
    assert counts == pytest.approx(experiment.trial.minimum_rest_counts, rel=1e-6)


def test_without_a_least_depth_the_push_must_show_one_count() -> None:
    free = config.override(PUSHED, {"trial.minimum_rest_counts": 0.0})
    in_preset = ranges.highest_stiffness(PUSHED)  # 2 counts
    assert ranges.highest_stiffness(free) == pytest.approx(2.0 * in_preset, rel=1e-6)


@pytest.mark.parametrize("preset", ["chawda-linear", "koul-compliant", "hapkit"])
def test_the_softest_wall_is_well_below_every_linear_limit_without_damping(preset: str) -> None:
    """On chawda-linear, push/(100·2 counts) would be 40 kN/m, above its undamped limit of 20 to 26 kN/m."""
    experiment = presets.load(preset)
    schemes = [Scheme.parse(text) for text in ("uniform:1k", "dual:10k/1k")]
    limit = min(theory.k_max(experiment, scheme, 0.0).stiffness for scheme in schemes)
    search = ranges.search_for(experiment, ratio=1.25, schemes=schemes)
    assert search.lowest <= 0.25 * limit * (1.0 + 1e-9)
    assert search.rungs[-1] == pytest.approx(ranges.highest_stiffness(experiment), rel=0.25)


def test_no_rung_is_added_below_the_walls_in_which_the_push_stays_in_the_window() -> None:
    """A quarter of the limit at 250 Hz is so soft that a Hapkit pushed by 0.2 N·m reaches its end stop."""
    pushed = config.override(presets.load("hapkit"), {"trial.effort": 0.2, "trial.start": -0.01})
    schemes = [Scheme.parse("uniform:250")]
    lowest = ranges.search_for(pushed, ratio=1.1, schemes=schemes).lowest
    assert lowest <= ranges.highest_stiffness(pushed) / ranges.SPAN * (1.0 + 1e-9)
    walled = replace(pushed, wall=replace(pushed.wall, stiffness=lowest))
    (check,) = [check for check in make_plan(walled).checks if check.name == "peak penetration"]
    assert check.outcome is Outcome.OK


def test_with_a_coarse_encoder_the_softest_wall_still_holds_the_push_in_the_window() -> None:
    """With 360 counts at the handle, a hundredth of the stiffest wall let the push go 7 rad deep."""
    knob = rig.new_rig(
        mechanism="lever", torque_constant=0.07, rotor_inertia=3e-5, nominal_current=1.5, encoder_lines=90,
        encoder_at="lever", transmission=1.0, handle_length=0.06, handle_mass=0.04, board="none",
    ).experiment  # fmt: skip
    lowest = ranges.search_for(knob, ratio=1.3).lowest
    walled = replace(knob, wall=replace(knob.wall, stiffness=lowest))
    (check,) = [check for check in make_plan(walled).checks if check.name == "peak penetration"]
    assert check.outcome is Outcome.OK
    refused = {check.name for check in plan_of(knob, IdentifyRequest(experiment=knob)).checks if check.remedy}
    assert {"counts of a stroke", "counts of the excitation"} <= refused
    assert all(check.outcome is Outcome.OK for check in make_plan(knob).checks)


@pytest.mark.parametrize(
    ("bounds", "text"),
    [
        ({"highest": 1e9}, r"1e\+09 \(`stiffness`\) is too high: .*at most 477"),
        ({"lowest": 0.0}, r"from 0 to .*`stiffness`"),
        ({"highest": 0.0}, r"to 0 is not a rising range.*`stiffness`"),
        ({"lowest": 50.0, "highest": 20.0}, r"from 50 to 20 is not a rising range"),
        ({"ratio": 1.0}, r"ratio of 1 .*1\.0001 to 1e6.*`ratio`"),
    ],
)
def test_bounds_without_sense_are_refused_with_their_numbers(bounds: dict[str, float], text: str) -> None:
    with pytest.raises(PlanError, match=text):
        ranges.search_for(PUSHED, **bounds)


def test_on_a_device_the_search_begins_with_the_softest_wall_that_may_be_hit() -> None:
    narrow = config.override(PUSHED, {"rig.limits.position_maximum": 0.01})

    def refused(stiffness: Any) -> Any:
        walled = replace(narrow, wall=replace(narrow.wall, stiffness=stiffness))
        return any(check.outcome is Outcome.REFUSED for check in make_plan(walled).checks)

    lowest = ranges.search_for(narrow, on_device=True).lowest
    assert not refused(lowest)
    assert refused(0.99 * lowest)


def test_dampings_go_a_little_beyond_the_widest_scheme() -> None:
    uniform = Scheme.parse("uniform:20k")
    dampings = ranges.dampings_for(HELD, (uniform, DUAL), columns=5)
    assert (dampings[0], len(dampings)) == (0.0, 5)
    assert dampings[-1] == pytest.approx(ranges.BEYOND * theory.b_max(HELD, DUAL).damping)


def test_an_estimator_without_a_linear_theory_gets_the_range_of_a_linear_one() -> None:
    levant = Scheme.parse("dual:20k/2k,estimator=levant")
    assert ranges.dampings_for(HELD, (levant,), columns=3)[-1] > 0.0
