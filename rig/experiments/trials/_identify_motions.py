"""Compute the motions of an identification, and the plan that lists them: pushes, strokes, sweeps and excitation.

`identification`, `motion` and `rig.experiments.trials.plan` call this module. All numbers follow from the described rig
and its limits; no device is opened here.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.analysis.identification import LEAST_MOTION_COUNTS, PIECES, SETTLE_S, UNSTEADY, Stroke
from rig.config import Experiment
from rig.config.homing import holding_effort
from rig.config.velocity_reading import COUNT_PEAK
from rig.control import bilateral
from rig.control.excitation import Multisine
from rig.control.laws import Law
from rig.control.motions import make_nudging_law, make_tracing_law
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError
from rig.core.sample import Phase, unit_of
from rig.doctor.predicted import SPARE, finding, round_up
from rig.experiments.trials.planned import Plan, Step, limited

Floats = NDArray[np.float64]

SLOW_RATE = 2000  # highest rate of pushes and strokes (Hz)
# Proposed rates are multiples of this (Hz), so that the usual period of the excitation, 0.5 s, has whole samples.
RATE_STEP = 50
# Effort of a trial that must not push, as a fraction of the effort limit: above 0 by rule, and below any quantum.
NO_PUSH = 1e-12
MARGIN_COUNTS = 1.0  # distance from the start of a trial to its wall (counts)

# Pushes: number, travel (counts), largest effort as a fraction of the nominal effort, longest duration (s), rest (s).
PUSHES, PUSH_COUNTS, PUSH_SHARE, PUSH_S, REST_S = 6, 30, 0.3, 1.5, 0.2
# With a coarse encoder, whose brake acts late: half of the window over the travel of a push, and shortest
# travel (counts).
COARSE_ROOM, LEAST_PUSH_COUNTS = 3.0, 8
PUSH_RISE_S = 0.05  # duration of a push's travel without friction (s)
PUSH_COULOMB = 5.0  # multiple of the described friction that the effort may reach in `PUSH_S`
# Largest speed of the handle at the end of a push, as a fraction of the speed limit; the rest is for its ramp down.
UNSEEN_SPEED = 0.92
# Release time of a push on a board (s): this computer ends the run, as the slew limit lets the effort fall slowly.
PUSH_END_S = 0.01
PUSH_WINDOW, PUSH_SPEED = 20.0, 200.0  # limits of position and speed, in travels of a push (and per second)
BRAKE_S = 0.02  # time constant of the brake after a push
# Smallest ratio of a push's effort to the described friction at which friction is distinguishable from a dead motor.
OBSERVABLE = 1.5
PUSHES_ROOM = 2.5  # travels of a push to one side that the window must contain: two pushes with braking

# Strokes: half their travel as a fraction of the window, durations (s), and highest speed as a fraction of its limit.
TRAVEL_SHARE, STROKES_S, STROKE_SPEED = 0.2, (0.4, 0.8, 1.6), 0.3
# Fewest counts of a stroke: ten counts in a third of the evaluated part of the second stroke.
LEAST_STROKE_COUNTS = 45
# Largest position error by friction as a fraction of half the travel: the handle must slide for a third of its stroke.
HELD_OF_TRAVEL = 0.5
MOST_SLOWING = 16.0  # largest factor by which strokes are slowed, so that a soft servo reaches their speed
WAY_SPEED, WAY_REST_S = 5.0, 0.3  # slow motion: speed limit over its speed, and rest at its end (s)
WAY_END_S = 0.02  # slow motion on a board: duration of the trial after homing (s)
WAY_PATIENCE_S = 5.0  # slow motion on a board: timeout besides twice its duration (s)
HANG_S, WEIGHING_SHARES = (
    2.0,
    (1.0, 0.5),
)  # weighing: time to let go of the load (s); speeds over homing's speed
CUTOFF_SHARE = 0.2  # cut-off of the velocity filter over its rate
# Largest velocity that the filter may report for one count, as a fraction of the speed limit.
COUNT_SHARE = 0.4
FILTER_DELAY = 0.225  # delay of the filter times its cut-off, √2/(2π)
SERVO_TICKS, SERVO_PHASE = (
    3.0,
    0.5,
)  # additional delay of the servo's loop (ticks), and its largest phase loss (rad)

# Sweeps for cogging: half their travel as a fraction of the window; speeds of the pairs over the highest speed; the
# servo's corner frequency over the frequency of the highest harmonic at this speed; rest at each end (s).
SWEEP_SHARE, SWEEP_SPEEDS, FOLLOWS, SWEEP_REST_S = 0.42, (1.0, 0.8, 0.6), 6.0, 0.3

# Excitation: band (Hz), and its highest frequency as a fraction of the rate; settling time (s), fewest settling
# periods, and analysed periods.
LOWEST_HZ, HIGHEST_HZ, HIGHEST_SHARE = 4.0, 1000.0, 0.15
EXCITATION_SETTLE_S, LEAST_SETTLE, PERIODS = 1.0, 2, 2
LINES_PER_OCTAVE = 16
# Below this frequency the amplitudes are proportional to the frequency, else the motion would be too large.
EVEN_FROM_HZ = 25.0
CENTRING_HZ = 2.5  # natural frequency of the handle on the soft spring that centres it
# Fractions of the limits that the excitation may use.
EFFORT_SHARE, RMS_SHARE, POSITION_SHARE, SPEED_SHARE = 0.6, 0.9, 0.5, 0.5
# From this ratio of the excitation's rms effort to Coulomb friction on, friction widens the interval of the inertia by
# at most 0.1 %, with two masses by 1 %.
HARD = 5.0


@dataclass(frozen=True, slots=True)
class IdentificationMotion:
    """A motion that identification records as a trial: its experiment, control law, and phases to evaluate.

    `law` is None if the experiment's own law runs.
    """

    experiment: Experiment
    law: Law | None
    phases: tuple[Phase, ...] = (Phase.TRIAL,)


def identification_plan(
    experiment: Experiment, *, realisations: int, period_s: float, seed: int, cogging: int | None = None
) -> Plan:
    """Return the plan (steps and checks) of an identification, computed from the described rig; no device is opened.

    `realisations` is the number of runs with other random phases, `period_s` the excitation's period (s). `cogging`,
    the highest harmonic of cogging to identify, adds slow sweeps.
    """
    limits = experiment.rig.limits
    effort, position, speed = (_unit(experiment, quantity) for quantity in ("effort", "position", "velocity"))
    multisine = excitation(experiment, seed, period_s, experiment.rig.mechanics.inertia)
    impedance = _free_impedance(experiment, experiment.rig.mechanics.inertia)
    fastest = multisine.velocity(impedance).peak
    half = 0.5 * (limits.position_maximum - limits.position_minimum)
    coulomb = coulomb_of(experiment)
    rms_load = multisine.rms / limits.nominal_effort
    travel, top_speed = TRAVEL_SHARE * 2.0 * half, max(abs(s.velocity) for s in strokes_of(experiment)[1])
    settings: tuple[Step, ...] = (
        Step(
            "pushes",
            f"{PUSHES} pushes of at most {most_push(experiment):.3g} {effort}, each until the handle has "
            f"moved {push_way(experiment):.3g} {position}",
            pushes_s(),
        ),
        Step(
            "strokes",
            f"± {travel:.3g} {position} about the middle of the window at up to {top_speed:.3g} {speed}",
            strokes_of(experiment)[0][-1][0],
        ),
        Step(
            "excitation",
            f"{realisations} × {excited_s(period_s):.3g} s, {multisine.lines_hz[0]:g} to "
            f"{multisine.lines_hz[-1]:g} Hz, {multisine.rms:.3g} {effort} rms",
            realisations * excited_s(period_s),
        ),
    )
    checks: tuple[Check, ...] = (
        _check("push", most_push(experiment), limits.effort, effort, "raise rig.limits.effort"),
        _check("stroke speed", top_speed, limits.speed, speed, "raise rig.limits.speed"),
        _check_following(experiment, HELD_OF_TRAVEL * travel),
        _check_stroke_counts(experiment, travel),
        _check_excitation_counts(experiment, multisine.position(impedance).rms),
        _check(
            "peak effort of the excitation", multisine.peak, limits.effort, effort, "raise rig.limits.effort"
        ),
        _check(
            "peak position of the excitation",
            multisine.position(impedance).peak,
            half,
            position,
            "widen the window",
        ),
        _check("peak speed of the excitation", fastest, limits.speed, speed, "raise rig.limits.speed"),
        _check("motor heat", rms_load, 1.0, "of the nominal effort, rms", "lower rig.limits.effort"),
        Check(
            "excitation over friction",
            Outcome.OK if multisine.rms >= HARD * coulomb else Outcome.WARNING,
            f"{multisine.rms:.3g} {effort} rms, Coulomb friction {coulomb:.3g}",
            "the intervals of inertia and delay will be wide: raise rig.limits (effort, speed, positions)",
        ),
    )
    if cogging is not None:
        sweeps = cogging_sweeps(experiment, cogging)[1]
        way, most = sweeps[0].velocity * (sweeps[0].end_s - sweeps[0].begin_s), abs(sweeps[0].velocity)
        settings += (
            Step(
                "sweeps",
                f"{len(sweeps)} slow sweeps of {way:.3g} {position} at {most:.3g} {speed} or less, in "
                "both directions",
                sweeps[-1].end_s + SWEEP_REST_S,
            ),
        )
        measured = way - 2.0 * SETTLE_S * most
        checks += (_check_repeatable(experiment), _check_whole_period(experiment, measured))
    return Plan(experiment.rig.name, 1, settings, checks)


def loaded_plan(plan: Plan, experiment: Experiment, most_order: int, weight: float) -> Plan:
    """Return `plan` with added sweeps for cogging that run with a mass on the rig, to measure torque ripple.

    `weight` is the load (N·m or N), `experiment` has the rig with the mass, `most_order` is the highest harmonic.
    """
    position, effort = _unit(experiment, "position"), _unit(experiment, "effort")
    limits = experiment.rig.limits
    sweeps = cogging_sweeps(experiment, most_order, loaded=True)[1]
    room = (0.5 - SWEEP_SHARE) * (limits.position_maximum - limits.position_minimum)
    stiffness, _ = servo_of(experiment, slow_rate(experiment))
    sags = (weight + coulomb_of(experiment) + experiment.rig.cogging.crest) / stiffness
    step = Step(
        "loaded sweeps",
        f"{len(sweeps)} sweeps again, with {weight:.3g} {effort} hung on the rig",
        sweeps[-1].end_s + SWEEP_REST_S,
    )
    sag = _check(
        "sag under the mass", sags, room, position, "hang a smaller mass, or widen the window of positions"
    )
    return replace(plan, steps=(*plan.steps, step), checks=(*plan.checks, sag))


def _check_following(experiment: Experiment, limit: float) -> Check:
    """Check that friction keeps the handle within `limit` (rad or m) of the set-point of the position servo."""
    stiffness = servo_of(experiment, slow_rate(experiment))[0]
    # A slower loop permits only a softer servo, whose position error by friction is larger.
    held, unit = coulomb_of(experiment) / stiffness, _unit(experiment, "position")
    # The servo's stiffness grows with the square of the rate; a factor of 3 leaves a margin.
    stiffer = math.sqrt(3.0 * held / limit)
    enough = RATE_STEP * math.ceil(experiment.controller.position_rate * stiffer / RATE_STEP)
    return limited(
        "friction under the strokes",
        held <= limit,
        f"friction keeps the handle {held:.3g} {unit} behind the set point of a servo at "
        f"{experiment.controller.position_rate} Hz, limit {limit:.3g}",
        f"choose `rate` {enough} or more, raise homing.damping, or widen the window",
    )


def _check_stroke_counts(experiment: Experiment, travel: float) -> Check:
    """Check that a stroke of ± `travel` (rad or m) has enough encoder counts to measure its speed in a third of it."""
    resolution = experiment.rig.encoder.resolution
    counts, wider = 2.0 * travel / resolution, LEAST_STROKE_COUNTS * resolution
    return limited(
        "counts of a stroke",
        counts >= LEAST_STROKE_COUNTS,
        f"a stroke has {counts:.0f} counts, at least {LEAST_STROKE_COUNTS} are needed",
        f"widen the window of positions to {0.5 * wider / TRAVEL_SHARE:.3g} {_unit(experiment, 'position')} or "
        "more, or use a finer encoder",
    )


def _check_excitation_counts(experiment: Experiment, rms: float) -> Check:
    """Check that the excitation moves the handle by enough counts; `rms` is its motion without friction (rad or m)."""
    counts = rms / experiment.rig.encoder.resolution
    return limited(
        "counts of the excitation",
        counts >= LEAST_MOTION_COUNTS,
        f"{counts:.2g} counts rms without friction, at least {LEAST_MOTION_COUNTS:g} are needed",
        f"use an encoder with {math.ceil(2.0 * LEAST_MOTION_COUNTS / counts)} times the counts, or "
        "allow more effort (rig.limits.effort, rig.limits.nominal_effort)",
    )


def _check_repeatable(experiment: Experiment) -> Check:
    """Check that position zero comes from an index pulse, so that it is the same after each start of the device."""
    if experiment.rig.reference.index:
        return Check("position zero", Outcome.OK, "comes from the encoder's index")
    return Check(
        "position zero",
        Outcome.REFUSED,
        "is the position of the handle at the start: a map of cogging would be wrong after the next start",
        "wire the encoder's index, with a limit switch where the motor turns more than once, and describe it in "
        "[rig.reference]",
    )


def _check_whole_period(experiment: Experiment, measured: float) -> Check:
    """Check that the sweeps measure a whole period of cogging, to separate its harmonics; `measured` in rad or m."""
    period, unit = cogging_period(experiment), _unit(experiment, "position")
    return limited(
        "period of cogging",
        period <= measured,
        f"{period:.3g} {unit}, the sweeps measure {measured:.3g}",
        "widen the window of positions, or correct rig.cogging.period if the true period is shorter",
    )


def cogging_period(experiment: Experiment) -> float:
    """Return the travel after which cogging repeats (rad or m).

    The travel is `rig.cogging.period`, or without that key one turn of motor and rotary encoder. Raise `ConfigError`
    for a linear rig without that key.
    """
    if experiment.rig.cogging.period is not None:
        return experiment.rig.cogging.period
    if experiment.rig.motion == "linear":
        raise ConfigError(
            "rig.cogging.period is not given, so the travel after which the motor's cogging repeats "
            "is unknown",
            remedy="give rig.cogging.period: the pitch of a linear motor's magnets, or the travel for "
            "one turn of the pinion",
        )
    return 2.0 * math.pi / experiment.rig.encoder.ratio


def pushes_motion(experiment: Experiment, at: float, pushes: int = PUSHES) -> IdentificationMotion:
    """Return a motion of small pushes from the position `at` (rad or m), with a small window and speed limit."""
    limits, way, rate = experiment.rig.limits, push_way(experiment), slow_rate(experiment)
    speed = min(limits.speed, PUSH_SPEED * way)
    changes = {
        "rig.limits.position_minimum": max(limits.position_minimum, at - PUSH_WINDOW * way),
        "rig.limits.position_maximum": min(limits.position_maximum, at + PUSH_WINDOW * way),
        "rig.limits.speed": speed,
        # Homing must do nothing while the signs are not known.
        "homing.stiffness": 1e-12,
        "homing.damping": 0.0,
        "homing.speed": 0.5 * speed,
        "homing.tolerance_counts": 1e6,
        "homing.settle_s": REST_S,
    }
    law = make_nudging_law(
        effort_per_s=push_growth(experiment),
        most_effort=most_push(experiment),
        moved=way,
        rest_s=REST_S,
        brake=experiment.rig.mechanics.inertia / BRAKE_S,
        pulses=pushes,
        rate_hz=rate,
    )
    return IdentificationMotion(_set_motion(experiment, at, pushes_s(pushes), rate, changes), law)


def single_push(experiment: Experiment, at: float, way: Literal[-1, 1]) -> Experiment:
    """Return one push from `at` (rad or m) in the direction `way`, as a trial that every board can run by itself."""
    # The window, not the law, ends the push: in the tick in which the handle has moved by its travel, for any signs of
    # motor and encoder. The slew limit lets the effort grow slowly, and the wall has no stiffness.
    around, length = pushes_motion(experiment, at).experiment, push_way(experiment)
    most, growth = most_push(experiment), push_growth(experiment)
    limits = around.rig.limits
    changes = {
        "rig.limits.position_minimum": max(limits.position_minimum, at - length),
        "rig.limits.position_maximum": min(limits.position_maximum, at + length),
        "rig.limits.slew": growth,
        "rig.simulation.initial_position": at,
        "wall.position": at + way * MARGIN_COUNTS * experiment.rig.encoder.resolution,
        "wall.side": way,
        "trial.effort": way * most,
        "trial.duration_s": most / growth,
        "trial.release_s": PUSH_END_S,
        "verdict.tail_s": 0.5 * most / growth,
    }
    return config.override(around, changes, "a push")


def strokes_motion(experiment: Experiment) -> IdentificationMotion:
    """Return a motion of strokes at constant speeds, driven by a position servo with at most the nominal effort."""
    path, _ = strokes_of(experiment)
    limit = min(experiment.rig.limits.effort, experiment.rig.limits.nominal_effort)
    rate = slow_rate(experiment)
    stiffness, damping = servo_of(experiment, rate)
    law = make_tracing_law(path, stiffness=stiffness, damping=damping, limit=limit, rate_hz=rate)
    changes = _homing_changes(experiment, rate)
    return IdentificationMotion(_set_motion(experiment, path[0][1], path[-1][0], rate, changes), law)


def way_motion(experiment: Experiment, at: float, to: float, margin: float) -> IdentificationMotion:
    """Return a slow motion from `at` to `to` (rad or m) by a position servo, with homing's speed and effort.

    The window is the travel plus `margin` (rad or m) at both ends, in place of the described window.
    """
    rate, way_s = slow_rate(experiment), abs(to - at) / experiment.homing.speed
    on_board = experiment.controller.loop == "device"
    stiffness, damping = servo_of(experiment, rate)
    effort = min(experiment.homing.effort, experiment.rig.limits.nominal_effort)
    low, high = min(at, to) - margin, max(at, to) + margin
    changes = {
        **_homing_changes(experiment, rate),
        "homing.effort": effort,
        "rig.limits.effort": effort,
        "rig.limits.speed": min(
            experiment.rig.limits.speed,
            max(WAY_SPEED * experiment.homing.speed, PUSH_SPEED * push_way(experiment)),
        ),
        "rig.limits.position_minimum": low,
        "rig.limits.position_maximum": high,
        # The initial position must be inside the window, also if a simulated rig is elsewhere.
        "rig.simulation.initial_position": at,
        "rig.reference.travel": max(high - low, experiment.rig.reference.travel or 0.0),
    }
    if on_board:
        changes |= {
            "homing.settle_s": WAY_REST_S,
            "homing.timeout_s": min(600.0, 2.0 * way_s + WAY_PATIENCE_S),
        }
        # The board's homing makes this motion; the trial after it does nothing.
        moved = _set_motion(experiment, to, WAY_END_S, rate, changes)
        return IdentificationMotion(moved, None, (Phase.HOMING, Phase.SETTLE, Phase.TRIAL))
    law = make_tracing_law(
        [(0.0, at), (way_s, to)], stiffness=stiffness, damping=damping, limit=effort, rate_hz=rate
    )
    return IdentificationMotion(_set_motion(experiment, at, way_s + WAY_REST_S, rate, changes), law)


def weighing_motion(experiment: Experiment) -> IdentificationMotion:
    """Return a motion of slow strokes under a steady load, which the servo holds with at most the nominal effort."""
    rate = slow_rate(experiment)
    limit = min(experiment.rig.limits.effort, experiment.rig.limits.nominal_effort)
    stiffness, damping = servo_of(experiment, rate)
    path, _ = weighing_strokes(experiment)
    law = make_tracing_law(path, stiffness=stiffness, damping=damping, limit=limit, rate_hz=rate)
    changes = _loaded_homing(experiment, rate, limit)
    return IdentificationMotion(_set_motion(experiment, path[0][1], path[-1][0], rate, changes), law)


def _loaded_homing(experiment: Experiment, rate: int, limit: float) -> dict[str, Any]:
    """Return by key the changes of [homing] for a loaded rig: effort up to `limit` (N·m or N), room for the sag."""
    hangs = limit / servo_of(experiment, rate)[0] / experiment.rig.encoder.resolution
    return {
        **_homing_changes(experiment, rate),
        "homing.effort": limit,
        "homing.tolerance_counts": min(1e6, experiment.homing.tolerance_counts + hangs),
    }


def weighing_strokes(experiment: Experiment) -> tuple[list[tuple[float, float]], list[Stroke]]:
    """Return path (time in s, position in rad or m) and list of the strokes, at homing's speed and at half of it."""
    travel = TRAVEL_SHARE * (experiment.rig.limits.position_maximum - experiment.rig.limits.position_minimum)
    start, time_s = _middle(experiment) - travel, HANG_S
    path, strokes = [(0.0, start), (time_s, start)], []
    for speed in WEIGHING_SHARES:
        for way in (travel, -travel):
            begin_s, time_s = time_s, time_s + 2.0 * travel / (speed * experiment.homing.speed)
            strokes.append(Stroke(begin_s, time_s, math.copysign(speed * experiment.homing.speed, way)))
            path.append((time_s, _middle(experiment) + way))
    return path, strokes


