"""Compute a control cycle of a moteus in compiled code: encoder filter, modes, watchdog, limits, torque.

It follows mjbots/moteus at db1a762 (2026-06): docs/protocol/registers.md for modes and fault codes,
docs/reference/configuration.md (`servo.*`, `servopos.*`) for law, limits and time-out. Left out: the modes that set
voltages (5 to 8, 14), which drive nothing here; field weakening, flux braking and the limits of power and bus voltage;
single-precision arithmetic, except for the grid of the position. `moteus` calls it. It must allocate nothing.
"""

import math
from typing import Any, NamedTuple

from numba import types

from rig.realtime.kernel import kernel
from sim_backend.drives.motor import LAW, Words

RATE_HZ = 30_000  # docs/reference/configuration.md: servo.pwm_rate_hz, one cycle of the law a period
POSITION_GRID = 65536.0  # steps of a reported position in a revolution: fw/motor_position.h, IntToFloat
PLL_SHAPE = 2.48  # 3 dB frequency over natural frequency of a critically damped loop: fw/motor_position.h
ENABLING_S = 0.005  # fw/drv8323.cc: 1 ms, and the millisecond polls before and after
CALIBRATING_S = 256 / RATE_HZ  # fw/bldc_servo.cc: cycles over which the current's offset is averaged

STOPPED, FAULT, ENABLING, CALIBRATING, CALIBRATION_COMPLETE = range(5)
CURRENT, POSITION, TIMEOUT, ZERO_VELOCITY, STAY_WITHIN = 9, 10, 11, 12, 13
BRAKE = 15
MODES = 16

# Fault codes, docs/protocol/registers.md, 0x00f. From 96 on they name a limit that is in effect.
OVER_VOLTAGE, ENCODER_FAULT, OVER_TEMPERATURE, START_OUTSIDE_LIMIT, UNDER_VOLTAGE = 34, 35, 38, 39, 40
POSITION_INVALID, STOP_POSITION_DEPRECATED, POSITION_ERROR, VELOCITY_ERROR = 43, 45, 49, 50
MAX_VELOCITY, MAX_CURRENT, MAX_TORQUE, POSITION_BOUNDS = 96, 99, 102, 103
LEAST_VOLTAGE = 4.0  # V, fw/bldc_servo_control.h
_NO_FAULT = 0


class _MoteusWords(NamedTuple):
    # configuration (docs/reference/configuration.md; revolutions, N·m, seconds)
    counts_per_turn: int
    sign: int
    output_offset: int
    rotor_to_output: int
    pll_kp: int
    pll_ki: int
    kp: int
    ki: int
    kd: int
    ilimit: int
    iratelimit: int
    max_current: int
    torque_constant: int
    motor_constant: int
    position_min: int
    position_max: int
    position_derate: int
    default_velocity_limit: int
    default_accel_limit: int
    max_velocity: int
    max_velocity_derate: int
    max_position_slip: int
    fault_position_error: int
    fault_velocity_error: int
    velocity_threshold: int
    max_voltage: int
    fault_temperature: int
    timeout_mode: int
    timeout_max_torque: int
    brake_damping: int
    source_valid: int
    # the command in force (docs/protocol/registers.md, 0x000, 0x01c, 0x020 to 0x02d, 0x040 to 0x048)
    command: int
    command_position: int
    command_velocity: int
    feedforward: int
    kp_scale: int
    kd_scale: int
    ilimit_scale: int
    max_torque: int
    velocity_limit: int
    accel_limit: int
    ignore_bounds: int
    lower: int
    upper: int
    q_command: int
    # state of the drive
    mode: int
    fault: int
    position: int
    velocity: int
    torque: int
    timeout_left: int
    starting: int
    filtered: int
    pll_velocity: int
    snapped: int
    control_position: int
    control_velocity: int
    control_torque: int
    trajectory_done: int
    integral: int
    proportional: int
    derivative: int
    error: int
    error_rate: int
    output_shift: int
    # supply and temperature; injected fault
    voltage: int
    temperature: int
    struck: int


W: Any = _MoteusWords(*range(len(_MoteusWords.__annotations__)))
WORDS = len(W)

_DT = 1.0 / RATE_HZ
_F = types.float64
_V = types.float64[::1]
_FALL = types.void(_V, _F)


@kernel(_FALL, no_refcount=True)
def _fall(w: Words, fault: float) -> None:
    """Enter the fault mode, which only a stop command leaves; the first fault code stays in the memory `w`."""
    if w[W.mode] != FAULT:
        w[W.mode] = FAULT
        w[W.fault] = fault


@kernel(_FALL, no_refcount=True)
def _limit(w: Words, code: float) -> None:
    if w[W.mode] != FAULT:
        w[W.fault] = code


