"""Compute values from an experiment: rig model, excitation size, verdict thresholds; check its estimator and law.

`rig.config` exports these functions. They must not change an experiment that they receive.
"""

from __future__ import annotations

import random
from dataclasses import replace
from typing import TYPE_CHECKING, TypedDict

from rig.config._problems import Problem, config_error, did_you_mean
from rig.config._sections import Experiment, Rig
from rig.config._table import shown
from rig.control import estimators, laws
from rig.control.estimators import Prepared
from rig.control.verdict import Thresholds
from rig.core.errors import ConfigError
from rig.core.model import OperatorReach, RigModel

if TYPE_CHECKING:
    from collections.abc import Sequence


# Rms of an excitation over the Coulomb friction, so that friction hardly distorts the motion.
ABOVE_COULOMB = 10.0
# On a rig with little friction the rms is at least this share of the effort limit.
SHARE_OF_LIMIT = 0.02


def rig_model(described: Experiment | Rig) -> RigModel:
    """Return the physical model of a rig, for simulation and theory.

    If a person performs the experiment's trial, the model includes the hand and its movement to the wall, but not the
    mass at the end of the link.
    """
    rig = described.rig if isinstance(described, Experiment) else described
    model = RigModel(
        name=rig.name,
        motion=rig.motion,
        mechanics=rig.mechanics,
        amplifier=rig.amplifier,
        encoder=rig.encoder,
        simulation=rig.simulation,
        reference=rig.reference,
        cogging=rig.cogging,
        board=tuple(sorted(rig.board.items())),
    )
    if isinstance(described, Rig) or described.trial.kind != "human":
        return model
    return model.held_by(described.operator, _reach(described))


def free_s(experiment: Experiment) -> float:
    """Return how long (s) the person waits in free space before the cue: baseline time plus random foreperiod.

    The foreperiod is drawn uniformly between 0 and `trial.foreperiod_s`, by the seed `trial.seed`.
    """
    trial = experiment.trial
    return trial.baseline_s + random.Random(f"foreperiod {trial.seed}").uniform(0.0, trial.foreperiod_s)


def _reach(experiment: Experiment) -> OperatorReach:
    depth = experiment.operator.depth / experiment.rig.mechanics.handle_radius
    return OperatorReach(
        start=experiment.trial.start,
        target=experiment.wall.position + experiment.wall.side * depth,
        pace=experiment.homing.speed,
        wait_s=experiment.homing.settle_s + free_s(experiment) + experiment.operator.begin_s,
        free_s=free_s(experiment),
        seed=experiment.trial.seed,
    )


def motor_push(experiment: Experiment) -> float:
    """Return the constant effort of the motor's push in a trial (N·m or N); 0 with a person or an excitation."""
    return experiment.trial.effort if experiment.trial.kind == "constant-effort" else 0.0


def push_s(experiment: Experiment) -> float:
    """Return the longest duration (s) of the push in a trial: `trial.hold_s`, or if it is 0, `trial.duration_s`."""
    return experiment.trial.hold_s or experiment.trial.duration_s


def push_at_rest(experiment: Experiment) -> float:
    """Return the effort (N·m or N, at least 0) by which the motor or the hand presses a resting handle on the wall."""
    wall = experiment.wall
    if experiment.trial.kind != "human":
        return max(0.0, wall.side * motor_push(experiment))
    operator, radius = experiment.operator, experiment.rig.mechanics.handle_radius
    if wall.stiffness == 0.0 or operator.pads_stiffness == 0.0:
        return 0.0
    # The hand ends short of its intention by the depth of the handle in the wall and the give of the pads.
    give = operator.hand_stiffness * (1.0 / operator.pads_stiffness + radius**2 / wall.stiffness)
    return (operator.press + operator.hand_stiffness * operator.depth) / (1.0 + give) * radius


def press_for(experiment: Experiment, push: float) -> float:
    """Return the force (N, at the handle) with which a hand must press so that a handle rests on the wall with `push`.

    `push` is an effort of the link (N·m or N); the spring of the simulated hand adds to the press.
    """
    operator, given = experiment.operator, push_at_rest(experiment)
    if given == 0.0:
        return operator.press
    spring = operator.hand_stiffness * operator.depth
    return (operator.press + spring) * push / given - spring


class Size(TypedDict, total=False):
    """Size of an excitation: either its rms or its peak effort (N·m or N), by the keys ``rms`` and ``peak``."""

    rms: float
    peak: float