def cogging_motion(experiment: Experiment, most_order: int, *, loaded: bool = False) -> IdentificationMotion:
    """Return a motion of slow sweeps for cogging, in both directions, with at most the motor's nominal effort.

    `most_order` is the highest harmonic. With `loaded` a mass hangs on the rig.
    """
    path, _ = cogging_sweeps(experiment, most_order, loaded=loaded)
    rate = slow_rate(experiment)
    limit = min(experiment.rig.limits.effort, experiment.rig.limits.nominal_effort)
    stiffness, damping = servo_of(experiment, rate)
    law = make_tracing_law(path, stiffness=stiffness, damping=damping, limit=limit, rate_hz=rate)
    changes = _loaded_homing(experiment, rate, limit) if loaded else _homing_changes(experiment, rate)
    return IdentificationMotion(_set_motion(experiment, path[0][1], path[-1][0], rate, changes), law)


def cogging_sweeps(
    experiment: Experiment, most_order: int, *, loaded: bool = False
) -> tuple[list[tuple[float, float]], list[Stroke]]:
    """Return the path of the sweeps for cogging (time in s, position in rad or m), and a list of the sweeps.

    `most_order` is the highest harmonic. Each pair, forth and back over most of the window, has its own speed. With
    `loaded` the path begins with a rest, in which the operator lets go of the mass.
    """
    stiffness, damping = servo_of(experiment, slow_rate(experiment))
    wave = cogging_period(experiment) / most_order / (2.0 * math.pi)
    fastest = min(STROKE_SPEED * experiment.rig.limits.speed, 2.0 * stiffness / damping / FOLLOWS * wave)
    travel = SWEEP_SHARE * (experiment.rig.limits.position_maximum - experiment.rig.limits.position_minimum)
    start = _middle(experiment) - travel
    path, sweeps, time_s = [(0.0, start)], [], HANG_S if loaded else 0.0
    if loaded:
        path.append((time_s, start))
    for share in SWEEP_SPEEDS:
        for way in (travel, -travel):
            begin_s, time_s = time_s, time_s + 2.0 * travel / (share * fastest)
            sweeps.append(Stroke(begin_s, time_s, math.copysign(share * fastest, way)))
            path += [(time_s, _middle(experiment) + way), (time_s + SWEEP_REST_S, _middle(experiment) + way)]
            time_s += SWEEP_REST_S
    return path, sweeps


