"""Design and check the homing servo, which moves the handle to the start of a trial and holds it there.

All results follow from the experiment alone, without heavy libraries, so that every hit can be checked.

Plans, predictions of `rig.doctor`, identification and `rig.experiments.new_rig` call it. It must not import scipy or
`rig.analysis.theory`.
"""

import math
from dataclasses import dataclass

import numpy as np

from rig.config._sections import Experiment

# Margin of tolerance and effort over what friction, weight and cogging can hold.
ABOVE_FRICTION = 1.25
# Share of the way to the wall that may separate start and home: at most, and as designed.
LARGEST_SHARE, USUAL_SHARE = 0.75, 0.25
# Cut-off over velocity rate, for a velocity filter whose cut-off is not described.
USUAL_CUTOFF = 0.1
# Delay times cut-off of a second-order Butterworth filter: √2/(2π).
FILTER_DELAY = 0.225
USUAL_TOLERANCE = 4.0  # counts
# A designed servo is stable with this many more ticks of delay, which a link may cause.
SPARE_TICKS = 2
# Of a designed servo: B/I times the delay of its loop (rad). 0.6 leaves about 27° of phase margin; in a hand, whose
# mass and spring come besides, 0.6 is unstable on koul-rigid at 20 kHz (spectral radius 1.02), and 0.45 stable on all
# presets.
CORNER, CORNER_IN_HAND = 0.6, 0.45
DAMPING_RATIO = 0.7
# Effort of a designed servo: multiple of the holding effort, and share of the nominal effort.
FRICTIONS, NOMINAL_SHARE = 5.0, 0.3
# Slew: time from no effort to all of it, over 1/ω of the servo. Above 2 homing can oscillate for ever, as an actuator
# with a limited rate does; a designed servo has a quarter.
SLOWEST_RISE, USUAL_RISE = 2.0, 0.25
# Effort that the spring may change by in one count, over the servo's effort less friction: beyond it, counts keep the
# handle moving.
COUNT_SHARE, USUAL_COUNT_SHARE = 0.5, 0.25
GRID = np.logspace(-3.0, 3.0, 1201)  # angular frequencies at which the margin is computed, times the delay


@dataclass(frozen=True, slots=True)
class Servo:
    """Gains and limits of a homing servo: the keys of ``[homing]`` that depend on the rig, in the units of the rig."""

    stiffness: float
    damping: float
    effort: float
    slew: float
    tolerance_counts: float


def holding_effort(experiment: Experiment) -> float:
    """Return the effort (N·m or N) up to which a handle may stay at rest: sum of friction, cogging and weight."""
    mechanics = experiment.rig.mechanics
    weight = 0.0 if experiment.trial.kind == "human" else abs(mechanics.gravity_effort)
    return mechanics.motor_coulomb + mechanics.link_coulomb + experiment.rig.cogging.crest + weight


def resting_offset(experiment: Experiment) -> float:
    """Return the largest distance (rad or m) from the homing target at which friction can hold the handle at rest."""
    return holding_effort(experiment) / experiment.homing.stiffness


def home_tolerance(experiment: Experiment) -> float:
    """Return the distance (rad or m) from the trial's start within which homing is complete.

    The distance is `homing.tolerance_counts`, or more if friction can hold the handle farther away.
    """
    described = experiment.homing.tolerance_counts * experiment.rig.encoder.resolution
    return max(described, ABOVE_FRICTION * resting_offset(experiment))


def largest_offset(experiment: Experiment) -> float:
    """Return how far (rad or m) the handle may be from the start of a trial: a fixed share of the way to the wall."""
    return LARGEST_SHARE * abs(experiment.wall.position - experiment.trial.start)


def usual_offset(experiment: Experiment) -> float:
    """Return the distance from the start (rad or m) that a designed homing servo may leave: ¼ of that to the wall."""
    return USUAL_SHARE * abs(experiment.wall.position - experiment.trial.start)


def nearest_tolerance(experiment: Experiment) -> float:
    """Return a homing tolerance (encoder counts): ¼ of the way to the wall, but at least 1 and at most 4 counts."""
    return max(
        1.0, min(USUAL_TOLERANCE, math.floor(usual_offset(experiment) / experiment.rig.encoder.resolution))
    )


