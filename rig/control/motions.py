"""Laws that move a rig to identify it: motion along a path, and small pushes before the motor's sign is known.

Both laws have the signature of a wall (`rig.realtime.plugs.LAW`), so that they run in a simulation, over the byte link,
in real time and in a replay. They render no wall: the wall's position is their origin, its side their direction. Time
is counted in ticks since the law began, including lost ticks.

Identification and the pushes of a board in `rig.experiments` use it. Kernels here must not allocate, and read no clock.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.control.law import Law
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_CLAMPED, LAW_SIGNATURE

Floats = NDArray[np.float64]

TICK = 1  # state of both laws: the present tick, plus one; 0 before the first

SEGMENT, TRACED_STATE = 2, 3  # state of `servo_to_points`
STIFFNESS, DAMPING, LIMIT, TICK_S, PATH = range(
    5
)  # parameters of `servo_to_points`; PATH: pairs of tick and position

PULSE, STAGE, STAGE_TICKS, ORIGIN, DRIVE, TURN, NUDGES_STATE = 2, 3, 4, 5, 6, 7, 8  # state of `nudges`
RATE, MOST, MOVED, REST_TICKS, BRAKE, PULSES = range(6)  # parameters of `nudges`
RISING, RESTING = 0, 1  # stages
ALIKE = 2  # pulses of one direction after another
NOTHING = 0.1  # share of the way below which a push has moved nothing


@kernel(LAW_SIGNATURE)
def servo_to_points(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return the reaction (N·m or N) of a servo that moves the handle along lines between points (tick, position).

    It stays at the last point. The sum of spring and damper is clipped to the largest effort among the parameters. The
    damper acts on the difference between the velocities of path and handle.
    """
    state[LAW_CLAMPED] = 0.0
    tick = state[TICK] - 1.0 + elapsed_ticks if state[TICK] > 0.0 else 0.0
    state[TICK] = tick + 1.0
    last = (parameters.shape[0] - PATH) // 2 - 1
    i = int(state[SEGMENT])
    while i < last and tick >= parameters[PATH + 2 * (i + 1)]:
        i += 1
    state[SEGMENT] = i
    begins, setpoint, slope = parameters[PATH + 2 * i], parameters[PATH + 2 * i + 1], 0.0
    if i < last:
        ends, target = parameters[PATH + 2 * i + 2], parameters[PATH + 2 * i + 3]
        slope = (target - setpoint) / (ends - begins)
        setpoint += slope * (tick - begins)
    drive = parameters[STIFFNESS] * (setpoint - penetration)
    drive += parameters[DAMPING] * (slope / parameters[TICK_S] - penetration_velocity)
    return float(-min(max(drive, -parameters[LIMIT]), parameters[LIMIT]))


@kernel(LAW_SIGNATURE)
def nudges(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return the reaction (N·m or N) of small pushes: raise the push until the handle moves, brake, rest, repeat.

    Two pushes go in one direction, the next two in the other. The brake opposes the direction in which the handle
    moved, whatever the direction of the push, so a wrong sign cannot make the rig run away. A push that moves nothing
    is the last push.
    """
    state[LAW_CLAMPED] = 0.0
    if state[TICK] == 0.0:
        state[ORIGIN] = penetration
    state[TICK] += elapsed_ticks
    if state[PULSE] >= parameters[PULSES]:
        return 0.0
    state[STAGE_TICKS] += elapsed_ticks
    forth = 1.0 if int(state[PULSE]) % (2 * ALIKE) < ALIKE else -1.0
    if state[STAGE] == RISING:
        state[DRIVE] = min(parameters[RATE] * state[STAGE_TICKS], parameters[MOST])
        way = penetration - state[ORIGIN]
        if abs(way) < parameters[MOVED] and state[DRIVE] < parameters[MOST]:
            return float(-forth * state[DRIVE])
        # The handle may be moving without being measured, and another push would add to that motion.
        if abs(way) < NOTHING * parameters[MOVED]:
            state[PULSE] = parameters[PULSES]
            return 0.0
        state[STAGE], state[STAGE_TICKS] = RESTING, 0.0
        state[TURN] = 1.0 if way * forth >= 0.0 else -1.0
    elif state[STAGE_TICKS] >= parameters[REST_TICKS]:
        state[PULSE] += 1.0
        state[STAGE], state[STAGE_TICKS] = RISING, 0.0
        state[ORIGIN] = penetration
        return 0.0
    brake = -state[TURN] * parameters[BRAKE] * penetration_velocity
    return float(-min(max(brake, -state[DRIVE]), state[DRIVE]))


def make_tracing_law(
    path: Sequence[tuple[float, float]], *, stiffness: float, damping: float, limit: float, rate_hz: float
) -> Law:
    """Return a law that moves the handle along a path, by a servo.

    `path` has points (time, position): ascending times from the beginning of the trial (s), and positions (rad or m).
    The servo has a stiffness, a damping (SI units) and a largest effort `limit` (N·m or N); the loop runs at `rate_hz`.
    """

    def design(wall: Mapping[str, Any]) -> list[float]:
        parameters = [stiffness, damping, limit, 1.0 / rate_hz]
        for time_s, position in path:
            parameters += [float(round(time_s * rate_hz)), wall["side"] * (position - wall["position"])]
        return parameters

    return Law("traced", "servo along a path", servo_to_points, TRACED_STATE, design)


def make_nudging_law(
    *,
    effort_per_s: float,
    most_effort: float,
    moved: float,
    rest_s: float,
    brake: float,
    pulses: int,
    rate_hz: float,
) -> Law:
    """Return a law of small pushes of the motor; the first two go in the direction of rising position.

    Parameters
    ----------
    effort_per_s
        Rate at which a push grows (N·m/s or N/s).
    most_effort
        Largest effort of a push (N·m or N).
    moved
        Distance moved at which a push ends (rad or m).
    rest_s
        Duration of braking and rest after each push (s).
    brake
        Damping of the brake (N·m·s/rad or N·s/m); its effort is limited to that of the push.
    pulses
        Number of pushes.
    rate_hz
        Rate of the loop (Hz).
    """

    def design(wall: Mapping[str, Any]) -> list[float]:
        if wall["side"] != 1:
            raise ValueError(
                f"wall.side = {wall['side']}, but small pushes need a wall that is entered upwards: set it to 1"
            )
        return [
            effort_per_s / rate_hz,
            most_effort,
            moved,
            float(round(rest_s * rate_hz)),
            brake,
            float(pulses),
        ]

    return Law("nudges", "small pushes of both signs", nudges, NUDGES_STATE, design)


def traced_law() -> Law:
    """Return the law that moves the handle along a path, with an empty path: a replay sets the recorded one."""
    return make_tracing_law((), stiffness=0.0, damping=0.0, limit=0.0, rate_hz=1.0)


def nudged_law() -> Law:
    """Return the law of small pushes of the motor, with zero parameters: a replay sets the recorded ones."""
    return make_nudging_law(
        effort_per_s=0.0, most_effort=0.0, moved=0.0, rest_s=0.0, brake=0.0, pulses=0, rate_hz=1.0
    )