def excitation_motion(experiment: Experiment, multisine: Multisine, inertia: float) -> IdentificationMotion:
    """Return a multisine motion about the window's middle, where a soft spring by the control law holds the handle."""
    rate = experiment.controller.position_rate
    law = bilateral.excited_law(multisine.period(rate), round(multisine.period_s * rate))
    changes = {"wall.stiffness": centring(inertia), **_homing_changes(experiment, rate)}
    return IdentificationMotion(
        _set_motion(experiment, _middle(experiment), excited_s(multisine.period_s), rate, changes), law
    )


def servo_of(experiment: Experiment, rate: int) -> tuple[float, float]:
    """Return stiffness and damping of a position servo that is well damped in spite of loop and filter delays.

    The units are N·m/rad and N·m·s/rad, or N/m and N·s/m.
    """
    ticks = SERVO_TICKS + experiment.rig.amplifier.set_point_ticks(1.0 / rate)
    delay_s = ticks / rate + FILTER_DELAY / _cutoff_hz(experiment, rate)
    # The servo of homing is not used, because it may need an end mass that is not mounted now. Its damping is an upper
    # bound, because a resonance may limit it.
    corner = min(
        SERVO_PHASE / delay_s, (experiment.homing.damping or math.inf) / experiment.rig.mechanics.inertia
    )
    return 0.25 * experiment.rig.mechanics.inertia * corner**2, experiment.rig.mechanics.inertia * corner


