"""Closed forms for rigs with sampled walls, against a time-domain loop that is stepped tick by tick."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from rig.analysis.impedance._ideal import bare, ideal_wall, rendered_impedance
from rig.analysis.impedance._signals import hold
from rig.analysis.theory._lifted import Lifted
from rig.analysis.theory._loop import linear_loop
from rig.core.model import state_space
from tests.conformance.tiers import first_by_default

LINES = np.array([20.0, 100.0, 240.0, 400.0])
FINE = 16  # inner steps for each tick


class Loop:
    """The sampled loop in the time domain: exact exponentials between ticks, and the law as its design states it."""

    def __init__(self, loop: Any, stiffness: Any, damping: Any) -> None:
        model = loop.subject.model
        self.loop, self.k, self.b = loop, stiffness, damping
        self.plant = state_space(model.mechanics, model.amplifier, loop.subject.operator)
        self.lagless = model.amplifier.lag_s == 0.0
        self.estimator = np.zeros(loop.estimator.order)
        self.velocity = self.last = 0.0
        self.queue = [0.0] * loop.delay_ticks
        self.ticks = 0

    def step(self, matrix: Any, *more: Any) -> Any:
        """Return the exponential of the plant, its inputs appended to its states."""
        n = self.plant.order
        whole = np.zeros((n + len(more), n + len(more)))
        whole[:n, :n] = self.plant.a
        for column, (inputs, dynamics) in enumerate(more):
            whole[:n, n + column] = inputs
            whole[n + column, n : n + len(more)] = dynamics
        exact = expm(whole * matrix)
        if self.lagless:
            exact[self.plant.effort] = 0.0
        return exact

    def law(self, position: Any, own: float = 0.0) -> Any:
        """Compute the effort commanded at this tick, and return the one that becomes active now."""
        e, n = self.loop.estimator, self.loop.divider
        part = self.ticks % n
        if part == 0:
            self.last, self.velocity = self.velocity, e.c @ self.estimator + e.d * position
            self.estimator = e.a @ self.estimator + e.b * position
        extra = part / n * (self.velocity - self.last) if self.loop.extrapolate else 0.0
        self.ticks += 1
        self.queue.append(own - self.k * position - self.b * (self.velocity + extra))
        return self.queue.pop(0)


def measured(
    loop: Any,
    stiffness: Any,
    damping: Any,
    line: Any,
    *,
    seen: str = "handle",
    channel: str = "external",
    settle: float = 0.4,
) -> Any:
    """Return F/(jω·X) of one line in steady state, by a transform over 50 ms."""
    rig = Loop(loop, stiffness, damping)
    plant, n, w = rig.plant, rig.plant.order, 2.0 * np.pi * line
    external, command = plant.b[:, 1], plant.b[:, 0]
    still, cosine, sine = np.zeros(3), np.array([0.0, -w, 0.0]), np.array([w, 0.0, 0.0])
    multisine = external if channel == "external" else np.zeros(n)
    matrix = rig.step(loop.tick_s / FINE, (multisine, cosine), (np.zeros(n), sine), (command, still))
    x = np.zeros(n + 3)
    x[n] = 1.0
    row = plant.handle_position if seen == "handle" else plant.sensed_position
    ticks, judged, kept = round((settle + 0.05) / loop.tick_s), round(0.05 / loop.tick_s), []
    whole = np.linalg.matrix_power(matrix, FINE)  # the transient is not looked at between instants
    for k in range(ticks):
        own = math.cos(w * k * loop.tick_s) if channel == "motor" else 0.0
        x[n + 2] = rig.law(x[plant.sensed_position], own)
        if k < ticks - judged:
            x = whole @ x
            continue
        for _ in range(FINE):
            kept.append(x[row])
            x = matrix @ x
    every, step_s = (FINE, loop.tick_s) if seen == "samples" else (1, loop.tick_s / FINE)
    position = np.array(kept)[::every]
    t = (ticks * loop.tick_s) - 0.05 + np.arange(len(position)) * step_s
    amplitude = 2.0 * np.mean(position * np.exp(-1j * w * t))
    effort = hold(np.array([line]), loop.tick_s)[0] if channel == "motor" else 1.0
    return effort / (1j * w * amplitude)


def rigid(scheme: str = "uniform:1k,estimator=fdm", *, lag_s: float = 0.0, delay_ticks: int = 0) -> Any:
    loop = linear_loop("chawda-linear", scheme)
    model = loop.subject.model
    late = replace(
        model,
        amplifier=replace(model.amplifier, lag_s=lag_s),
        simulation=replace(model.simulation, computation_delay_ticks=delay_ticks),
    )
    return linear_loop(late, scheme)


SCHEMES = (
    "uniform:1k,estimator=fdm",
    "uniform:1k,estimator=fdm-butterworth,cutoff_hz=200",
    "uniform:1k,estimator=kalman",
    "dual:4k/1k,estimator=fdm",
    "dual:4k/1k,estimator=fdm,prediction=extrapolate",
)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    ("channel", "seen"),
    first_by_default([("external", "handle"), ("external", "samples"), ("motor", "samples")]),
)
def test_the_closed_form_is_the_impedance_of_the_stepped_loop(scheme: Any, channel: str, seen: str) -> None:
    loop = rigid(scheme)
    found = rendered_impedance(loop, 2e4, 60.0, LINES, channel=channel, seen=seen)
    for line, z in zip(LINES, found, strict=True):
        assert measured(loop, 2e4, 60.0, line, channel=channel, seen=seen) == pytest.approx(z, rel=1e-5)


@pytest.mark.parametrize("scheme", SCHEMES[:1] + SCHEMES[-1:])
@pytest.mark.parametrize(("lag_s", "delay_ticks"), [(2e-4, 0), (0.0, 1), (2e-4, 2)])
def test_closed_form_includes_lag_and_delay(scheme: Any, lag_s: float, delay_ticks: int) -> None:
    loop = rigid(scheme, lag_s=lag_s, delay_ticks=delay_ticks)
    for channel in ("external", "motor"):
        for line, z in zip(
            LINES[1::2], rendered_impedance(loop, 5e3, 60.0, LINES[1::2], channel=channel), strict=True
        ):
            assert measured(loop, 5e3, 60.0, line, channel=channel) == pytest.approx(z, rel=1e-4)


@pytest.mark.parametrize("seen", ["handle", "sensed"])
def test_two_masses_at_the_handle_and_at_the_encoder(seen: str) -> None:
    loop = linear_loop("koul-compliant", "dual:20k/2k,estimator=fdm-butterworth,cutoff_hz=200")
    assert float(Lifted.of(loop).radius(300.0, 0.5)) < 0.9999
    for line in (60.0, 400.0):
        z = rendered_impedance(loop, 300.0, 0.5, [line], seen=seen)[0]
        assert measured(loop, 300.0, 0.5, line, seen=seen, settle=0.3) == pytest.approx(z, rel=1e-4)


def test_the_usual_expression_is_within_the_promise_for_walls_that_can_be_stable() -> None:
    """0.1° and 0.3 % up to 400 Hz at 1 kHz for m·s + b + ZOH·(K/s + B·H/s) without sampling images."""
    lines = np.arange(1.0, 401.0)
    s = 2j * np.pi * lines
    zoh = (1 - np.exp(-s * 1e-3)) / (s * 1e-3)
    backward = (1 - np.exp(-s * 1e-3)) / 1e-3
    loop = rigid()
    for stiffness, damping in ((1e4, 0.0), (26.3e3, 0.0), (2e4, 60.0), (4e4, 100.0)):
        usual = 0.52 * s + 13.2 + zoh * (stiffness + damping * backward) / s
        assert rendered_impedance(loop, stiffness, damping, lines, images=False) == pytest.approx(
            usual, rel=1e-9
        )
        ratio = rendered_impedance(loop, stiffness, damping, lines) / usual
        assert np.abs(ratio) == pytest.approx(1.0, abs=2e-3)
        assert np.degrees(np.angle(ratio)) == pytest.approx(0.0, abs=0.1)


def test_without_a_wall_it_is_the_rig() -> None:
    s = 2j * np.pi * LINES
    assert bare(rigid(), LINES) == pytest.approx(0.52 * s + 13.2)
    assert rendered_impedance(rigid(), 0.0, 0.0, LINES) == pytest.approx(bare(rigid(), LINES))
    assert rendered_impedance("chawda-linear", 0.0, 0.0, LINES, scheme="dual:4k/1k") == pytest.approx(
        bare(rigid(), LINES)
    )
    assert ideal_wall(100.0, 3.0, LINES) == pytest.approx(100.0 / s + 3.0)


def test_two_masses_resonate_where_their_masses_and_the_capstan_say() -> None:
    """The rig is stiff where only the motor swings against the capstan, soft where both masses do; damping is low."""
    model = linear_loop("koul-compliant", "dual:20k/2k").subject.model
    quiet = {"transmission_damping_ratio": 1e-4, "motor_damping": 1e-5, "link_damping": 1e-5}
    loop = linear_loop(replace(model, mechanics=replace(model.mechanics, **quiet)), "dual:20k/2k")
    mechanics = loop.subject.model.mechanics
    lines = np.arange(400.0, 700.0, 0.1)
    j1, j2, k = mechanics.motor_inertia, mechanics.loaded_link_inertia, mechanics.transmission_stiffness
    size = np.abs(bare(loop, lines))
    assert lines[np.argmax(size)] == pytest.approx(math.sqrt(k / j1) / (2 * math.pi), abs=0.2)
    assert lines[np.argmin(size)] == pytest.approx(
        math.sqrt(k * (j1 + j2) / (j1 * j2)) / (2 * math.pi), abs=0.2
    )
    slow = bare(loop, [1.0])[0]
    assert slow.imag == pytest.approx(2 * math.pi * loop.subject.inertia, rel=1e-3)
    assert slow.real == pytest.approx(loop.subject.damping, rel=1e-2)