@kernel(types.void(_V, types.int64), no_refcount=True)
def _filter(w: Words, count: int) -> None:
    """Compute position and velocity behind the gearbox from the encoder count, by a second-order tracking loop."""
    turned = w[W.sign] * count
    if w[W.snapped] == 0.0:
        w[W.snapped] = 1.0
        w[W.filtered] = turned
        w[W.pll_velocity] = 0.0
    elif w[W.pll_kp] != 0.0:
        error = turned - w[W.filtered]
        w[W.pll_velocity] += _DT * w[W.pll_ki] * error
        w[W.filtered] += _DT * (w[W.pll_velocity] + w[W.pll_kp] * error)
    else:
        w[W.filtered] = turned
        w[W.pll_velocity] = 0.0  # configuration.md, pll_filter_hz: 0 gives no velocity
    per_count = w[W.rotor_to_output] / w[W.counts_per_turn]
    raw = w[W.filtered] * per_count + w[W.output_offset] + w[W.output_shift]
    w[W.position] = math.floor(raw * POSITION_GRID) / POSITION_GRID
    w[W.velocity] = w[W.pll_velocity] * per_count


@kernel(types.boolean(_V), no_refcount=True)
def _starts_outside(w: Words) -> bool:
    outside = w[W.position] < w[W.position_min] or w[W.position] > w[W.position_max]  # NaN: no bound
    return bool(outside and w[W.ignore_bounds] == 0.0)


@kernel(types.void(_V), no_refcount=True)
def _change_mode(w: Words) -> None:
    """Change to the commanded mode: from fault or time-out only to stopped, from stopped after enabling the driver."""
    # Changes of mode follow fw/bldc_servo_control.h.
    command, mode = w[W.command], w[W.mode]
    if command == STOPPED:
        w[W.mode] = STOPPED
    elif mode == STOPPED:
        w[W.mode] = ENABLING
        w[W.starting] = ENABLING_S
    elif mode in (FAULT, ENABLING, CALIBRATING, TIMEOUT):
        pass
    elif (command in (POSITION, STAY_WITHIN)) and _starts_outside(w):
        _fall(w, START_OUTSIDE_LIMIT)
    else:
        w[W.mode] = command
        w[W.integral] = 0.0
        w[W.control_position] = math.nan


@kernel(types.void(_V), no_refcount=True)
def _start(w: Words) -> None:
    """Advance the modes enabling and calibrating, which last for a fixed time and drive no torque."""
    if w[W.mode] in (ENABLING, CALIBRATING):
        w[W.starting] -= _DT
        if w[W.starting] <= 0.0:
            w[W.starting] = CALIBRATING_S
            w[W.mode] += 1.0


@kernel(types.void(_V), no_refcount=True)
def _check_faults(w: Words) -> None:
    if w[W.mode] in (STOPPED, FAULT):
        return
    if w[W.struck] != 0.0:
        _fall(w, w[W.struck])
        w[W.struck] = 0.0
    if w[W.source_valid] == 0.0 and w[W.mode] >= POSITION and w[W.mode] != BRAKE:
        _fall(w, POSITION_INVALID)
    if w[W.voltage] > w[W.max_voltage]:
        _fall(w, OVER_VOLTAGE)
    if w[W.voltage] < LEAST_VOLTAGE:
        _fall(w, UNDER_VOLTAGE)
    if w[W.temperature] > w[W.fault_temperature]:
        _fall(w, OVER_TEMPERATURE)


@kernel(_F(_F, _F, _F, _F, _F), no_refcount=True)
def _acceleration(dx: float, velocity: float, goal: float, accel: float, top: float) -> float:
    """Return the acceleration (rev/s²) for the fastest approach without overshoot to a moving target.

    `dx` is the distance to the target (rev), `velocity` and `goal` are the present and the target's velocity (rev/s);
    `accel` and `top` limit acceleration and speed.
    """
    # Trajectory of fw/bldc_servo_position.h; `ahead` is the speed one cycle later, which must still be stoppable.
    if abs(velocity) > top:
        return math.copysign(accel, -velocity)
    relative = velocity - goal
    if relative * dx < 0.0 or dx == 0.0:
        return math.copysign(accel, -relative)
    ahead = abs(relative) + accel * _DT
    if abs(dx) - 0.5 * (abs(relative) + ahead) * _DT > ahead * ahead / (2.0 * accel):
        return math.copysign(accel, dx) if abs(velocity) < top else 0.0
    return math.copysign(min(accel, relative * relative / (2.0 * abs(dx))), -relative)