def _cutoff_hz(experiment: Experiment, rate: int) -> float:
    """Return the velocity filter's cut-off (Hz) at which one encoder count does not exceed the speed limit."""
    quiet = COUNT_SHARE * experiment.rig.limits.speed / (COUNT_PEAK * experiment.rig.encoder.resolution)
    return min(CUTOFF_SHARE * _divisor(rate, SLOW_RATE), quiet)


def _homing_changes(experiment: Experiment, rate: int) -> dict[str, Any]:
    """Return by key the changes of [homing] for a motion: a well damped servo, and room for friction and cogging."""
    stiffness, damping = servo_of(experiment, rate)
    held = 2.0 * (coulomb_of(experiment) + experiment.rig.cogging.crest)
    held_counts = held / stiffness / experiment.rig.encoder.resolution
    push = min(most_push(experiment), experiment.rig.limits.effort)
    return {
        "homing.stiffness": stiffness,
        "homing.damping": damping,
        "homing.effort": max(experiment.homing.effort, push),
        "homing.tolerance_counts": min(1e6, max(experiment.homing.tolerance_counts, held_counts)),
    }


def strokes_of(experiment: Experiment) -> tuple[list[tuple[float, float]], list[Stroke]]:
    """Return the path of the strokes (time in s, position in rad or m), and a list of the strokes."""
    limits = experiment.rig.limits
    travel = TRAVEL_SHARE * (limits.position_maximum - limits.position_minimum)
    slowing = max(1.0, 2.0 * travel / STROKES_S[0] / (STROKE_SPEED * limits.speed))
    while slowing < MOST_SLOWING and not all(
        _settles(experiment, slowing * length, travel) for length in STROKES_S[1:]
    ):
        slowing *= 1.25
    path, strokes, time_s = [(0.0, _middle(experiment) - travel)], [], 0.0
    for length in STROKES_S:
        for way in (travel, -travel):
            begin_s, time_s = time_s, time_s + slowing * length
            strokes.append(Stroke(begin_s, time_s, 2.0 * way / (time_s - begin_s)))
            path.append((time_s, _middle(experiment) + way))
    return path, strokes


