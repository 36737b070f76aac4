"""Compute the controller of the loop and the parameters of the device from an experiment.

Only this file converts configured quantities to ticks, encoder counts and current quanta (smallest steps of the motor
current): the host's law (`for_experiment`) and the device's parameters (`device_parameters`) use the same values.
`prepare_controller` computes both once for a run.

Plans, trials, maps of stable walls, `rig.doctor.gate` and self tests of boards call it. It must not open a device, nor
write to one.
"""

import math
from dataclasses import asdict, replace
from functools import partial

import numpy as np

from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME
from rig.config import device_law
from rig.config._derive import free_s, motor_push, prepare_estimator, push_s, rig_model, verdict_thresholds
from rig.config._sections import OSCILLATIONS, Experiment
from rig.config.homing import home_tolerance
from rig.config.prepared_run import LawOnDevice, PreparedRun
from rig.control import cogging, friction, laws
from rig.control.estimators import Estimator
from rig.control.laws import Law
from rig.control.step import CONTROL, TRAVEL, TRAVEL_COUNTS, UNMOVED_SPEED, ControllerState, new_memory
from rig.core.board import moved_mechanics
from rig.core.errors import ConfigError, PlanError

LIFETIME_PERIODS = 5
# Beyond the duration of a trial, a person may hold the handle so long without an encoder edge.
CONFIRM_S = 1.0
SHORTEST_LIFETIME_S, LONGEST_LIFETIME_S = 0.003, 0.02
# Lifetime of a command to a law on the device (s); the host repeats the command every 5 ms.
SUPERVISE_LIFETIME_S = 0.02
# A command holds for at least so many ticks, however slow the loop. A loop for which these exceed the longest lifetime
# is too slow, and refused.
FEWEST_PERIODS = 2
I16_MAXIMUM = 32767


def resolution(experiment: Experiment) -> float:
    """Return the travel per encoder count (rad or m); negative if the position rises while the count falls."""
    encoder = experiment.rig.encoder
    return encoder.sign * encoder.resolution


def effort_quantum(experiment: Experiment, current_quantum_a: float) -> float:
    """Return the effort (N·m or N) of one current quantum, the device's smallest step of current (A)."""
    return experiment.rig.amplifier.effort_per_ampere * current_quantum_a


def current_limit(experiment: Experiment, current_quantum_a: float) -> int:
    """Return the current limit in whole current quanta (smallest steps): the rig's effort limit, rounded down."""
    # The factor makes 10.999… quanta 11: the quotient of two decimals is rounded.
    return math.floor(
        experiment.rig.limits.effort / effort_quantum(experiment, current_quantum_a) * (1.0 + 1e-12)
    )


def oscillation_limit(experiment: Experiment) -> int:
    """Return how many successive oscillations of the effort end a trial (`rig.control._watch`); 0: no limit."""
    # An excitation makes the effort oscillate itself.
    if experiment.trial.kind == "excitation":
        return 0
    limits = experiment.rig.limits
    if limits.oscillations is not None:
        return limits.oscillations
    return OSCILLATIONS if limits.human and experiment.trial.kind == "human" else 0


def energy_limit(experiment: Experiment) -> float:
    """Return the largest energy (J) that the motor may give to the handle in a trial; 0: no limit."""
    return 0.0 if experiment.trial.kind == "excitation" else experiment.rig.limits.energy or 0.0


