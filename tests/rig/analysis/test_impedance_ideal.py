"""Closed forms for rigs with sampled walls: the usual expressions, the rig alone, two masses.

`tests/rig/experiments/test_impedance_run.py` compares them with measurements in simulation.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from rig.analysis.impedance._ideal import bare, ideal_wall, rendered_impedance
from rig.analysis.theory._loop import linear_loop

LINES = np.array([20.0, 100.0, 240.0, 400.0])
RIGID = linear_loop("chawda-linear", "uniform:1k,estimator=fdm")  # without lag or delay


def test_the_usual_expression_is_within_the_promise_for_walls_that_can_be_stable() -> None:
    """0.1° and 0.3 % up to 400 Hz at 1 kHz for m·s + b + ZOH·(K/s + B·H/s) without sampling images."""
    lines = np.arange(1.0, 401.0)
    s = 2j * np.pi * lines
    zoh = (1 - np.exp(-s * 1e-3)) / (s * 1e-3)
    backward = (1 - np.exp(-s * 1e-3)) / 1e-3
    for stiffness, damping in ((1e4, 0.0), (26.3e3, 0.0), (2e4, 60.0), (4e4, 100.0)):
        usual = 0.52 * s + 13.2 + zoh * (stiffness + damping * backward) / s
        without_images = rendered_impedance(RIGID, stiffness, damping, lines, images=False)
        assert without_images == pytest.approx(usual, rel=1e-9)
        ratio = rendered_impedance(RIGID, stiffness, damping, lines) / usual
        assert np.abs(ratio) == pytest.approx(1.0, abs=2e-3)
        assert np.degrees(np.angle(ratio)) == pytest.approx(0.0, abs=0.1)


def test_without_a_wall_it_is_the_rig() -> None:
    s = 2j * np.pi * LINES
    assert bare(RIGID, LINES) == pytest.approx(0.52 * s + 13.2)
    assert rendered_impedance(RIGID, 0.0, 0.0, LINES) == pytest.approx(bare(RIGID, LINES))
    dual = rendered_impedance("chawda-linear", 0.0, 0.0, LINES, scheme="dual:4k/1k")
    assert dual == pytest.approx(bare(RIGID, LINES))
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
    motor_hz, both_hz = (math.sqrt(k / j) / (2 * math.pi) for j in (j1, j1 * j2 / (j1 + j2)))
    assert lines[np.argmax(size)] == pytest.approx(motor_hz, abs=0.2)
    assert lines[np.argmin(size)] == pytest.approx(both_hz, abs=0.2)
    slow = bare(loop, [1.0])[0]
    assert slow.imag == pytest.approx(2 * math.pi * loop.subject.inertia, rel=1e-3)
    assert slow.real == pytest.approx(loop.subject.damping, rel=1e-2)