def _settles(experiment: Experiment, length_s: float, travel: float) -> bool:
    """Return True if a position servo reaches a stroke's constant speed before the last third of the stroke.

    `length_s` is the duration (s) and `travel` half of the length (rad or m) of the stroke.
    """
    stiffness, damping = servo_of(experiment, slow_rate(experiment))
    damping, mass = damping + config.rig_model(experiment).damping, experiment.rig.mechanics.inertia
    pole = 2.0 * stiffness / (damping + math.sqrt(max(0.0, damping**2 - 4.0 * mass * stiffness)))
    # After a reversal friction holds the handle until the servo's spring is reversed, too. Then the error of the speed
    # decays with the slower pole of servo, mass and viscous damping.
    held_s = 2.0 * coulomb_of(experiment) / stiffness * length_s / (2.0 * travel)
    decayed = pole * ((1.0 - 1.0 / PIECES) * length_s - held_s)
    return decayed > 0.0 and 2.0 * (1.0 + decayed) * math.exp(-decayed) < UNSTEADY


def excitation(
    experiment: Experiment, seed: int, period_s: float, inertia: float, realisation: int = 0
) -> Multisine:
    """Return the largest multisine that the limits of effort, heat, position and speed allow, with margins.

    `period_s` is its period (s), `inertia` the inertia of the whole rig (kg·m² or kg); `seed` and `realisation`
    determine the phases. Raise `ConfigError` if the rate is too low.
    """
    top = min(HIGHEST_HZ, HIGHEST_SHARE * experiment.controller.position_rate)
    if top < 2.0 * LOWEST_HZ:
        raise ConfigError(
            f"a loop of {experiment.controller.position_rate} Hz excites up to {top:.3g} Hz, which is too low "
            "to identify an inertia",
            remedy=f"choose a rate of {math.ceil(2.0 * LOWEST_HZ / HIGHEST_SHARE)} Hz or more",
        )
    count = max(2, round(LINES_PER_OCTAVE * math.log2(top / LOWEST_HZ)))
    harmonics = np.unique(np.rint(np.geomspace(LOWEST_HZ, top, count) * period_s))
    lines = harmonics[harmonics >= 1.0] / period_s
    phases = np.random.default_rng((seed, realisation)).uniform(-np.pi, np.pi, len(lines))
    shape = Multisine(period_s, lines, np.minimum(lines / EVEN_FROM_HZ, 1.0), phases)
    limits, impedance = experiment.rig.limits, _free_impedance(experiment, inertia)
    half = 0.5 * (limits.position_maximum - limits.position_minimum)
    return shape.scaled(
        min(
            EFFORT_SHARE * limits.effort / shape.peak,
            RMS_SHARE * limits.nominal_effort / shape.rms,
            POSITION_SHARE * half / shape.position(impedance).peak,
            SPEED_SHARE * limits.speed / shape.velocity(impedance).peak,
        )
    )