@kernel(types.void(_V, _F, _F, _F, _F), no_refcount=True)
def _follow(w: Words, target: float, velocity: float, top: float, accel: float) -> None:
    """Advance control position and control velocity by one cycle along a trajectory within the limits (revolutions, s).

    `top` and `accel` limit speed and acceleration; if both are NaN, the target is taken over at once. If `target` is
    NaN, only the velocity is followed.
    """
    if math.isnan(velocity):
        velocity = 0.0
    free = math.isnan(top) and math.isnan(accel)
    top = w[W.max_velocity] if math.isnan(top) else min(top, w[W.max_velocity])
    velocity = velocity if free else min(max(velocity, -top), top)
    if free and not math.isnan(target):
        w[W.control_position] = target
    elif math.isnan(w[W.control_position]):
        w[W.control_position] = w[W.position]
        w[W.control_velocity] = w[W.velocity]
    before = w[W.control_velocity]
    if free:
        w[W.control_velocity] = velocity
        w[W.trajectory_done] = 1.0
    elif math.isnan(target):
        step = math.inf if math.isnan(accel) else accel * _DT
        w[W.control_velocity] += min(max(velocity - before, -step), step)
        w[W.trajectory_done] = 1.0 if w[W.control_velocity] == velocity else 0.0
    elif math.isnan(accel):
        dx = target - w[W.control_position]
        w[W.control_velocity] = math.copysign(min(top, abs(dx) / _DT), dx)
        w[W.trajectory_done] = 1.0 if abs(dx) <= top * _DT else 0.0
    else:
        dx = target - w[W.control_position]
        w[W.control_velocity] += _DT * _acceleration(dx, before, velocity, accel, top)
        near = max(abs(w[W.control_velocity] - velocity), abs(velocity), accel * _DT)
        done = abs(dx) <= near * 10.0 * _DT and abs(w[W.control_velocity] - velocity) <= accel * _DT
        if done:
            w[W.control_position], w[W.control_velocity] = target, velocity
        w[W.trajectory_done] = 1.0 if done else 0.0
    w[W.control_position] += 0.5 * (before + w[W.control_velocity]) * _DT if not free else velocity * _DT
    if w[W.trajectory_done] != 0.0:
        w[W.command_position] = math.nan  # from here on only the velocity is followed
    elif not math.isnan(target):
        w[W.command_position] = target + velocity * _DT
    slip = w[W.max_position_slip]
    if not math.isnan(slip):
        low, high = w[W.position] - slip, w[W.position] + slip
        w[W.control_position] = min(max(w[W.control_position], low), high)


@kernel(_F(_V, _F, _F, _F, _F), no_refcount=True)
def _regulate(w: Words, kp_scale: float, kd_scale: float, ilimit_scale: float, feedforward: float) -> float:
    """Return the output torque (N·m) of the PID controller for control position and velocity, plus feed-forward.

    The scales multiply the proportional gain, the derivative gain and the integrator's limit; `feedforward` is in N·m.
    """
    w[W.error] = w[W.position] - w[W.control_position]
    threshold = w[W.velocity_threshold]
    off = w[W.velocity] - w[W.control_velocity]
    w[W.error_rate] = off if abs(off) > threshold else 0.0
    step = w[W.error] * w[W.ki] * _DT
    rate = w[W.iratelimit] * _DT
    if rate > 0.0:
        step = min(max(step, -rate), rate)
    bound = w[W.ilimit] * ilimit_scale
    w[W.integral] = min(max(w[W.integral] + step, -bound), bound)
    w[W.proportional] = kp_scale * w[W.kp] * w[W.error]
    w[W.derivative] = kd_scale * w[W.kd] * w[W.error_rate]
    if abs(w[W.error]) > w[W.fault_position_error]:
        _fall(w, POSITION_ERROR)
        return 0.0
    if abs(w[W.error_rate]) > w[W.fault_velocity_error]:
        _fall(w, VELOCITY_ERROR)
        return 0.0
    return float(feedforward - w[W.proportional] - w[W.derivative] - w[W.integral])


@kernel(_F(_V, _F, _F), no_refcount=True)
def _limit_torque(w: Words, torque: float, most: float) -> float:
    """Return `torque` (N·m) after the drive's limits and `most` (N·m; NaN: none); store the code of an active limit."""
    if abs(torque) > most:  # NaN: no limit
        torque = math.copysign(most, torque)
        _limit(w, MAX_TORQUE)
    w[W.control_torque] = torque
    if w[W.ignore_bounds] == 0.0:
        beyond = w[W.position] - w[W.position_max]
        if torque < 0.0:
            beyond = w[W.position_min] - w[W.position]
        if beyond > 0.0 and torque != 0.0:
            torque *= max(0.0, 1.0 - beyond / w[W.position_derate])
            _limit(w, POSITION_BOUNDS)
    most = w[W.max_current] * w[W.torque_constant] / w[W.rotor_to_output]
    # Only torque along the motion is reduced: braking above the limit must work.
    over = abs(w[W.velocity]) - w[W.max_velocity]
    code = MAX_CURRENT
    if over > 0.0 and w[W.velocity] * torque > 0.0:
        most *= max(0.0, 1.0 - over / w[W.max_velocity_derate])
        code = MAX_VELOCITY
    if abs(torque) > most:
        torque = math.copysign(most, torque)
        _limit(w, code)
    return float(torque)


