"""Predict from an experiment's description whether homing, the push to the wall and the current measurement will work.

`rig experiment plan`, hits and the arming gate call it. Each check that fails names the keys and values with which it
would pass. The rig is modelled as one rigid mass with friction and weight. It must not open a device.
"""

import math
from collections.abc import Callable, Iterator, Mapping

from rig.config import Experiment, amplifiers, motor_push, push_s, rig_model
from rig.config import homing as servos
from rig.config.homing import ABOVE_FRICTION, USUAL_SHARE, holding_effort, home_tolerance
from rig.config.velocity_reading import CUTOFF, highest_reading, quiet_cutoff
from rig.control.current import SIGMAS
from rig.control.step import UNMOVED_COUNTS, UNMOVED_SPEED
from rig.core.board import current_sensor
from rig.core.check import Check, Outcome
from rig.core.sample import unit_of
from rig.doctor._late_walls import late_wall

__all__ = [
    "COUNT_SPEED_SHARE",
    "LEAST_MARGIN",
    "QUIET_SHARE",
    "SETTLES",
    "SPARE",
    "finding",
    "homing_checks",
    "late_wall",
    "predict_checks",
    "quieter_changes",
    "round_up",
    "speed_reading",
]

# A named value exceeds the least value that works, or stays below the largest one, by this factor.
SPARE = 1.1
# The homing servo is considered at rest after this many of its time constants.
SETTLES = 10.0
# Least phase margin of homing: with 1.5° single counts kept the handle of a randomly generated rig moving.
LEAST_MARGIN = math.radians(2.0)
# With a named change, one count is estimated as at most this share of the speed limit.
COUNT_SPEED_SHARE = 0.5
# A current must be above the noise in this share of a window's ticks, or it is not compared.
QUIET_SHARE = 0.9


def predict_checks(experiment: Experiment, ticks: int) -> list[Check]:
    """Return the checks of homing, approach and currents of an experiment whose commands act `ticks` late."""
    return [*homing_checks(experiment, ticks), *_approach_checks(experiment), *_current_checks(experiment)]


def homing_checks(experiment: Experiment, ticks: int) -> list[Check]:
    """Check that the homing servo, with commands `ticks` late, is strong, stable, fast and accurate enough."""
    return [
        _homing_effort(experiment),
        _homing_stability(experiment, ticks),
        _homing_slew(experiment),
        _homing_resolution(experiment, ticks),
        _homing_offset(experiment, ticks),
        _homing_time(experiment),
        speed_reading(experiment),
    ]


def speed_reading(experiment: Experiment) -> Check:
    """Check that one encoder count is not estimated as a speed above rig.limits.speed, which would end the run."""
    reading, limit = highest_reading(experiment, experiment.homing.speed), experiment.rig.limits.speed
    unit = unit_of("velocity", experiment.rig.motion)
    text = (
        f"one count is estimated as up to {reading:.3g} {unit} ({experiment.controller.estimator} at "
        f"{experiment.controller.velocity_rate} Hz, moving at homing.speed = {experiment.homing.speed:g} {unit}); "
        f"allowed by rig.limits.speed: {limit:g} {unit}"
    )
    higher = round_up(reading / COUNT_SPEED_SHARE)
    filtered = f"choose another estimator or more filtering, or set rig.limits.speed = {higher:g}"
    if math.isinf(reading):
        filtered = "choose another estimator or other settings: its velocity grows without bound"
    return finding("speed reading", reading <= limit, text, quieter_changes(experiment), filtered)


def quieter_changes(experiment: Experiment) -> dict[str, float]:
    """Return a lower cut-off (Hz) of the velocity filter, as a mapping from the key that sets it.

    With this cut-off, one encoder count is estimated as at most half of the speed limit. The mapping is empty if the
    present cut-off is low enough, or if no cut-off is.
    """
    most = COUNT_SPEED_SHARE * experiment.rig.limits.speed
    if highest_reading(experiment) <= most or (cutoff := quiet_cutoff(experiment, most)) is None:
        return {}
    return {f"controller.parameters.{CUTOFF}": _down(cutoff)}


