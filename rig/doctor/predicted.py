"""Predict from an experiment's description whether homing, the push to the wall and the current measurement will work.

`rig experiment plan`, hits and the arming gate call it. Each check that fails names the keys and values with which it
would pass. The rig is modelled as one rigid mass with friction and weight. It must not open a device.
"""

from __future__ import annotations

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


def predict_checks(x: Experiment, ticks: int) -> list[Check]:
    """Return all checks that an experiment's description allows, for commands that act `ticks` late."""
    return [*homing_checks(x, ticks), *_approach_checks(x), *_current_checks(x)]


def homing_checks(x: Experiment, ticks: int) -> list[Check]:
    """Check that the homing servo, with commands `ticks` late, is strong, stable, fast and accurate enough."""
    return [
        _homing_effort(x),
        _homing_stability(x, ticks),
        _homing_slew(x),
        _homing_resolution(x, ticks),
        _homing_offset(x, ticks),
        _homing_time(x),
        speed_reading(x),
    ]


def speed_reading(x: Experiment) -> Check:
    """Check that one encoder count is not estimated as a speed above rig.limits.speed, which would end the run."""
    reading, limit = highest_reading(x, x.homing.speed), x.rig.limits.speed
    unit = unit_of("velocity", x.rig.motion)
    text = (
        f"one count is estimated as up to {reading:.3g} {unit} ({x.controller.estimator} at "
        f"{x.controller.velocity_rate} Hz, moving at homing.speed = {x.homing.speed:g} {unit}); allowed by "
        f"rig.limits.speed: {limit:g} {unit}"
    )
    higher = round_up(reading / COUNT_SPEED_SHARE)
    filtered = f"choose an estimator with more filtering, or set rig.limits.speed = {higher:g}"
    return finding("speed reading", reading <= limit, text, quieter_changes(x), filtered)


def quieter_changes(x: Experiment) -> dict[str, float]:
    """Return a lower cut-off (Hz) of the velocity filter, as a mapping from the key that sets it.

    With this cut-off, one encoder count is estimated as at most half of the speed limit. The mapping is empty if the
    present cut-off is low enough, or if no cut-off is.
    """
    most = COUNT_SPEED_SHARE * x.rig.limits.speed
    if highest_reading(x) <= most or (cutoff := quiet_cutoff(x, most)) is None:
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


def _homing_effort(x: Experiment) -> Check:
    held, effort, limits = holding_effort(x), x.homing.effort, x.rig.limits
    least = ABOVE_FRICTION * held + x.rig.amplifier.effort_quantum
    unit = unit_of("effort", x.rig.motion)
    text = (
        f"homing.effort of {effort:.3g} {unit} against {held:.3g} {unit} of friction, weight and cogging; "
        f"required at least {least:.3g} {unit}"
    )
    wanted = round_up(min(max(servos.stable_servo(x).effort, SPARE * least), limits.effort))
    if wanted < least:
        return finding(
            "homing effort",
            effort >= least,
            text,
            remedy="rig.limits.effort is too low: use a stronger motor, or correct the described friction",
        )
    return finding("homing effort", effort >= least, text, {"homing.effort": wanted})


def _gains(x: Experiment, ticks: int) -> dict[str, float]:
    servo = servos.stable_servo(x, max(ticks, servos.SPARE_TICKS))
    return {"homing.stiffness": servo.stiffness, "homing.damping": servo.damping}


def _homing_stability(x: Experiment, ticks: int) -> Check:
    margin = servos.phase_margin(x, x.homing.stiffness, x.homing.damping, ticks)
    text = (
        f"stiffness {x.homing.stiffness:g}, damping {x.homing.damping:g} at {x.controller.position_rate} Hz: "
        f"phase margin {math.degrees(margin):.2g}°, required at least {math.degrees(LEAST_MARGIN):.2g}°"
    )
    # Of the free handle: a hand damps it, by how much is not described.
    otherwise = Outcome.WARNING if x.trial.kind == "human" else Outcome.REFUSED
    return finding("homing stability", margin >= LEAST_MARGIN, text, _gains(x, ticks), otherwise=otherwise)