def excitation_size(experiment: Experiment) -> Size:
    """Return the size of the excitation (N·m or N): either its rms or its peak.

    If the experiment gives neither, the rms is ten times the Coulomb friction, so that friction hardly distorts the
    motion, but at least 2 % of the effort limit.
    """
    given, mechanics = experiment.excitation, experiment.rig.mechanics
    if given.peak is not None:
        return {"peak": given.peak}
    if given.rms is not None:
        return {"rms": given.rms}
    coulomb = mechanics.motor_coulomb + mechanics.link_coulomb
    return {"rms": max(ABOVE_COULOMB * coulomb, SHARE_OF_LIMIT * experiment.rig.limits.effort)}


def excitation_s(experiment: Experiment) -> tuple[float, float]:
    """Return the duration (s) of a run with excitation, and the duration (s) of its settling periods (not analysed)."""
    given = experiment.excitation
    return (given.settle_periods + given.periods) * given.period_s, given.settle_periods * given.period_s


def excited(experiment: Experiment) -> Experiment:
    """Return a copy of the experiment whose trial excites the handle at the wall by a multisine instead of a push."""
    trial = replace(
        experiment.trial,
        kind="excitation",
        effort=0.0,
        start=experiment.wall.position,
        duration_s=excitation_s(experiment)[0],
    )
    return replace(experiment, trial=trial)


def verdict_thresholds(experiment: Experiment) -> Thresholds:
    """Return the thresholds for judging a trial, converted from the handle to the link (rotary rig: rad and N·m)."""
    given, radius = experiment.verdict, experiment.rig.mechanics.handle_radius
    return Thresholds(
        tail_s=given.tail_s,
        highpass_hz=given.highpass_hz,
        lowpass_hz=given.lowpass_hz,
        felt_velocity=given.felt_velocity / radius,
        heard_effort=given.heard_force * radius,
        moved=given.moved / radius,
        growth=given.growth_ratio,
        late_fraction=given.late_fraction,
        saturated_fraction=given.saturated_fraction,
        longest_gap=given.longest_gap,
        lost_fraction=given.lost_fraction,
        may_leave=experiment.trial.kind == "human",
    )


def check_plugins(experiment: Experiment, source: str) -> None:
    """Check the names of estimator and law and the estimator's settings, which `load_experiment` does not check.

    The function imports the estimator, and with it numba; code that plans or runs an experiment calls it first.

    Raises
    ------
    ConfigError
        A name is unknown (the message has the closest known name), or a setting is unknown or out of range.
    """
    controller = experiment.controller
    problems: list[Problem] = []
    # Looking for plug-ins takes longer than everything else here.
    if controller.estimator not in estimators.BUILT_IN:
        problems += _unknown("controller.estimator", controller.estimator, estimators.names())
    if experiment.wall.law not in laws.BUILT_IN:
        problems += _unknown("wall.law", experiment.wall.law, laws.names())
    if problems:
        raise config_error(problems, source)
    resolution = experiment.rig.encoder.sign * experiment.rig.encoder.resolution
    try:
        prepare_estimator(experiment, resolution, 1.0 / controller.velocity_rate)
    except ConfigError as error:
        problem = Problem("controller.parameters", "", error.message, error.remedy)
        raise config_error([problem], source) from None


def prepare_estimator(experiment: Experiment, resolution: float, period_s: float) -> Prepared:
    """Return the experiment's velocity estimator, ready to run; raise `ConfigError` if a setting does not fit the rate.

    `resolution` is the travel per encoder count (rad or m), `period_s` the time between two velocity samples (s). A
    setting about the rig that the experiment leaves out, such as the inertia, is taken from the rig's mechanics.
    """
    estimator = estimators.get(experiment.controller.estimator)
    own = estimator.settings_of(settings_of_rig(experiment))
    return estimator.prepare({**own, **experiment.controller.parameters}, resolution, period_s)


def settings_of_rig(rig: Experiment | RigModel) -> dict[str, float]:
    """Return the properties of a rig that are settings of estimators, in a trial, without a hand (SI units).

    They are ``inertia``, its parts ``motor_inertia`` and ``link_inertia``, and ``transmission_stiffness``, which is 0
    for a rigid rig.
    """
    mechanics = (rig if isinstance(rig, RigModel) else rig_model(rig)).mechanics
    stiffness = mechanics.transmission_stiffness if mechanics.structure == "two-mass" else 0.0
    return {
        "inertia": mechanics.inertia,
        "motor_inertia": mechanics.motor_inertia,
        "link_inertia": mechanics.loaded_link_inertia,
        "transmission_stiffness": stiffness,
    }


def _unknown(key: str, name: str, known: Sequence[str]) -> list[Problem]:
    if name in known:
        return []
    return [
        Problem(
            key,
            shown(name),
            f"must be one of {', '.join(known)}",
            did_you_mean(name, known, f"set {key} to one of the listed names"),
        )
    ]
