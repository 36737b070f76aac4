"""Disturbance observer of a motor and a link joined by a spring; the encoder is on the motor, the hand on the link.

It knows both inertias, the spring and the effort, and estimates the hand as an unknown acceleration of the link, which
varies slowly. Two poles of the estimation error lie at the free mode of the two masses with a damping ratio of their
own, the other three at ω0 as those of `disturbance`. The gains are those of the continuous observer, by comparing
coefficients. A step takes the accelerations at half of it, so that the mode neither grows nor decays by the
discretisation; at too low a velocity rate the observer is unstable, and refused. Friction and the damping of the spring
are not in the model. Experiments name it ``disturbance-two-mass``. Its update must not allocate.

Source: own derivation, on the observer of Ohishi et al. (1987) in the form with an augmented state.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from rig.control.estimators._fdm import count_difference
from rig.control.estimators._kalman import LONGEST_GAP
from rig.control.estimators.estimator import (
    COMMON,
    OWN_INTS,
    PERIOD,
    RESOLUTION,
    WINDOW,
    Estimator,
    Floats,
    Ints,
    Setting,
)
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

NAME = "disturbance-two-mass"
# parameters, in counts and periods: accelerations of both masses by a twist of 1, gains of the five states, and the
# motor's acceleration by a unit of effort
SPRING_MOTOR, SPRING_LINK, GAIN1, GAIN2, GAIN3, GAIN4, GAIN5, INPUT = range(COMMON, COMMON + 8)
# state_f: position of the motor less the last count, its velocity, link less motor, velocity of the link, acceleration
# of the link by the hand
OFFSET, VELOCITY, TWIST, LINK, HAND = range(5)
STARTED, PREVIOUS = OWN_INTS, OWN_INTS + 1  # state_i
LOWEST_HZ = 0.1  # of frequency_hz
# Times the velocity rate at which the observer is unstable. No rule of thumb gives the lowest stable one: on
# koul-compliant, whose mode is at 587 Hz, it is 1.9 kHz at 0.1 Hz, 3.4 kHz at 150 Hz and 9.5 kHz at 825 Hz.
HIGHER_RATES = 1.01 ** np.arange(1, 1000)


@kernel(ESTIMATOR_SIGNATURE, no_refcount=True)
def update(
    count: int,
    edge_age_s: float,
    elapsed_ticks: int,
    effort: float,
    state_f: Floats,
    state_i: Ints,
    parameters: Floats,
) -> float:
    """Return the velocity (rad/s or m/s) of the motor at a new encoder count; 0 for the first sample."""
    scale = parameters[RESOLUTION] / parameters[PERIOD]
    moved = count_difference(count, state_i[PREVIOUS])
    state_i[PREVIOUS] = count
    if state_i[STARTED] == 0:
        state_i[STARTED] = 1
        return 0.0
    state_i[WINDOW] = elapsed_ticks
    if elapsed_ticks > LONGEST_GAP:
        state_f[OFFSET], state_f[TWIST], state_f[HAND] = 0.0, 0.0, 0.0
        state_f[VELOCITY] = state_f[LINK] = moved / elapsed_ticks
        return float(state_f[VELOCITY] * scale)

    offset, velocity, twist, link = state_f[OFFSET], state_f[VELOCITY], state_f[TWIST], state_f[LINK]
    hand, driven = state_f[HAND], parameters[INPUT] * effort
    for _ in range(elapsed_ticks):
        half = twist + 0.5 * (link - velocity)
        of_motor = driven + parameters[SPRING_MOTOR] * half
        of_link = hand - parameters[SPRING_LINK] * half
        offset += velocity + 0.5 * of_motor
        twist += link - velocity + 0.5 * (of_link - of_motor)
        velocity += of_motor
        link += of_link
    innovation = moved - offset
    velocity += parameters[GAIN2] * innovation
    state_f[OFFSET] = (parameters[GAIN1] - 1.0) * innovation
    state_f[VELOCITY] = velocity
    state_f[TWIST] = twist + parameters[GAIN3] * innovation
    state_f[LINK] = link + parameters[GAIN4] * innovation
    state_f[HAND] = hand + parameters[GAIN5] * innovation
    return float(velocity * scale)


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the observer's parameters; raise `ConfigError` for a rigid rig, or where the observer is unstable."""
    motor, link = settings["motor_inertia"], settings["link_inertia"]
    stiffness = settings["transmission_stiffness"]
    if stiffness == 0.0 or link == 0.0:
        raise ConfigError(
            f"estimator {NAME}: transmission_stiffness = {stiffness:g} and link_inertia = {link:g} are not two masses "
            "joined by a spring",
            remedy='choose the estimator disturbance, or describe the rig with structure = "two-mass"',
        )
    numbers = _springs_and_gains(settings, period_s)
    if not _is_stable(numbers):
        mode_hz = math.sqrt(stiffness / motor + stiffness / link) / (2.0 * math.pi)
        rates = np.ceil(HIGHER_RATES / period_s)
        stable = (rate for rate in rates if _is_stable(_springs_and_gains(settings, 1.0 / rate)))
        slowest = _springs_and_gains({**settings, "frequency_hz": LOWEST_HZ}, period_s)
        lower = ", or choose a lower frequency_hz" if _is_stable(slowest) else ""
        raise ConfigError(
            f"estimator {NAME}: unstable at a velocity rate of {1.0 / period_s:g} Hz with frequency_hz = "
            f"{settings['frequency_hz']:g} Hz and a mode of {mode_hz:.3g} Hz",
            remedy=f"raise velocity_rate to {next(stable, math.inf):.0f} Hz or more{lower}",
        )
    return [*numbers, period_s**2 / (motor * resolution)]