def for_experiment(
    experiment: Experiment, *, current_quantum_a: float, reference_count: int = 0, law: Law | None = None
) -> ControllerState:
    """Return the initial state of the controller for one trial.

    Parameters
    ----------
    experiment
        Validated experiment.
    current_quantum_a
        Current quantum that the device reports (A).
    reference_count
        Encoder count at position zero.
    law
        Law to use instead of the law that the experiment names.

    Raises
    ------
    ConfigError
        Estimator or law is unknown, or its settings cannot be realised at the rates of the experiment.
    """
    rates, wall, homing, trial, limits = (
        experiment.controller,
        experiment.wall,
        experiment.homing,
        experiment.trial,
        experiment.rig.limits,
    )
    mechanics = moved_mechanics(rig_model(experiment))
    tick_s = 1.0 / rates.position_rate
    divider = rates.position_rate // rates.velocity_rate
    delta = resolution(experiment)
    quantum = effort_quantum(experiment, current_quantum_a)
    control = np.zeros(1, CONTROL)
    values = {
        "resolution": delta,
        "reference_count": reference_count,
        "tick_s": tick_s,
        "velocity_divider": divider,
        "extrapolate": 1 if rates.prediction == "extrapolate" else 0,
        "slow_multiple": rates.velocity_rate // (rates.slow_velocity_rate or rates.velocity_rate),
        "slow_speed": rates.slow_below,
        "wall_position": wall.position,
        "wall_side": wall.side,
        "passive_damping": wall.passive_damping,
        "effort_limit": current_limit(experiment, current_quantum_a) * quantum,
        "effort_quantum": quantum,
        "trial_slew": limits.slew * tick_s,
        "homing_slew": homing.slew * tick_s,
        "window_minimum": limits.position_minimum,
        "window_maximum": limits.position_maximum,
        "speed_limit": limits.speed,
        "home_target": trial.start,
        "home_step": homing.speed * tick_s,
        "home_stiffness": homing.stiffness,
        "home_damping": homing.damping,
        "home_effort": homing.effort,
        "home_tolerance": home_tolerance(experiment),
        "settle_ticks": _ticks(homing.settle_s, tick_s),
        "home_timeout_ticks": _ticks(homing.timeout_s, tick_s),
        "free_ticks": _ticks(free_s(experiment), tick_s),
        **_free_space(experiment),
        "constant_effort": motor_push(experiment),
        "trial_ticks": _ticks(trial.duration_s, tick_s),
        "hold_ticks": _ticks(trial.hold_s, tick_s),
        "release_ticks": max(1, _ticks(trial.release_s, tick_s)),
        "energy_limit": energy_limit(experiment),
        "oscillation_limit": oscillation_limit(experiment),
        "oscillation_ticks": _ticks(limits.oscillation_s, tick_s),
        "held_effort": mechanics.friction,
        "impulse_limit": 0.0 if trial.kind == "human" else UNMOVED_SPEED * limits.speed * mechanics.inertia,
        "oscillation_travel": max(TRAVEL * verdict_thresholds(experiment).moved, TRAVEL_COUNTS * abs(delta)),
    }
    for name, value in values.items():
        control[name] = value
    estimator = prepare_estimator(experiment, delta, tick_s * divider)
    if wall.position_from == "estimator":
        control["position_state"] = _position_state(estimator.estimator)
    return ControllerState(
        control=control,
        memory=new_memory(),
        estimator=estimator,
        law=_law(experiment, law or laws.get(wall.law)).prepare({**asdict(wall), "tick_s": tick_s}),
    )


def _position_state(estimator: Estimator) -> int:
    """Return 1 + the index of the estimated position in the estimator's memory (0 would select the encoder's position).

    Raise `ConfigError` for an estimator that does not estimate a position.
    """
    if estimator.position is None:
        raise ConfigError(
            f'wall.position_from = "estimator": the estimator {estimator.name} estimates no position',
            remedy='choose tracking, disturbance, disturbance-two-mass or kalman, or wall.position_from = "encoder"',
        )
    return estimator.position + 1


def _free_space(experiment: Experiment) -> dict[str, float]:
    """Return the range in which the handle must stay before the cue: ``free_minimum``, ``free_maximum`` (rad or m).

    With a wait before the cue, the range ends halfway to the wall; otherwise it is the whole allowed range of
    positions.
    """
    limits, halfway = experiment.rig.limits, 0.5 * (experiment.trial.start + experiment.wall.position)
    free = {"free_minimum": limits.position_minimum, "free_maximum": limits.position_maximum}
    if free_s(experiment) > 0.0:
        free["free_maximum" if experiment.wall.side > 0 else "free_minimum"] = halfway
    return free


