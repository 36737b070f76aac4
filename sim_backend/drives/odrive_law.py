"""Compute a control cycle of an ODrive in compiled code: encoder estimates, controller, limits, watchdog.

It follows odriverobotics/ODrive at f9b5419 (firmware 0.5.6 of the open boards), Firmware/MotorControl/encoder.cpp and
controller.cpp. The closed firmware 0.6 kept the names; whether it works the same way could not be checked. Left out:
trajectories, mirroring, tuning, anticogging, spin-out detection and the calibrations. `odrive` calls it.
"""

import math
from typing import Any, NamedTuple

from numba import types

from rig.realtime.kernel import kernel
from sim_backend.drives.can_simple import AxisState, Error
from sim_backend.drives.motor import LAW, Words

RATE_HZ = 8_000  # docs/control.rst of ODrive 0.5: the control loop
LEAST_VOLTAGE, MOST_VOLTAGE = 8.0, 56.0  # V, the trip levels of config.dc_bus_*: of a 56 V board
MOST_TEMPERATURE = 100.0  # °C, of the inverter: docs/thermistors.rst

IDLE, CLOSED_LOOP = int(AxisState.IDLE), int(AxisState.CLOSED_LOOP_CONTROL)
VOLTAGE_CONTROL, TORQUE_CONTROL, VELOCITY_CONTROL, POSITION_CONTROL = range(4)
INACTIVE, PASSTHROUGH, VEL_RAMP, POS_FILTER = range(4)
TORQUE_RAMP = 6


class _OdriveWords(NamedTuple):
    # configuration (turns, N·m, seconds)
    counts_per_turn: int
    bandwidth: int
    control_mode: int
    input_mode: int
    pos_gain: int
    vel_gain: int
    vel_integrator_gain: int
    vel_integrator_limit: int
    vel_limit: int
    vel_limit_tolerance: int
    vel_ramp_rate: int
    torque_ramp_rate: int
    inertia: int
    input_filter_bandwidth: int
    enable_vel_limit: int
    enable_overspeed_error: int
    enable_torque_mode_vel_limit: int
    torque_soft_min: int
    torque_soft_max: int
    current_soft_max: int
    torque_constant: int
    motor_constant: int
    enable_watchdog: int
    watchdog_timeout: int
    encoder_valid: int
    # inputs
    input_pos: int
    input_vel: int
    input_torque: int
    requested: int
    # state of the drive
    state: int
    active_errors: int
    disarm_reason: int
    watchdog_left: int
    pos_estimate: int
    vel_estimate: int
    counts: int
    counts_velocity: int
    snapped: int
    shift: int
    pos_setpoint: int
    vel_setpoint: int
    torque_setpoint: int
    vel_integrator: int
    torque_target: int
    torque: int
    # supply and temperature; injected fault
    voltage: int
    temperature: int
    struck: int


W: Any = _OdriveWords(*range(len(_OdriveWords.__annotations__)))
WORDS = len(W)

_DT = 1.0 / RATE_HZ
_F = types.float64
_V = types.float64[::1]
_MISSING, _OVERSPEED = int(Error.MISSING_ESTIMATE), int(Error.VELOCITY_LIMIT_VIOLATION)
_EXPIRED, _HOT = int(Error.WATCHDOG_TIMER_EXPIRED), int(Error.INVERTER_OVER_TEMP)
_OVER, _UNDER = int(Error.DC_BUS_OVER_VOLTAGE), int(Error.DC_BUS_UNDER_VOLTAGE)


@kernel(types.void(_V, types.int64), no_refcount=True)
def _fail(w: Words, error: int) -> None:
    """Set an error bit in the drive's memory `w`, and disarm the motor if it is driven."""
    w[W.active_errors] = float(int(w[W.active_errors]) | error)
    if w[W.state] == CLOSED_LOOP:
        w[W.state] = IDLE
        w[W.disarm_reason] = float(error)


@kernel(_F(_F, _F, _F), no_refcount=True)
def _between(value: float, least: float, most: float) -> float:
    return min(max(value, least), most)


@kernel(types.void(_V, types.int64), no_refcount=True)
def _estimate(w: Words, count: int) -> None:
    """Estimate position and velocity from the encoder count, by a critically damped second-order loop."""
    kp = 2.0 * w[W.bandwidth]
    ki = 0.25 * kp * kp
    if w[W.snapped] == 0.0:
        w[W.snapped], w[W.counts], w[W.counts_velocity] = 1.0, float(count), 0.0
    w[W.counts] += _DT * w[W.counts_velocity]
    # Whole counts: the detector of encoder.cpp compares counters, so the estimate dithers within one.
    error = count - math.floor(w[W.counts])
    w[W.counts] += _DT * kp * error
    w[W.counts_velocity] += _DT * ki * error
    # encoder.cpp: less than half a step of the integrator is zero, or a shaft at rest would dither for ever.
    if abs(w[W.counts_velocity]) < 0.5 * _DT * ki:
        w[W.counts_velocity] = 0.0
    w[W.pos_estimate] = w[W.counts] / w[W.counts_per_turn] + w[W.shift]
    w[W.vel_estimate] = w[W.counts_velocity] / w[W.counts_per_turn]