def _homing_slew(x: Experiment) -> Check:
    """Check that homing.slew (change of effort per second) is high enough to damp the homing servo's oscillation."""
    h = x.homing
    natural = math.sqrt(h.stiffness / servos.inertia(x))
    least = h.effort * natural / servos.SLOWEST_RISE
    unit = unit_of("effort", x.rig.motion)
    text = (
        f"{h.slew:.3g} {unit}/s for homing.effort {h.effort:.3g} {unit} at {natural:.3g} rad/s; "
        f"required at least {least:.3g} {unit}/s"
    )
    return finding(
        "homing slew", h.slew >= least, text, {"homing.slew": round_up(least * servos.SLOWEST_RISE)}
    )


def _homing_resolution(x: Experiment, ticks: int) -> Check:
    """Check that one encoder count changes the homing servo's effort only by a small share of the effort it has."""
    h, unit = x.homing, unit_of("effort", x.rig.motion)
    delta, stiffest = x.rig.encoder.resolution, servos.stiffest_for_counts(x, h.effort, servos.COUNT_SHARE)
    text = (
        f"one count changes the spring's effort by {h.stiffness * delta:.3g} {unit}; allowed at most "
        f"{stiffest * delta:.3g} {unit} (from half of homing.effort and twice the friction)"
    )
    return finding("homing resolution", h.stiffness <= stiffest, text, _gains(x, ticks))


def _homing_offset(x: Experiment, ticks: int) -> Check:
    """Check that friction cannot hold the handle too far from the trial's start: 3/4 of the distance to the wall."""
    # A person brings the handle to its start; an excitation has no approach.
    if x.trial.kind != "constant-effort":
        return Check("homing offset", Outcome.OK, "not relevant: no push begins at trial.start")
    delta, unit = x.rig.encoder.resolution, unit_of("position", x.rig.motion)
    offset, tolerance, largest = servos.resting_offset(x), home_tolerance(x), servos.largest_offset(x)
    text = (
        f"friction can hold the handle {offset:.3g} {unit} ({offset / delta:.1f} counts) away from trial.start; homing "
        f"accepts {tolerance:.3g} {unit} (homing.tolerance_counts = {x.homing.tolerance_counts:g}); allowed at most "
        f"{largest:.3g}, three quarters of the distance to the wall"
    )
    if tolerance <= largest:
        return finding("homing offset", True, text)
    nearest = servos.nearest_tolerance(x)
    # The servo reaches the start all the same, but the trial may begin before it does: a warning.
    if ABOVE_FRICTION * offset <= largest:
        tighter = {"homing.tolerance_counts": nearest} if nearest < x.homing.tolerance_counts else {}
        return finding("homing offset", not tighter, text, tighter, otherwise=Outcome.WARNING)
    changes: dict[str, float] = {}
    least = SPARE * ABOVE_FRICTION * holding_effort(x) / servos.usual_offset(x)
    if x.homing.stiffness < least:
        changes = _gains(x, ticks)
    reached = ABOVE_FRICTION * holding_effort(x) / changes.get("homing.stiffness", x.homing.stiffness)
    if x.homing.tolerance_counts > nearest:
        changes["homing.tolerance_counts"] = nearest
    way = SPARE * max(reached, nearest * delta) / USUAL_SHARE
    if way > abs(x.wall.position - x.trial.start):
        start, limits = x.wall.position - x.wall.side * round_up(way), x.rig.limits
        if not limits.position_minimum < start < limits.position_maximum:
            held = f"{holding_effort(x):.3g} {unit_of('effort', x.rig.motion)}"
            remedy = f"reduce the friction, {held}; or widen the position window beyond {start:.3g} {unit}"
            return Check("homing offset", Outcome.REFUSED, text, remedy)
        changes["trial.start"] = start
    return finding("homing offset", False, text, changes)