def _law(experiment: Experiment, law: Law) -> Law:
    """Return `law`, wrapped in the compensation of friction and cogging if the experiment requires it."""
    rates, rig = experiment.controller, experiment.rig
    if rates.friction_compensation > 0.0:
        law = _without_friction(experiment, law)
    if rates.cogging_compensation:
        law = cogging.compensate_cogging(law, rig.cogging, rates.cogging_limit * rig.limits.nominal_effort)
    return law


def _without_friction(experiment: Experiment, law: Law) -> Law:
    """Return `law`, wrapped in a compensation of the configured share of the rig's Coulomb friction."""
    # On two masses that of the motor side alone: the link's lies behind the capstan, and compensating it from the motor
    # would add more energy than it removes.
    rates, mechanics = experiment.controller, experiment.rig.mechanics
    behind = mechanics.link_coulomb if mechanics.structure == "rigid" else 0.0
    level, cutoff = mechanics.motor_coulomb + behind, rates.parameters.get("cutoff_hz", math.inf)
    usual = friction.dead_band_of(experiment.rig.encoder.resolution, rates.velocity_rate, float(cutoff))
    wanted = friction.Compensation(
        up=level,
        down=level,
        dead_band=rates.friction_dead_band or usual,
        share=rates.friction_compensation,
    )
    return friction.compensate_friction(law, wanted)


def command_lifetime_s(experiment: Experiment) -> float:
    """Return the time (s) after which the device drops a command: as configured, or 5 ticks within 3 to 20 ms."""
    configured = experiment.controller.command_lifetime_s
    if configured is not None:
        return configured
    period_s = 1.0 / experiment.controller.position_rate
    wanted = max(LIFETIME_PERIODS * period_s, SHORTEST_LIFETIME_S)
    return max(min(wanted, LONGEST_LIFETIME_S), FEWEST_PERIODS * period_s)


def rate_of_lifetime(lifetime_s: float) -> int:
    """Return the highest position rate (Hz) at which a device by default keeps a command for `lifetime_s` (s)."""
    periods = FEWEST_PERIODS if lifetime_s > LONGEST_LIFETIME_S else LIFETIME_PERIODS
    return math.floor(periods / max(lifetime_s, SHORTEST_LIFETIME_S))


def supervise_lifetime_s(experiment: Experiment) -> float:
    """Return the time (s) after which a law on the device stops if the host sends no command."""
    configured = experiment.controller.supervise_lifetime_s
    return SUPERVISE_LIFETIME_S if configured is None else configured


def prepare_controller(
    experiment: Experiment,
    *,
    current_quantum_a: float | None = None,
    reference_count: int = 0,
    referenced: bool = False,
    verified: bool = False,
    law: Law | None = None,
) -> PreparedRun:
    """Return a prepared run: initial state of the controller on the host, and parameters of the device.

    Parameters
    ----------
    experiment
        Validated experiment to run.
    current_quantum_a
        Current quantum that the device reports (A); None: the quantum of the experiment's amplifier.
    reference_count
        Encoder count at position zero.
    referenced
        True if `reference_count` follows from the encoder's index, not from a position set by hand.
    verified
        True if the polarity of motor and encoder is verified, or if nothing can move.
    law
        Law to use instead of the law that the experiment names.

    Raises
    ------
    ConfigError
        Estimator or law is unknown, or its settings cannot be realised at the rates of the experiment.
    PlanError
        A value is out of the device's range, or the device does not support the law.
    """
    if law is not None:
        experiment = replace(experiment, wall=replace(experiment.wall, law=law.name))
    quantum = experiment.rig.amplifier.current_quantum_a if current_quantum_a is None else current_quantum_a
    controller = for_experiment(
        experiment, current_quantum_a=quantum, reference_count=reference_count, law=law
    )
    return PreparedRun(
        experiment=experiment,
        current_quantum_a=quantum,
        reference_count=reference_count,
        controller=controller,
        parameters={
            **device_parameters(experiment, controller, current_quantum_a=quantum, verified=verified),
            "reference": int(referenced),
        },
        own_law=law is not None,
        on_device=_law_on_device(experiment, controller),
    )