@kernel(_F(_V), no_refcount=True)
def _damp(w: Words) -> float:
    """Return the torque (N·m) of the zero-velocity mode: the derivative term, limited to the time-out torque."""
    w[W.control_position], w[W.control_velocity] = w[W.position], 0.0
    return _limit_torque(w, _regulate(w, 0.0, w[W.kd_scale], 0.0, 0.0), w[W.timeout_max_torque])


@kernel(_F(_V), no_refcount=True)
def _time_out(w: Words) -> float:
    """Return the torque (N·m) after a watchdog time-out, by `servo.timeout_mode`; 0 for an unknown mode."""
    way = w[W.timeout_mode]
    if way == POSITION:
        _follow(w, math.nan, 0.0, w[W.default_velocity_limit], w[W.default_accel_limit])
        return _limit_torque(w, _regulate(w, 1.0, 1.0, 1.0, 0.0), math.nan)
    if way == ZERO_VELOCITY:
        return _damp(w)
    if way == BRAKE:
        return float(-w[W.brake_damping] * w[W.velocity])
    return 0.0


@kernel(_F(_V), no_refcount=True)
def _stay_within(w: Words) -> float:
    """Return the feed-forward torque inside the position bounds, the controller's torque to the bound outside (N·m)."""
    # docs/protocol/registers.md, 0x040 and 0x041, and ISR_DoStayWithinBounds (fw/bldc_servo_control.h): no clamp, no
    # trajectory, feed-forward on both sides, the limit of the command last. The scales are not limited, as in fw/pid.h;
    # the page claims a limit for kd's (0x024).
    bound = math.nan
    if w[W.position] < w[W.lower]:
        bound = w[W.lower]
    elif w[W.position] > w[W.upper]:
        bound = w[W.upper]
    inside = math.isnan(bound)
    w[W.control_position] = w[W.position] if inside else bound
    w[W.control_velocity] = 0.0
    if inside:
        w[W.integral] = 0.0
    share = 0.0 if inside else 1.0
    torque = _regulate(
        w, share * w[W.kp_scale], share * w[W.kd_scale], share * w[W.ilimit_scale], w[W.feedforward]
    )
    return _limit_torque(w, torque, w[W.max_torque])


@kernel(_F(_V), no_refcount=True)
def _work(w: Words) -> float:
    mode = w[W.mode]
    torque = 0.0
    if mode == POSITION:
        _follow(w, w[W.command_position], w[W.command_velocity], w[W.velocity_limit], w[W.accel_limit])
        torque = _regulate(w, w[W.kp_scale], w[W.kd_scale], w[W.ilimit_scale], w[W.feedforward])
        torque = _limit_torque(w, torque, w[W.max_torque])
    elif mode == STAY_WITHIN:
        torque = _stay_within(w)
    elif mode == TIMEOUT:
        torque = _time_out(w)
    elif mode == ZERO_VELOCITY:
        torque = _damp(w)
    elif mode == CURRENT:
        torque = _limit_torque(w, w[W.q_command] * w[W.torque_constant] / w[W.rotor_to_output], math.nan)
    elif mode == BRAKE:
        torque = -w[W.brake_damping] * w[W.velocity]
    return float(torque)


@kernel(LAW, no_refcount=True)
def law(w: Words, count: int, measured: float) -> float:
    """Compute a control cycle from memory `w`, encoder count and shaft torque (N·m); return the wanted torque (N·m)."""
    if w[W.source_valid] != 0.0:
        _filter(w, count)
    # Torque at the output as the drive estimates it, from the true torque at the shaft.
    share = w[W.sign] * w[W.torque_constant] / w[W.motor_constant] / w[W.rotor_to_output]
    w[W.torque] = measured * share
    if w[W.timeout_left] > 0.0:
        w[W.timeout_left] = max(0.0, w[W.timeout_left] - _DT)
    # The order of a cycle is that of fw/bldc_servo_control.h: a fault found now acts in this cycle.
    if w[W.command] != w[W.mode]:
        _change_mode(w)
    _start(w)
    _check_faults(w)
    if w[W.mode] in (POSITION, STAY_WITHIN) and w[W.timeout_left] <= 0.0:  # NaN: no time-out
        w[W.mode] = TIMEOUT
        w[W.control_position] = math.nan
    if w[W.mode] != FAULT:
        w[W.fault] = _NO_FAULT
    w[W.control_torque] = 0.0
    torque = _work(w)
    if w[W.mode] == FAULT:
        torque = w[W.control_torque] = 0.0
    return float(torque / share)
