"""Z-width maps: walls against exact linear theory, and the same bits however a map was computed."""

import json
import math
from typing import Any

import pytest

from rig import config
from rig.analysis import theory
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import PlanError
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.experiments.mapping import zwidth as maps
from rig.experiments.mapping._maps import zwidth
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import MapPlan, ZWidth
from tests.conformance.tiers import first_by_default

SHORT = {"trial.duration_s": 0.4, "verdict.tail_s": 0.1, "homing.settle_s": 0.02}
DUAL, UNIFORM = Scheme.parse("dual:20k/2k"), Scheme.parse("uniform:20k")

# No friction, 4000 times as many counts, currents as fine as the wire carries: the rest is linear. The hand
# presses all along and neither trembles nor swells, and the trial is long.
LINEAR = {
    "rig.mechanics.motor_coulomb": 0.0, "rig.mechanics.link_coulomb": 0.0, "homing.tolerance_counts": 4000.0,
    "rig.encoder.counts_per_revolution": 4_000_000, "rig.amplifier.current_quantum_a": 2e-4, "rig.limits.slew": 1e7,
    "rig.limits.human": False,  # linear theory has no limit of effort
    "trial.kind": "human", "operator.grip": "normal", "operator.tremor": 0.0, "operator.press_modulation": 0.0,
    "trial.duration_s": 3.0, "verdict.tail_s": 0.4,
}  # fmt: skip


def plan_map(**changes: Any) -> Any:
    given = {
        "experiment": config.override(presets.load("koul-compliant"), SHORT),
        "schemes": (DUAL, UNIFORM),
        "dampings": (0.0, 0.5),
        "search": StiffnessSearch(lowest=5.0, highest=300.0, ratio=2.0),
        "repeats": 2,
    }
    return MapPlan(**{**given, **changes})


def test_two_workers_give_the_bits_of_one_and_repeats_and_offsets_differ() -> None:
    one, two = (zwidth(plan_map(), workers=workers) for workers in (1, 2))
    assert json.dumps([*one.series]) == json.dumps([*two.series])
    of = {tuple(row[k] for k in ("scheme", "damping", "offset", "repeat")): row for row in one.table()}
    assert len({of["dual:20k/2k", 0.5, offset, n]["contact_s"] for offset in (0.1, 0.6) for n in (0, 1)}) > 1


@pytest.mark.parametrize(
    ("scheme", "damping"),
    first_by_default(
        [
            ("uniform:20k", 0.0),
            ("uniform:2k", 0.0),
            ("dual:20k/2k", 0.0),
            ("dual:20k/2k", 1.0),
            ("uniform:2k", 1.0),
            ("uniform:20k", 0.1),
        ],
        2,
    ),
)
def test_without_friction_and_quantum_the_limit_is_that_of_linear_theory(scheme: str, damping: float) -> None:
    # Below the limit the ringing dies out more slowly the nearer it is: after three seconds a rung or two are lost.
    experiment, of = config.override(presets.load("koul-compliant"), LINEAR), Scheme.parse(scheme)
    expected = theory.k_max(experiment, of, damping).stiffness
    search = StiffnessSearch(way="bisection", lowest=0.7 * expected, highest=1.3 * expected, ratio=1.02)
    one = {"schemes": (of,), "dampings": (damping,), "offsets": (0.1,)}
    found = zwidth(MapPlan(experiment=experiment, search=search, **one))
    (limit,) = found.curve(0, "heard")
    assert limit.capped == 0
    assert limit.stiffness == pytest.approx(expected, rel=0.04)


def rows_of(outcomes: Any, **numbers: Any) -> Any:
    """Return rows of one series as `run_series` returns them; `outcomes` maps stiffness to passed or failed."""
    tail = {"tail_begins_s": 0.1, "inside_ticks_in_tail": 1}
    measured = dict.fromkeys(maps.NUMBERS.names, 0.0) | tail | numbers
    truths = {f"{name}_true": value for name, value in measured.items()}
    return [
        {"stiffness": k, "kind": "stable", **measured, **truths}
        | {f"passes_{c}{suffix}": passes for c in ("felt", "heard", "any") for suffix in ("", "_true")}
        for k, passes in outcomes.items()
    ]


def one_scheme(dampings: Any) -> Any:
    return plan_map(schemes=(DUAL,), dampings=dampings, offsets=(0.1,), repeats=1)


def test_caps_islands_and_the_end_of_the_range_are_reported() -> None:
    found = ZWidth.of(
        one_scheme((0.0, 1.0, 2.0)),
        [
            rows_of({10.0: True, 20.0: True}),  # never fails: a cap
            rows_of({10.0: True, 20.0: False, 40.0: True, 80.0: True}),  # an island
            rows_of({10.0: False}),
        ],
    )
    first, second, third = found.curve(0, "felt")
    assert (first.stiffness, first.capped) == (20.0, 1)
    assert (second.stiffness, second.capped, second.limits[0].islands) == (10.0, 0, ((40.0, 80.0),))
    assert (third.stiffness, third.capped) == (0.0, 0)
    width = found.width(0, "felt")
    assert (width.stiffness_undamped, width.undamped_capped, width.capped) == (20.0, True, True)
    assert (width.damping_range, width.range_capped) == (1.0, False)
    assert width.area == pytest.approx(15.0)
    found = ZWidth.of(one_scheme((0.0, 1.0)), [rows_of({10.0: True, 20.0: False})] * 2)
    width = found.width(0, "any")
    assert (width.damping_range, width.range_capped, width.capped) == (1.0, True, False)


def test_invalid_hits_are_counted_by_their_reason() -> None:
    found = ZWidth.of(
        one_scheme((0.0, 1.0)),
        [
            rows_of({10.0: None, 20.0: None}, slew_bound_ticks=3.0),
            rows_of({10.0: None}, contact_s=math.nan) + rows_of({20.0: True}),
        ],
    )
    assert found.invalid() == {"slew bound": 2, "never touched": 1}
    assert found.as_mapping()["invalid"] == found.invalid()
    assert [b.unknown for b in found.curve(0, "any")] == [2, 1]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"schemes": ()}, r"schemes \(`scheme`\): the list is empty"),
        ({"schemes": (DUAL, Scheme.parse("dual:20000/2000"))}, r"dual:20k/2k is given twice"),
        ({"dampings": ()}, r"dampings \(`damping`\): the list is empty"),
        ({"dampings": (0.0, -1.0)}, r"dampings \(`damping`\): -1 is out of range.*at least 0"),
        ({"dampings": (math.nan,)}, r"nan is out of range"),
        ({"dampings": (0.5, 0.5)}, r"0.5 is given twice"),
        ({"offsets": (1.0,)}, r"offsets \(`offsets`\): 1 is out of range.*less than 1"),
        ({"repeats": 0}, "`repeats` = 0"),
    ],
)
def test_a_plan_without_sense_is_refused_with_option_value_and_range(changes: Any, text: str) -> None:
    with pytest.raises(PlanError, match=text):
        plan_map(**changes)


def test_a_handle_that_never_comes_home_passes_and_fails_no_criterion() -> None:
    """The end mass is too heavy for the homing servo, so there is no trial to judge."""
    heavy = {"rig.mechanics.gravity": 9.81, "homing.effort": 0.05}
    simulator = HitSimulator(config.override(presets.load("koul-compliant"), heavy))
    hit = simulator.hit(300.0, 0.5)
    assert hit.true.numbers["ticks"] == 0
    assert [hit.true.passes(criterion) for criterion in ("felt", "heard", "any")] == [None] * 3