def _law_on_device(experiment: Experiment, controller: ControllerState) -> LawOnDevice | None:
    rates = experiment.controller
    if rates.loop != "device":
        return None
    arithmetic = device_law.arithmetic_of(rates)
    return LawOnDevice(
        arithmetic=arithmetic,
        currents_compared=not rates.wall_is_elsewhere,
        live=partial(device_law.live_parameters, controller, arithmetic),
        rendered=lambda values: asdict(device_law.rendered_wall(values, controller)),
    )


def device_parameters(
    experiment: Experiment, controller: ControllerState, *, current_quantum_a: float, verified: bool
) -> dict[str, Value]:
    """Return the value of each device parameter (`firmware_protocol.parameters`) for an experiment, by name.

    Values are in ticks, counts and quanta. With ``controller.loop = "device"`` they include the parameters of the law
    that the device runs, which are computed from the host's `controller`; otherwise the parameter ``law`` is 0.

    Raises
    ------
    PlanError
        A value is out of the range of its parameter, such as a current above 16 bits or a window beyond 32-bit counts;
        or the device does not have the law.
    """
    reference_count = int(controller.control[0]["reference_count"])
    rig, rates, human = experiment.rig, experiment.controller, experiment.trial.kind == "human"
    limits, delta = rig.limits, abs(rig.encoder.resolution)
    quantum = effort_quantum(experiment, current_quantum_a)
    lowest, highest = sorted(
        round(position / resolution(experiment)) + reference_count
        for position in (limits.position_minimum, limits.position_maximum)
    )
    values: dict[str, Value] = {
        "motion": 0 if rig.motion == "rotary" else 1,
        "encoder_sign": rig.encoder.sign,
        "position_rate": rates.position_rate,
        "reference_count": reference_count,
        "verified": 1 if verified else 0,
        "command_lifetime_us": round(command_lifetime_s(experiment) * 1e6),
        "current_limit": current_limit(experiment, current_quantum_a),
        # Rounded up and one more: the device repeats the guard's limit, and must not cut what the guard lets through.
        "slew_limit": min(65_535, math.ceil(limits.slew / rates.position_rate / quantum) + 1),
        "speed_limit": math.ceil(limits.speed / delta),
        "window_minimum": lowest,
        "window_maximum": highest,
        "continuous_current": max(1, math.floor(limits.nominal_effort / quantum)),
        "thermal_time_constant": limits.thermal_time_constant_s,
        # A person can hold the handle still against any effort: with this the device does not take that for a stall.
        # No trial requires that for longer than its own length: after that the encoder may be dead.
        "hold_to_run": 1 if human else 0,
        "confirm_ms": round(1e3 * (push_s(experiment) + CONFIRM_S)) if human else 0,
        "law": 0,
    }
    if rates.loop == "device":
        values |= device_law.law_parameters(controller, device_law.arithmetic_of(rates))
        values |= {
            "batch_layout": device_law.batch_layout(experiment),
            "batch_samples": device_law.batch_samples(experiment),
            "supervise_lifetime_us": round(supervise_lifetime_s(experiment) * 1e6),
        }
    for name, value in values.items():
        if not BY_NAME[name].accepts(value):
            parameter = BY_NAME[name]
            raise PlanError(
                f"{name} = {value:g} {parameter.unit} is out of range for the device: allowed are "
                f"{parameter.minimum:g} to {parameter.maximum:g}",
                remedy="change the limit, the rate or the current quantum from which it is computed",
            )
    return values


def _ticks(duration_s: float, tick_s: float) -> int:
    return round(duration_s / tick_s)