def inertia(experiment: Experiment) -> float:
    """Return the inertia of all moving parts without a hand (kg·m² or kg); a person's trial has no end mass."""
    mechanics = experiment.rig.mechanics
    return mechanics.motor_inertia + (
        mechanics.link_inertia if experiment.trial.kind == "human" else mechanics.loaded_link_inertia
    )


def _cutoff_hz(experiment: Experiment) -> float:
    cutoff = experiment.controller.parameters.get("cutoff_hz", 0.0)
    usual = USUAL_CUTOFF * experiment.controller.velocity_rate
    return float(cutoff) if isinstance(cutoff, float | int) and cutoff > 0.0 else usual


def _delays_s(experiment: Experiment, ticks: int) -> tuple[float, float]:
    """Return the delay (s) from a position to its effort, and the additional delay (s) of the velocity.

    `ticks` is an additional delay of the loop; the lag of the amplifier is not included.
    """
    rates = experiment.controller
    set_point = experiment.rig.amplifier.set_point_ticks(1.0 / rates.position_rate)
    # An effort is held for a tick, on average half a tick after it begins.
    delay_s = (ticks + set_point + 0.5) / rates.position_rate
    return delay_s, FILTER_DELAY / _cutoff_hz(experiment) + 1.0 / rates.velocity_rate


def stiffest_for_counts(experiment: Experiment, effort: float, share: float) -> float:
    """Return the servo stiffness (N·m/rad or N/m) for which one count changes the effort by the largest allowed step.

    This step is `share` times `effort`, the servo's largest effort, plus twice the effort of friction and weight (N·m
    or N).
    """
    return (share * effort + 2.0 * holding_effort(experiment)) / experiment.rig.encoder.resolution


def phase_margin(experiment: Experiment, stiffness: float, damping: float, ticks: int) -> float:
    """Return the smallest phase margin of a homing servo (rad); negative if the servo is unstable.

    Motor and link are assumed to move together. `stiffness` and `damping` are the servo's gains (N·m/rad and N·m·s/rad,
    or N/m and N·s/m), `ticks` is the delay of the loop in addition to the set-point delay.
    """
    delay_s, velocity_s = _delays_s(experiment, ticks)
    lag_s, mass = experiment.rig.amplifier.lag_s, inertia(experiment)
    mechanics = experiment.rig.mechanics
    viscous = mechanics.motor_damping + mechanics.link_damping
    s = 1j * GRID / (delay_s + velocity_s)
    plant = 1.0 / ((mass * s + viscous) * s * (1.0 + s * lag_s))
    loop = (stiffness + damping * s * np.exp(-s * velocity_s)) * np.exp(-s * delay_s) * plant
    # The phase where the gain is above 1, not only at its last crossing: a lag or a hand can make it cross twice.
    strong = np.abs(loop) >= 1.0
    if not strong.any():
        return math.pi
    return float(math.pi + np.unwrap(np.angle(loop))[strong].min())


def stable_servo(experiment: Experiment, ticks: int = SPARE_TICKS) -> Servo:
    """Return the stiffest well damped homing servo that stays stable with the loop's delay plus `ticks` ticks."""
    delay_s, velocity_s = _delays_s(experiment, ticks)
    phase = CORNER_IN_HAND if experiment.trial.kind == "human" else CORNER
    corner = phase / (delay_s + velocity_s + experiment.rig.amplifier.lag_s)
    limits = experiment.rig.limits
    effort = max(FRICTIONS * holding_effort(experiment), NOMINAL_SHARE * limits.nominal_effort)
    effort = min(effort, limits.nominal_effort, limits.effort)
    # K = (B/I)²·I/(4ζ²) gives the damping ratio ζ for a damping of B = I·corner.
    mass, softness = inertia(experiment), 4.0 * DAMPING_RATIO**2
    stiffest = stiffest_for_counts(experiment, effort, USUAL_COUNT_SHARE)
    corner = min(corner, math.sqrt(stiffest * softness / mass))
    return Servo(
        stiffness=_round(mass * corner**2 / softness),
        damping=_round(mass * corner),
        effort=min(_round(effort), limits.nominal_effort, limits.effort),
        slew=_round(effort * corner / math.sqrt(softness) / USUAL_RISE),
        tolerance_counts=nearest_tolerance(experiment),
    )


def _round(value: float) -> float:
    return float(f"{value:.3g}")