def centring(inertia: float) -> float:
    """Return the stiffness of the spring that centres an excited handle (N·m/rad or N/m); `inertia` in kg·m² or kg."""
    return inertia * (2.0 * math.pi * CENTRING_HZ) ** 2


def coulomb_of(experiment: Experiment) -> float:
    """Return the Coulomb friction of motor and link together by the rig's description (N·m or N)."""
    return experiment.rig.mechanics.motor_coulomb + experiment.rig.mechanics.link_coulomb


def push_growth(experiment: Experiment) -> float:
    """Return how fast the effort of a test push grows (N·m/s or N/s), so that it exceeds friction within 1.5 s."""
    gentle = 6.0 * experiment.rig.mechanics.inertia * push_way(experiment) / PUSH_RISE_S**3 * PUSH_S
    bound = PUSH_SHARE * min(experiment.rig.limits.nominal_effort, experiment.rig.limits.effort)
    return min(bound, max(gentle, PUSH_COULOMB * coulomb_of(experiment))) / PUSH_S


def most_push(experiment: Experiment) -> float:
    """Return the highest effort of a test push (N·m or N), reached after 1.5 s or earlier."""
    # With a dead encoder a free handle must stay below the speed limit: under an effort g·t a handle of inertia m and
    # Coulomb friction F has the speed (g·t − F)²/(2·g·m).
    growth, speed = push_growth(experiment), UNSEEN_SPEED * experiment.rig.limits.speed
    unseen = coulomb_of(experiment) + math.sqrt(2.0 * growth * experiment.rig.mechanics.inertia * speed)
    return min(growth * PUSH_S, unseen)