def _springs_and_gains(settings: Mapping[str, Any], period_s: float) -> list[float]:
    """Return the accelerations of motor and link by a twist of 1, and the gains of the five states."""
    a, b = (
        settings["transmission_stiffness"] / settings[f"{side}_inertia"] * period_s**2
        for side in ("motor", "link")
    )
    w = 2.0 * math.pi * settings["frequency_hz"] * period_s  # ω0·T
    square = a + b  # that of the mode, squared
    d = 2.0 * settings["damping"] * math.sqrt(square)
    # (s³ + 2w·s² + 2w²·s + w³)·(s² + d·s + square)
    l1, l2 = 2.0 * w + d, 2.0 * w * (w + d)
    l3 = (w**3 + 2.0 * w**2 * d + 2.0 * w * square - l1 * b) / a
    l4 = (w**3 * d + 2.0 * w**2 * square - l2 * b) / a
    return [a, b, l1, l2, l3 - l1, l4, w**3 * square / a]


def _is_stable(numbers: list[float]) -> bool:
    """Return True if all poles of the estimation error lie inside the unit circle, for one step of `update`."""
    a, b, *gains = numbers
    offset, velocity, twist, link, hand = np.eye(5)
    half = twist + 0.5 * (link - velocity)
    of_motor, of_link = a * half, hand - b * half
    offset = offset + velocity + 0.5 * of_motor
    turned = twist + link - velocity + 0.5 * (of_link - of_motor)
    step = np.array([offset, velocity + of_motor, turned, link + of_link, hand])
    return bool(np.abs(np.linalg.eigvals(step - np.outer(gains, offset))).max() < 1.0)


ESTIMATOR = Estimator(
    name=NAME,
    summary="disturbance observer of two masses: inertias, spring and effort known, the hand unknown",
    source="own derivation, after Ohishi et al. (1987)",
    update=update,
    floats=HAND + 1,
    ints=PREVIOUS + 1,
    settings=(
        Setting("frequency_hz", 150.0, LOWEST_HZ, 1e6, "Hz", "natural frequency ω0/2π of the observer"),
        Setting("damping", 0.5, 0.01, 2.0, "1", "damping ratio of the mode's poles"),
        Setting("motor_inertia", None, 1e-12, 1e6, "kg·m² or kg", "inertia of the motor side", of_rig=True),
        Setting("link_inertia", None, 0.0, 1e6, "kg·m² or kg", "link without the hand", of_rig=True),
        Setting("transmission_stiffness", None, 0.0, 1e12, "N·m/rad or N/m", "of the spring", of_rig=True),
    ),
    design=design,
    position=OFFSET,
    uses_effort=True,
)
