"""Compute by linear theory whether a wall is stable and passive if each command acts some ticks after its sample."""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from rig.analysis.theory import NotLinearError, passivity_bound
from rig.config import Experiment
from rig.core.answers import ok, question, refused, skipped, warning
from rig.core.check import Check
from rig.core.errors import ConfigError
from rig.core.operators import NO_OPERATOR, hand_text
from rig.core.sample import unit_of
from rig.doctor.gate_result import ticks_text
from rig.doctor.late_loops import LateLoops, unstable_hands


@dataclass(frozen=True, slots=True)
class LateWall:
    """Stability and passivity of a wall whose commands act late: checks (passed, warning or refused) and numbers.

    By name of the modelled hand, `radius` is the spectral radius of the closed loop (1 or more: unstable) and `k_max`
    the largest stable stiffness; `passive` is the largest passive stiffness (N/m or N·m/rad), or None if not computed.
    """

    checks: tuple[Check, ...]
    radius: Mapping[str, float]
    k_max: Mapping[str, float]
    passive: float | None


def late_wall(experiment: Experiment, delay: int) -> LateWall:
    """Compute stability and passivity of an experiment's wall whose commands act `delay` ticks late.

    If linear theory does not cover the control law or the delay, the result states this in a check, without numbers.
    """
    wall = experiment.wall
    try:
        loops = LateLoops.of(experiment, delay)
        radius = loops.radius(wall.stiffness, wall.damping)
        (limits,) = loops.k_max([wall.damping])
    except ConfigError as error:
        return LateWall((_not_computed(error),), {}, {}, None)
    passive = None
    with suppress(NotLinearError):  # of an estimator that uses the effort, only the stability is known
        passive = passivity_bound(loops.by_hand[NO_OPERATOR][0], damping=wall.damping).stiffness
    checks = (
        stability(experiment, delay, radius, limits),
        *_theory_checks(experiment, loops, passive),
    )
    return LateWall(checks, radius, limits, passive)


@question("stability")
def _not_computed(error: ConfigError) -> Check:
    return skipped(f"not computed: {error.message}")


@question("stability")
def stability(
    experiment: Experiment, delay: int, radius: Mapping[str, float], limits: Mapping[str, float]
) -> Check:
    """Return a check that refuses a wall which is unstable with a modelled hand on the handle, or without one.

    `radius` is the spectral radius and `limits` the largest stable stiffness (N/m or N·m/rad), by name of the hand.
    """
    wall, unit = experiment.wall, unit_of("stiffness", experiment.rig.motion)
    hands, largest = unstable_hands(radius, wall.stiffness), min(limits.values())
    what = f"K = {wall.stiffness:g} {unit} with B = {wall.damping:g}"
    where = f"at {experiment.controller.position_rate} Hz with {ticks_text(delay)} of delay"
    limit = f"spectral radius {max(radius.values()):.4g}; largest stable K = {largest:.4g}"
    if not hands:
        return ok(f"{what} is stable {where} in every hand ({limit})")
    less = (
        f"choose `stiffness` below {_rounded_down(largest)}" if largest > 0.0 else "choose another `damping`"
    )
    return refused(
        f"{what} is unstable {where} ({', '.join(map(hand_text, hands))}; {limit})",
        f"{less}, or use a faster link or another rate; `rig doctor --url …` lists the stable walls",
    )


def _rounded_down(value: float) -> str:
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / scale) * scale:.12g}"


def _theory_checks(experiment: Experiment, loops: LateLoops, passive: float | None) -> Iterator[Check]:
    """Yield checks that only warn or inform: estimator replaced for theory, oscillation while homing, passivity."""
    if loops.stand_in:
        yield replace(warning(loops.stand_in), name="estimator")
    homing = loops.radius(experiment.homing.stiffness, experiment.homing.damping)
    worst = max(homing, key=lambda hand: homing[hand])
    if homing[worst] >= 1.0:
        radius = f"spectral radius {homing[worst]:.4g}"
        text = f"homing would oscillate in {hand_text(worst)} ({radius}), with effort up to homing.effort"
        yield replace(warning(text), name="homing")
    if passive is None:
        yield replace(skipped("no theory of it for an estimator that uses the effort"), name="passivity")
        return
    wall, unit = experiment.wall, unit_of("stiffness", experiment.rig.motion)
    kind = "passive" if wall.stiffness <= passive else "not passive (not required)"
    limit = f"the largest passive K at this damping and delay is {max(0.0, passive):.4g} {unit}"
    yield replace(ok(f"the wall is {kind}: {limit}"), name="passivity")