def finding(
    name: str,
    holds: bool,
    text: str,
    changes: Mapping[str, float] | None = None,
    remedy: str = "",
    otherwise: Outcome = Outcome.REFUSED,
) -> Check:
    """Return a passed check if `holds` is True, otherwise a check with the outcome `otherwise` (refused or warning).

    The remedy of a failed check lists `changes` (key: value) with which it would pass, or is the text `remedy`.
    """
    if holds:
        return Check(name, Outcome.OK, text)
    changes = changes or {}
    named = " and ".join(f"{key} = {value:g}" for key, value in changes.items())
    return Check(name, otherwise, text, f"set {named}" if named else remedy, changes=changes)


def round_up(value: float) -> float:
    """Return a value rounded up to three significant digits."""
    return _round(value, math.ceil)


def _down(value: float) -> float:
    return _round(value, math.floor)


def _round(value: float, way: Callable[[float], int]) -> float:
    if value == 0.0 or not math.isfinite(value):
        return value
    scale = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    return float(f"{way(value / scale) * scale:.12g}")


def _homing_effort(experiment: Experiment) -> Check:
    held, effort, limits = holding_effort(experiment), experiment.homing.effort, experiment.rig.limits
    least = ABOVE_FRICTION * held + experiment.rig.amplifier.effort_quantum
    unit = unit_of("effort", experiment.rig.motion)
    text = (
        f"homing.effort of {effort:.3g} {unit} against {held:.3g} {unit} of friction, weight and cogging; "
        f"required at least {least:.3g} {unit}"
    )
    wanted = round_up(min(max(servos.stable_servo(experiment).effort, SPARE * least), limits.effort))
    if wanted < least:
        return finding(
            "homing effort",
            effort >= least,
            text,
            remedy="rig.limits.effort is too low: use a stronger motor, or correct the described friction",
        )
    return finding("homing effort", effort >= least, text, {"homing.effort": wanted})


def _gains(experiment: Experiment, ticks: int) -> dict[str, float]:
    servo = servos.stable_servo(experiment, max(ticks, servos.SPARE_TICKS))
    return {"homing.stiffness": servo.stiffness, "homing.damping": servo.damping}


def _homing_stability(experiment: Experiment, ticks: int) -> Check:
    stiffness, damping = experiment.homing.stiffness, experiment.homing.damping
    margin = servos.phase_margin(experiment, stiffness, damping, ticks)
    text = (
        f"stiffness {stiffness:g}, damping {damping:g} at {experiment.controller.position_rate} Hz: "
        f"phase margin {math.degrees(margin):.2g}°, required at least {math.degrees(LEAST_MARGIN):.2g}°"
    )
    # Of the free handle: a hand damps it, by how much is not described.
    otherwise = Outcome.WARNING if experiment.trial.kind == "human" else Outcome.REFUSED
    stable = margin >= LEAST_MARGIN
    return finding("homing stability", stable, text, _gains(experiment, ticks), otherwise=otherwise)


def _homing_slew(experiment: Experiment) -> Check:
    """Check that homing.slew (change of effort per second) is high enough to damp the homing servo's oscillation."""
    h = experiment.homing
    natural = math.sqrt(h.stiffness / servos.inertia(experiment))
    least = h.effort * natural / servos.SLOWEST_RISE
    unit = unit_of("effort", experiment.rig.motion)
    text = (
        f"{h.slew:.3g} {unit}/s for homing.effort {h.effort:.3g} {unit} at {natural:.3g} rad/s; "
        f"required at least {least:.3g} {unit}/s"
    )
    return finding(
        "homing slew", h.slew >= least, text, {"homing.slew": round_up(least * servos.SLOWEST_RISE)}
    )


def _homing_resolution(experiment: Experiment, ticks: int) -> Check:
    """Check that one encoder count changes the homing servo's effort only by a small share of the effort it has."""
    h, unit = experiment.homing, unit_of("effort", experiment.rig.motion)
    delta = experiment.rig.encoder.resolution
    stiffest = servos.stiffest_for_counts(experiment, h.effort, servos.COUNT_SHARE)
    text = (
        f"one count changes the spring's effort by {h.stiffness * delta:.3g} {unit}; allowed at most "
        f"{stiffest * delta:.3g} {unit} (from half of homing.effort and twice the friction)"
    )
    return finding("homing resolution", h.stiffness <= stiffest, text, _gains(experiment, ticks))