def pushes_checks(experiment: Experiment) -> list[Check]:
    """Check the pushes of `rig device check`: their effort against friction, and their travel against the window."""
    way, limits = push_way(experiment), experiment.rig.limits
    half, middle = 0.5 * (limits.position_maximum - limits.position_minimum), _middle(experiment)
    position, needed = _unit(experiment, "position"), round_up(SPARE * PUSHES_ROOM * way)
    counts = way / experiment.rig.encoder.resolution
    room = finding(
        "room of rig device check",
        PUSHES_ROOM * way <= half * (1.0 + 1e-9),
        f"two pushes of {counts:.3g} counts go up to {PUSHES_ROOM * way:.3g} {position} to "
        f"each side, the window has {half:.3g}",
        {"rig.limits.position_minimum": middle - needed, "rig.limits.position_maximum": middle + needed},
        otherwise=Outcome.WARNING,
    )
    return [observable_check(experiment), room]


def observable_check(experiment: Experiment) -> Check:
    """Warn if the test pushes may be weaker than the described friction, weight and cogging of the rig."""
    held, most, effort = holding_effort(experiment), most_push(experiment), _unit(experiment, "effort")
    return finding(
        "pushes of rig device check",
        most >= OBSERVABLE * held,
        f"at most {most:.3g} {effort}, described friction, weight and cogging {held:.3g}; a dead "
        f"motor is detectable from {OBSERVABLE:g} times that on",
        _observable_limits(experiment),
        "use a stronger motor, or reduce the friction of the mechanism",
        Outcome.WARNING,
    )


def _observable_limits(experiment: Experiment) -> dict[str, float]:
    """Return by key limits of the rig with which test pushes overcome friction; empty if the motor is too weak."""
    limits, wanted = experiment.rig.limits, SPARE * OBSERVABLE * holding_effort(experiment)
    if (most := round_up(wanted / PUSH_SHARE)) > experiment.rig.amplifier.effort_limit:
        return {}
    raised = replace(limits, nominal_effort=max(limits.nominal_effort, most), effort=max(limits.effort, most))
    growth = push_growth(replace(experiment, rig=replace(experiment.rig, limits=raised)))
    beyond = max(0.0, wanted - coulomb_of(experiment))
    speed = round_up(beyond**2 / (2.0 * growth * experiment.rig.mechanics.inertia * UNSEEN_SPEED))
    raised = replace(raised, speed=max(limits.speed, speed))
    names = ("nominal_effort", "effort", "speed")
    return {
        f"rig.limits.{name}": new for name in names if (new := getattr(raised, name)) > getattr(limits, name)
    }


