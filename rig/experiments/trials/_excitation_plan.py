"""Plan and check an excited run: linear theory predicts the peaks of effort, position and speed before any motion.

`rig.experiments.trials.plan` calls this module. The predicted peaks are too large, because friction is neglected.
Growing oscillations of an unstable wall are not predicted, but the check of stability warns of them.
"""

from dataclasses import replace

from rig import config
from rig.analysis.impedance import bare, rendered_impedance
from rig.analysis.theory import Lifted, LinearLoop, linear_loop, with_linear_wall
from rig.config import Experiment
from rig.config.schemes import STAND_IN, usual_settings
from rig.control.excitation import Peak
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError
from rig.core.sample import Motion, unit_of
from rig.experiments.trials.excitation_run import multisine_of
from rig.experiments.trials.planned import Plan, Step, heat_check, limited, where_it_runs

RENDERED = "peak motor effort"  # name of a check of `rig.control.excitation.Multisine.check`


def excitation_plan(experiment: Experiment) -> Plan:
    """Return the plan (steps and checks) of an impedance measurement."""
    experiment = config.excited(experiment)
    checks = (*excitation_checks(experiment), *_heat_checks(experiment))
    return Plan(experiment.rig.name, experiment.excitation.realisations, _steps(experiment), checks)


def excitation_checks(experiment: Experiment) -> list[Check]:
    """Check that an excitation stays within the limits of effort, position and speed, as predicted by linear theory.

    The prediction neglects friction and instability, and replaces an estimator without a frequency response by
    `rig.config.schemes.STAND_IN`. The check of stability replaces it only if it is not linear.
    """
    motion, limits, wall = experiment.rig.motion, experiment.rig.limits, experiment.wall
    centre, loop, excitation = wall.position, _linear_loop(experiment), experiment.excitation
    responding = loop if loop.estimator.of_effort is None else _linear_loop(_with_stand_in(experiment))
    multisines = [multisine_of(experiment, number) for number in range(excitation.realisations)]
    lines = multisines[0].lines_hz
    whole, alone = rendered_impedance(responding, wall.stiffness, wall.damping, lines), bare(loop, lines)
    motor = excitation.channel == "motor"
    bounds = {
        "effort_limit": min(limits.effort, experiment.rig.amplifier.effort_limit) if motor else None,
        "position_limit": min(limits.position_maximum - centre, centre - limits.position_minimum),
        "speed_limit": limits.speed,
    }
    most: dict[str, Peak] = {}
    for multisine in multisines:
        for check in multisine.check(
            whole, wall=whole - alone, motor_limit=limits.effort, channel=excitation.channel, **bounds
        ):
            if check.name not in most or not check.value <= most[check.name].value:
                most[check.name] = check
    remedies = {
        "effort": "reduce the excitation (excitation.rms), or choose a softer wall",
        "position": "reduce the excitation, raise the lower end of the band (excitation.low_hz), or choose a "
        "stiffer wall",
        "velocity": "reduce the excitation",
    }
    stability = _stability_checks(experiment, loop)
    # For an unstable wall the predicted motion is not valid: warn, do not refuse.
    moved = Outcome.REFUSED if all(check.outcome == Outcome.OK for check in stability) else Outcome.WARNING
    worst = {"effort": Outcome.REFUSED, "position": moved, "velocity": moved}
    most_rendered = most.pop(RENDERED, None)
    checks = [
        Check(
            found.name,
            Outcome.OK if found.holds else worst[found.quantity],
            f"{found.value:.3g} {unit_of(found.quantity, motion)}"
            + ("" if found.limit is None else f", limit {found.limit:g}"),
            remedies[found.quantity],
        )
        for found in most.values()
    ]
    if most_rendered is not None:
        checks.append(_rendered_check(most_rendered, motion))
    return [*checks, *stability]


def _rendered_check(found: Peak, motion: Motion) -> Check:
    """Warn if the rendered effort exceeds its limit: it will be clipped, which is safe but spoils the measurement."""
    return limited(
        found.name,
        found.holds,
        f"{found.value:.3g} {unit_of(found.quantity, motion)}, limit {found.limit:g}",
        "the effort will be clipped: reduce the excitation, or choose a softer wall",
        Outcome.WARNING,
    )


def _linear_loop(experiment: Experiment) -> LinearLoop:
    """Return the loop's model for linear theory; a non-linear estimator or wall is replaced by a linear one."""
    experiment, fixed = with_linear_wall(experiment), replace(experiment.controller, slow_velocity_rate=None)
    try:
        return linear_loop(replace(experiment, controller=fixed))
    except ConfigError:
        return linear_loop(_with_stand_in(replace(experiment, controller=fixed)))


def _with_stand_in(experiment: Experiment) -> Experiment:
    own = experiment.controller
    usual = replace(own, estimator=STAND_IN, parameters=usual_settings(STAND_IN, own.velocity_rate))
    return replace(experiment, controller=usual)


def _stability_checks(experiment: Experiment, loop: LinearLoop) -> list[Check]:
    if experiment.wall.stiffness == 0.0 and experiment.wall.damping == 0.0:
        return []
    radius = float(Lifted.of(loop).radius(experiment.wall.stiffness, experiment.wall.damping))
    own, used = experiment.controller.estimator, loop.controller.estimator
    other = "" if used == own else f" with {used} in place of {own}"
    return [
        limited(
            "stability",
            radius < 1.0,
            f"spectral radius {radius:.4f} by linear theory{other}, both sides of the wall",
            "the guard may end the run; friction may prevent this",
            Outcome.WARNING,
        )
    ]


def _steps(experiment: Experiment) -> tuple[Step, ...]:
    position, effort = (unit_of(q, experiment.rig.motion) for q in ("position", "effort"))
    e, w, c = experiment.excitation, experiment.wall, experiment.controller
    ((size, value),) = config.excitation_size(experiment).items()
    whole_s, settling_s = config.excitation_s(experiment)
    stiffness, damping = (unit_of(quantity, experiment.rig.motion) for quantity in ("stiffness", "damping"))
    wall = f"{w.stiffness:g} {stiffness}, {w.damping:g} {damping}"
    who = "the rig's own motor" if e.channel == "motor" else "a second actuator"
    return (
        Step(
            "configure",
            f"position {c.position_rate} Hz, velocity {c.velocity_rate} Hz by {c.estimator}, "
            f"{where_it_runs(experiment)}",
            0.0,
        ),
        Step(
            "home",
            f"to the wall at {w.position:g} {position}",
            experiment.homing.timeout_s if e.channel == "motor" else 0.0,
        ),
        Step(
            "excite",
            f"{who}: {e.kind} multisine, {e.low_hz:g} to {e.high_hz:g} Hz every {1.0 / e.period_s:g} Hz, "
            f"{size} {value:.3g} {effort}, about a bilateral wall of {wall}; {settling_s:g} s to settle, "
            f"{e.periods} periods of {e.period_s:g} s",
            whole_s,
        ),
        Step("estimate", "impedance, passivity and fidelity from all realisations", 0.0),
    )


def _heat_checks(experiment: Experiment) -> list[Check]:
    """Check the heat of the motor if the rig's own motor excites the rig; else return an empty list."""
    if experiment.excitation.channel != "motor":
        return []
    seconds = experiment.excitation.realisations * config.excitation_s(experiment)[0]
    rms, remedy = multisine_of(experiment).rms, "reduce the excitation, or shorten it"
    return [heat_check(experiment, rms, seconds, remedy)]