def _homing_offset(experiment: Experiment, ticks: int) -> Check:
    """Check that friction cannot hold the handle too far from the trial's start: 3/4 of the distance to the wall."""
    # A person brings the handle to its start; an excitation has no approach.
    if experiment.trial.kind != "constant-effort":
        return Check("homing offset", Outcome.OK, "not relevant: no push begins at trial.start")
    delta, unit = experiment.rig.encoder.resolution, unit_of("position", experiment.rig.motion)
    offset, largest = servos.resting_offset(experiment), servos.largest_offset(experiment)
    tolerance, accepted = home_tolerance(experiment), experiment.homing.tolerance_counts
    text = (
        f"friction can hold the handle {offset:.3g} {unit} ({offset / delta:.1f} counts) away from trial.start; homing "
        f"accepts {tolerance:.3g} {unit} (homing.tolerance_counts = {accepted:g}); allowed at most "
        f"{largest:.3g}, three quarters of the distance to the wall"
    )
    if tolerance <= largest:
        return finding("homing offset", True, text)
    nearest = servos.nearest_tolerance(experiment)
    # The servo reaches the start all the same, but the trial may begin before it does: a warning.
    if ABOVE_FRICTION * offset <= largest:
        tighter = {"homing.tolerance_counts": nearest} if nearest < accepted else {}
        return finding("homing offset", not tighter, text, tighter, otherwise=Outcome.WARNING)
    changes: dict[str, float] = {}
    held, stiffness = holding_effort(experiment), experiment.homing.stiffness
    if stiffness < SPARE * ABOVE_FRICTION * held / servos.usual_offset(experiment):
        changes = _gains(experiment, ticks)
    reached = ABOVE_FRICTION * held / changes.get("homing.stiffness", stiffness)
    if accepted > nearest:
        changes["homing.tolerance_counts"] = nearest
    way = SPARE * max(reached, nearest * delta) / USUAL_SHARE
    if way > abs(experiment.wall.position - experiment.trial.start):
        start, limits = experiment.wall.position - experiment.wall.side * round_up(way), experiment.rig.limits
        if not limits.position_minimum < start < limits.position_maximum:
            friction = f"{held:.3g} {unit_of('effort', experiment.rig.motion)}"
            remedy = (
                f"reduce the friction, {friction}; or widen the position window beyond {start:.3g} {unit}"
            )
            return Check("homing offset", Outcome.REFUSED, text, remedy)
        changes["trial.start"] = start
    return finding("homing offset", False, text, changes)


def _homing_time(experiment: Experiment) -> Check:
    """Check that homing.timeout_s suffices for the longest distance to the trial's start in the position window."""
    limits, simulation = experiment.rig.limits, experiment.rig.simulation
    ends = (limits.position_minimum, limits.position_maximum)
    begins = (simulation.initial_position,) if simulation.initial_position is not None else ends
    way = max(abs(experiment.trial.start - begin) for begin in begins)
    settles = SETTLES * max(
        experiment.homing.damping / experiment.homing.stiffness,
        servos.inertia(experiment) / max(experiment.homing.damping, 1e-300),
    )
    needed = way / experiment.homing.speed + min(settles, 10.0) + experiment.homing.settle_s
    unit, given = unit_of("position", experiment.rig.motion), experiment.homing.timeout_s
    text = f"takes up to {needed:.3g} s from a distance of {way:.3g} {unit}; homing.timeout_s = {given:g}"
    return finding(
        "homing time",
        needed <= given,
        text,
        {"homing.timeout_s": round_up(needed * SPARE)},
        otherwise=Outcome.WARNING,
    )