def push_way(experiment: Experiment) -> float:
    """Return the travel after which a test push ends (rad or m): 30 counts, or less in a small window."""
    count, limits = experiment.rig.encoder.resolution, experiment.rig.limits
    half = 0.5 * (limits.position_maximum - limits.position_minimum)
    return max(LEAST_PUSH_COUNTS * count, min(PUSH_COUNTS * count, half / COARSE_ROOM))


def pushes_s(pushes: int = PUSHES) -> float:
    """Return the total duration of this number of test pushes and the rests between them (s)."""
    return pushes * (PUSH_S + REST_S) + REST_S


def slow_rate(experiment: Experiment) -> int:
    """Return the position rate for pushes and strokes (Hz): the experiment's, divided to at most 2 kHz."""
    return _divisor(experiment.controller.position_rate, SLOW_RATE)


def _set_motion(
    experiment: Experiment, at: float, duration_s: float, rate: int, changes: Mapping[str, Any]
) -> Experiment:
    velocity_rate = _divisor(rate, SLOW_RATE)
    still = {
        **_NO_WALL,
        # A trial starts before its wall.
        "wall.position": at + MARGIN_COUNTS * experiment.rig.encoder.resolution,
        "trial.start": at,
        "trial.effort": NO_PUSH * experiment.rig.limits.effort,
        "trial.duration_s": duration_s,
        "verdict.tail_s": 0.5 * duration_s,
        "controller.position_rate": rate,
        "controller.velocity_rate": velocity_rate,
        "controller.parameters.cutoff_hz": _cutoff_hz(experiment, rate),
        "verdict.lowpass_hz": min(experiment.verdict.lowpass_hz, 0.4 * rate),
    }
    if experiment.controller.loop == "device":  # every board has the estimator in integers
        still["controller.estimator"] = "fdm-butterworth-fixed"
    # Friction and cogging are to be measured, so that nothing may compensate them in these motions.
    plain = {"controller.friction_compensation": 0.0, "controller.cogging_compensation": False}
    return config.override(experiment, {**still, **changes, **plain}, "identification")


_NO_WALL: dict[str, Any] = {
    "trial.kind": "constant-effort",
    "trial.repeats": 1,
    "trial.baseline_s": 0.0,
    "trial.minimum_rest_counts": 0.0,
    # No wall is rendered: the guard's limits of a wall's oscillations and energy must not end these motions.
    "rig.limits.oscillations": 0,
    "rig.limits.energy": None,
    "wall.stiffness": 0.0,
    "wall.damping": 0.0,
    "wall.side": 1,
    "wall.law": "spring-damper",
    "controller.estimator": "fdm-butterworth",
    "controller.arithmetic": "auto",
    "controller.prediction": "hold",
    "controller.slow_below": 0.0,
    "controller.slow_velocity_rate": None,
}


def still(experiment: Experiment) -> Experiment:
    """Return the experiment with a trial that leaves the handle free: no wall, and negligible effort."""
    return _set_motion(experiment, _middle(experiment), 1.0, slow_rate(experiment), {})


def _middle(experiment: Experiment) -> float:
    return 0.5 * (experiment.rig.limits.position_minimum + experiment.rig.limits.position_maximum)


def _free_impedance(experiment: Experiment, inertia: float) -> Callable[[Floats], Any]:
    """Return a function of frequency (Hz): impedance of a rigid rig on a spring that centres it (N·m·s/rad or N·s/m).

    Damping and back-EMF are as described; `inertia` is given (kg·m² or kg).
    """
    mechanics, amplifier = experiment.rig.mechanics, experiment.rig.amplifier
    damping, stiffness = mechanics.motor_damping + mechanics.link_damping, centring(inertia)

    def impedance(lines_hz: Floats) -> Any:
        s = 2j * np.pi * lines_hz
        return inertia * s + damping + amplifier.back_emf / (1.0 + amplifier.lag_s * s) + stiffness / s

    return impedance


def settle_periods(period_s: float) -> int:
    """Return the number of excitation periods that run before the analysed periods, so that transients decay."""
    return max(LEAST_SETTLE, math.ceil(EXCITATION_SETTLE_S / period_s - 1e-9))


def excited_s(period_s: float) -> float:
    """Return the duration of one run of the excitation, with its settling periods (s)."""
    return (settle_periods(period_s) + PERIODS) * period_s


def _divisor(rate: int, most: int) -> int:
    return next(rate // n for n in range(1, rate + 1) if rate % n == 0 and rate // n <= most)


def _check(name: str, value: float, limit: float, unit: str, remedy: str) -> Check:
    return limited(name, value <= limit, f"{value:.3g} {unit}, limit {limit:.3g}", remedy)


def _unit(experiment: Experiment, quantity: str) -> str:
    return unit_of(quantity, experiment.rig.motion)
