"""The device's multisine: Python makes the same from lines, seed and amplitudes, to the last bit and in theory."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.excitation import Multisine
from rig.sample import Phase
from tests.firmware.law.law_cases import shaken
from tests.firmware.law.law_design import FIXED, FLOAT
from tests.firmware.law.law_library import inputs

M32 = 2**32


def line_phase(seed: int, line: int) -> int:
    """As law.h says."""
    z = (seed + 0x9E3779B9 * (line + 1)) % M32
    z = (z ^ z >> 16) * 0x85EBCA6B % M32
    z = (z ^ z >> 13) * 0xC2B2AE35 % M32
    return z ^ z >> 16


def cosine(phase: int) -> int:
    """The polynomial of multisine.c in Python's integers."""
    turned = (phase + 2**30) % M32
    within = turned % 2**30
    x = 2**30 - within if turned & 2**30 else within
    square, total = x * x >> 30, 162860
    for c in (-5018831, 85566403, -693598306, 1686629706):
        total = c + (total * square >> 30)
    value = total * x >> 30
    return -value if turned & 2**31 else value


def played(m, ticks: np.ndarray) -> list[int]:
    """Effort (quanta · 2^16) at these ticks of the excitation."""
    inverse, values = 2**56 // m.period, []
    for t in ticks.tolist():
        total = 0
        for j in range(m.lines):
            phase = ((m.harmonic[j] * t % m.period * inverse >> 24) + line_phase(m.seed, j)) % M32
            total += m.amplitude[j] * cosine(phase)
        total >>= 30
        if t < m.ramp:
            total = total * (2**30 - cosine((t << 31) // m.ramp) >> 1) >> 30
        values.append(total)
    return values


def run(law, p, elapsed):
    state = law.reset(p)
    state.phase = Phase.TRIAL
    return law.run(p, inputs(np.full(len(elapsed), p.reference), np.array(elapsed)), state)


@given(st.integers(0, M32 - 1))
def test_cosine_and_phases_are_pythons(law, number):
    assert law.so.law_cosine(number) == cosine(number)
    assert abs(cosine(number) / 2**30 - math.cos(2 * math.pi * number / M32)) < 1e-8
    assert law.so.law_line_phase(number, number % 64) == line_phase(number, number % 64)


@given(st.data())
def test_currents_are_pythons_to_the_bit(law, data):
    draw = data.draw
    lines = draw(st.integers(1, 12))
    period = draw(st.integers(2 * lines + 2, 200_000))
    harmonics = sorted(draw(st.sets(st.integers(1, (period - 1) // 2), min_size=lines, max_size=lines)))
    amplitudes = draw(st.lists(st.integers(-(2**26), 2**26), min_size=lines, max_size=lines))
    elapsed = draw(st.lists(st.sampled_from([1, 1, 1, 2, 9, 100_000]), min_size=1, max_size=40))
    ramp = draw(st.integers(0, 60))
    given_ = {"period": period, "harmonics": harmonics, "amplitudes": amplitudes, "ramp": ramp}
    p = shaken(FIXED, **given_, seed=draw(st.integers(0, M32 - 1)))
    shift = p.fixed_wall.shift
    values = played(p.multisine, np.cumsum(elapsed) - elapsed[0])
    scaled = [v << shift - 16 if shift > 16 else v >> 16 - shift for v in values]
    expected = [max(-32767, min(32767, v + 2 ** (shift - 1) >> shift)) for v in scaled]
    assert run(law, p, elapsed)["current"].tolist() == expected


@pytest.mark.parametrize("arithmetic", [FIXED, FLOAT])
def test_it_is_the_multisine_of_rig_excitation(law, arithmetic):
    period_s, rate = 0.1, 20_000
    harmonics, amplitudes = [1, 3, 7, 20, 55], [300.0, 200.0, 100.0, 400.0, 50.0]
    fixed = [round(a * 2**16) for a in amplitudes]
    p = shaken(arithmetic, period=2000, harmonics=harmonics, amplitudes=fixed, seed=77)
    phases = [2 * math.pi * line_phase(77, j) / M32 for j in range(len(harmonics))]
    wanted = Multisine(period_s, np.array(harmonics) / period_s, amplitudes, phases).period(rate)
    currents = run(law, p, [1] * 4000)["current"]
    assert np.abs(currents - np.tile(wanted, 2)).max() <= 0.5001
    assert (currents[:2000] == currents[2000:]).all()


def test_phases_of_a_seed_are_even_on_the_circle():
    phases = np.array([line_phase(seed, j) for seed in range(50) for j in range(64)]) / M32
    assert np.abs(np.histogram(phases, 16, (0, 1))[0] - 200).max() < 60
    assert abs(np.exp(2j * np.pi * phases).mean()) < 0.05