def _homing_time(x: Experiment) -> Check:
    """Check that homing.timeout_s suffices for the longest distance to the trial's start in the position window."""
    limits, simulation = x.rig.limits, x.rig.simulation
    ends = (limits.position_minimum, limits.position_maximum)
    begins = (simulation.initial_position,) if simulation.initial_position is not None else ends
    way = max(abs(x.trial.start - begin) for begin in begins)
    settles = SETTLES * max(
        x.homing.damping / x.homing.stiffness, servos.inertia(x) / max(x.homing.damping, 1e-300)
    )
    needed = way / x.homing.speed + min(settles, 10.0) + x.homing.settle_s
    unit, given = unit_of("position", x.rig.motion), x.homing.timeout_s
    text = f"takes up to {needed:.3g} s from a distance of {way:.3g} {unit}; homing.timeout_s = {given:g}"
    return finding(
        "homing time",
        needed <= given,
        text,
        {"homing.timeout_s": round_up(needed * SPARE)},
        otherwise=Outcome.WARNING,
    )


def _approach_checks(x: Experiment) -> Iterator[Check]:
    """Yield checks that the constant push of an automated trial moves the handle and reaches the wall in time."""
    if x.trial.kind != "constant-effort":
        return
    unit, held, push = unit_of("effort", x.rig.motion), holding_effort(x), abs(motor_push(x))
    least = ABOVE_FRICTION * held + x.rig.amplifier.effort_quantum
    text = (
        f"push of {push:.3g} {unit} against a holding effort of {held:.3g} {unit}; required at least {least:.3g} "
        f"{unit}"
    )
    wanted = x.wall.side * round_up(SPARE * least)
    if abs(wanted) > x.rig.limits.effort:
        yield finding("push", push >= least, text, remedy="use a stronger motor, or reduce the friction")
    else:
        yield finding("push", push >= least, text, {"trial.effort": wanted})
    net = push - held
    if push < least or x.wall.stiffness == 0.0:
        return
    yield _unseen_speed(x, net)
    way = abs(x.wall.position - x.trial.start) + min(home_tolerance(x), servos.largest_offset(x))
    viscous = rig_model(x).damping
    needed = math.sqrt(2.0 * servos.inertia(x) * way / net) + viscous * way / net
    before = push_s(x) - x.verdict.tail_s
    duration = round_up(SPARE * (needed + x.verdict.tail_s))
    text = f"the wall is reached within {needed:.3g} s; the judged tail begins after {before:.3g} s"
    # A warning: tests of a link or a recording push for milliseconds and mean no contact (`rig.testing`).
    yield finding(
        "approach", needed < before, text, {"trial.duration_s": duration}, otherwise=Outcome.WARNING
    )


def _unseen_speed(x: Experiment, net: float) -> Check:
    """Check that a push stays slow within two counts; a fast handle with a still count would mean a dead encoder."""
    inertia, unit = servos.inertia(x), unit_of("velocity", x.rig.motion)
    way, limit = UNMOVED_COUNTS * x.rig.encoder.resolution, UNMOVED_SPEED * x.rig.limits.speed
    speed = math.sqrt(2.0 * net * way / inertia)
    slower = x.wall.side * _down(holding_effort(x) + inertia * (limit / SPARE) ** 2 / (2.0 * way))
    text = f"up to {speed:.3g} {unit} within two counts; from {limit:.3g} {unit} on a dead encoder would be suspected"
    return finding("unseen speed", speed < limit, text, {"trial.effort": slower})


def _current_checks(x: Experiment) -> Iterator[Check]:
    """Yield a check of the smallest difference (A) between commanded and measured current that can be detected."""
    model, amplifier = rig_model(x), x.rig.amplifier
    sensor = current_sensor(model)
    if sensor.noise < 0.0 or not amplifier.current_monitor:
        return
    quantum, rate = amplifier.current_quantum_a, x.controller.position_rate
    early, late = (
        math.floor(0.5 * sensor.delay_s * rate + 1e-9),
        math.ceil(2.0 * sensor.delay_s * rate - 1e-9),
    )
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
    push_a = abs(motor_push(x)) / amplifier.effort_per_ampere
    seen = x.trial.kind != "constant-effort" or push_a >= least_a
    yield finding(
        "current monitor",
        seen,
        text if seen else f"{text}, but the push sets only {push_a:.2g} A: a fault would not be detected",
        remedy="push harder, or describe the sensor's noise (rig.amplifier.current_noise_a)",
        otherwise=Outcome.WARNING,
    )