@kernel(types.void(_V), no_refcount=True)
def _take_inputs(w: Words) -> None:
    """Compute the setpoints from the inputs, by the input mode; a mode that is not simulated changes nothing."""
    mode = w[W.input_mode]
    if mode == PASSTHROUGH:
        w[W.pos_setpoint], w[W.vel_setpoint] = w[W.input_pos], w[W.input_vel]
        w[W.torque_setpoint] = w[W.input_torque]
    elif mode == VEL_RAMP:
        step = abs(_DT * w[W.vel_ramp_rate])
        step = _between(w[W.input_vel] - w[W.vel_setpoint], -step, step)
        w[W.vel_setpoint] += step
        w[W.torque_setpoint] = step / _DT * w[W.inertia]
    elif mode == TORQUE_RAMP:
        step = abs(_DT * w[W.torque_ramp_rate])
        w[W.torque_setpoint] += _between(w[W.input_torque] - w[W.torque_setpoint], -step, step)
    elif mode == POS_FILTER:
        ki = 2.0 * min(w[W.input_filter_bandwidth], 0.25 * RATE_HZ)
        accel = 0.25 * ki * ki * (w[W.input_pos] - w[W.pos_setpoint])
        accel += ki * (w[W.input_vel] - w[W.vel_setpoint])
        w[W.torque_setpoint] = accel * w[W.inertia]
        w[W.vel_setpoint] += _DT * accel
        w[W.pos_setpoint] += _DT * w[W.vel_setpoint]


@kernel(_F(_V), no_refcount=True)
def _control(w: Words) -> float:
    """Return the torque (N·m) of the cascaded position, velocity and torque controllers, within the limits."""
    _take_inputs(w)
    top, mode, velocity = w[W.vel_limit], w[W.control_mode], w[W.vel_estimate]
    limited_velocity = w[W.enable_vel_limit] != 0.0
    if limited_velocity:
        w[W.vel_setpoint] = _between(w[W.vel_setpoint], -top, top)
    most = w[W.current_soft_max] * w[W.torque_constant]
    least = max(-most, w[W.torque_soft_min])
    most = min(most, w[W.torque_soft_max])
    w[W.torque_setpoint] = _between(w[W.torque_setpoint], least, most)
    wanted = w[W.vel_setpoint]
    if mode == POSITION_CONTROL:
        wanted += w[W.pos_gain] * (w[W.pos_setpoint] - w[W.pos_estimate])
    if limited_velocity:
        wanted = _between(wanted, -top, top)
    if w[W.enable_overspeed_error] != 0.0 and abs(velocity) > w[W.vel_limit_tolerance] * top:
        _fail(w, _OVERSPEED)
        return 0.0
    torque, error = w[W.torque_setpoint], 0.0
    if mode >= VELOCITY_CONTROL:
        error = wanted - velocity
        torque += w[W.vel_gain] * error + w[W.vel_integrator]
    elif w[W.enable_torque_mode_vel_limit] != 0.0:
        gain = w[W.vel_gain]
        torque = _between(torque, (-top - velocity) * gain, (top - velocity) * gain)
    held = _between(torque, least, most)
    if mode < VELOCITY_CONTROL:
        w[W.vel_integrator] = 0.0
    elif held != torque:
        # Anti-windup of controller.cpp: a saturated output lets the integrator decay.
        w[W.vel_integrator] *= 0.99
    else:
        bound = w[W.vel_integrator_limit]
        grown = w[W.vel_integrator] + w[W.vel_integrator_gain] * _DT * error
        w[W.vel_integrator] = _between(grown, -bound, bound)
    return held


@kernel(types.void(_V), no_refcount=True)
def _check_faults(w: Words) -> None:
    """Set the errors that the drive detects itself; clear those of supply, temperature and encoder without a cause."""
    kept = int(w[W.active_errors]) & ~(_OVER | _UNDER | _HOT | _MISSING)
    w[W.active_errors] = float(kept)
    if w[W.struck] != 0.0:
        _fail(w, int(w[W.struck]))
        w[W.struck] = 0.0
    if w[W.voltage] > MOST_VOLTAGE:
        _fail(w, _OVER)
    if w[W.voltage] < LEAST_VOLTAGE:
        _fail(w, _UNDER)
    if w[W.temperature] > MOST_TEMPERATURE:
        _fail(w, _HOT)
    if w[W.encoder_valid] == 0.0:
        _fail(w, _MISSING)
    # Only while the motor is driven: the maker's example for 0.6 (odriverobotics/ODriveResources,
    # examples/can_watchdog.py) clears no error before it begins.
    if w[W.enable_watchdog] != 0.0 and w[W.state] == CLOSED_LOOP:
        w[W.watchdog_left] -= _DT
        if w[W.watchdog_left] <= 0.0:
            _fail(w, _EXPIRED)


@kernel(types.void(_V), no_refcount=True)
def _change_state(w: Words) -> None:
    wanted = w[W.requested]
    w[W.requested] = 0.0
    if wanted == IDLE:
        w[W.state] = IDLE
    elif wanted == CLOSED_LOOP and w[W.state] == IDLE and w[W.active_errors] == 0.0:
        w[W.state] = CLOSED_LOOP
        w[W.disarm_reason] = 0.0
        w[W.vel_integrator] = w[W.vel_setpoint] = w[W.torque_setpoint] = 0.0
        w[W.pos_setpoint] = w[W.pos_estimate]
        if w[W.control_mode] >= POSITION_CONTROL:
            w[W.input_pos] = w[W.pos_estimate]  # no jump to an old target


@kernel(LAW, no_refcount=True)
def law(w: Words, count: int, measured: float) -> float:
    """Compute a control cycle from memory `w`, encoder count and shaft torque (N·m); return the wanted torque (N·m)."""
    if w[W.encoder_valid] != 0.0:
        _estimate(w, count)
    share = w[W.torque_constant] / w[W.motor_constant]  # configured over true constant of the motor
    w[W.torque] = measured * share
    _check_faults(w)
    if w[W.requested] != 0.0:
        _change_state(w)
    torque = 0.0
    if w[W.state] == CLOSED_LOOP:
        torque = _control(w)
    if w[W.state] != CLOSED_LOOP:
        torque = 0.0
    w[W.torque_target] = torque
    return float(torque / share)