def _approach_checks(experiment: Experiment) -> Iterator[Check]:
    """Yield checks that the constant push of an automated trial moves the handle and reaches the wall in time."""
    if experiment.trial.kind != "constant-effort":
        return
    unit = unit_of("effort", experiment.rig.motion)
    held, push = holding_effort(experiment), abs(motor_push(experiment))
    least = ABOVE_FRICTION * held + experiment.rig.amplifier.effort_quantum
    text = (
        f"push of {push:.3g} {unit} against a holding effort of {held:.3g} {unit}; required at least {least:.3g} "
        f"{unit}"
    )
    wanted = experiment.wall.side * round_up(SPARE * least)
    if abs(wanted) > experiment.rig.limits.effort:
        yield finding("push", push >= least, text, remedy="use a stronger motor, or reduce the friction")
    else:
        yield finding("push", push >= least, text, {"trial.effort": wanted})
    net = push - held
    if push < least or experiment.wall.stiffness == 0.0:
        return
    yield _unseen_speed(experiment, net)
    offset = min(home_tolerance(experiment), servos.largest_offset(experiment))
    way = abs(experiment.wall.position - experiment.trial.start) + offset
    viscous = rig_model(experiment).damping
    needed = math.sqrt(2.0 * servos.inertia(experiment) * way / net) + viscous * way / net
    before = push_s(experiment) - experiment.verdict.tail_s
    duration = round_up(SPARE * (needed + experiment.verdict.tail_s))
    text = f"the wall is reached within {needed:.3g} s; the judged tail begins after {before:.3g} s"
    # A warning: tests of a link or a recording push for milliseconds and mean no contact (`rig.testing`).
    yield finding(
        "approach", needed < before, text, {"trial.duration_s": duration}, otherwise=Outcome.WARNING
    )


def _unseen_speed(experiment: Experiment, net: float) -> Check:
    """Check that a push stays slow within two counts; a fast handle with a still count would mean a dead encoder."""
    inertia, unit = servos.inertia(experiment), unit_of("velocity", experiment.rig.motion)
    way = UNMOVED_COUNTS * experiment.rig.encoder.resolution
    limit = UNMOVED_SPEED * experiment.rig.limits.speed
    speed = math.sqrt(2.0 * net * way / inertia)
    accelerating = inertia * (limit / SPARE) ** 2 / (2.0 * way)
    slower = experiment.wall.side * _down(holding_effort(experiment) + accelerating)
    text = f"up to {speed:.3g} {unit} within two counts; from {limit:.3g} {unit} on a dead encoder would be suspected"
    return finding("unseen speed", speed < limit, text, {"trial.effort": slower})


def _current_checks(experiment: Experiment) -> Iterator[Check]:
    """Yield a check of the smallest difference (A) between commanded and measured current that can be detected."""
    model, amplifier = rig_model(experiment), experiment.rig.amplifier
    sensor = current_sensor(model)
    if sensor.noise < 0.0 or not amplifier.current_monitor:
        return
    quantum, rate = amplifier.current_quantum_a, experiment.controller.position_rate
    early = math.floor(0.5 * sensor.delay_s * rate + 1e-9)
    late = math.ceil(2.0 * sensor.delay_s * rate - 1e-9)
    least_a = SIGMAS * sensor.noise * quantum / QUIET_SHARE
    text = (
        f"compared with the set-point {early} to {late} ticks before, after a lag of {1e6 * amplifier.lag_s:.3g} µs; "
        f"a dead motor is detected above {least_a:.2g} A"
    )
    steps = amplifiers.load(amplifier.profile).steps
    step_a = 2.0 * amplifier.effort_limit / amplifier.effort_per_ampere / steps if steps else 0.0
    if step_a > 2.0 * least_a:
        yield finding(
            "current monitor",
            False,
            f"steps of the set-point are {step_a:.2g} A ({amplifier.profile}), half of which is more than the "
            f"{least_a:.2g} A that rig.amplifier.current_quantum_a = {quantum:g} allows as a difference",
            {"rig.amplifier.current_quantum_a": round_up(step_a)},
            otherwise=Outcome.WARNING,
        )
        return
    push_a = abs(motor_push(experiment)) / amplifier.effort_per_ampere
    seen = experiment.trial.kind != "constant-effort" or push_a >= least_a
    yield finding(
        "current monitor",
        seen,
        text if seen else f"{text}, but the push sets only {push_a:.2g} A: a fault would not be detected",
        remedy="push harder, or describe the sensor's noise (rig.amplifier.current_noise_a)",
        otherwise=Outcome.WARNING,
    )
