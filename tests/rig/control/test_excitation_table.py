"""The excitation table that a device plays: its error against the multisine, its peak, and its 16-bit range."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.parameters import PARAMETERS, encode_block
from rig.control.excitation import Multisine, ramp
from rig.control.excitation_table import PHASES, ExcitationTable, cosine, hashed_phases
from rig.core.errors import ConfigError

RATE, QUANTUM = 20_000, 2.5e-4  # N·m for one quantum
BAND = (1.0, 250.0)


def new_table(**changes: Any) -> Any:
    shape = Multisine.schroeder(BAND, 1.0, rms=0.05)
    return ExcitationTable.of(shape, RATE, QUANTUM, **changes)


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=200))
def test_the_cosine_keeps_its_bound(numbers: list[int]) -> None:
    phases = np.array(numbers, np.uint32)
    assert np.abs(cosine(phases) / 2**24 - np.cos(phases * (2 * np.pi / 2**32))).max() < 5.2e-6


def test_hashed_phases_are_even_on_the_circle() -> None:
    phases = np.concatenate([hashed_phases(seed, 64) for seed in range(50)]) / 2**32
    assert np.abs(np.histogram(phases, 16, (0, 1))[0] - 200).max() < 60
    assert abs(np.exp(2j * np.pi * phases).mean()) < 0.05


@pytest.mark.parametrize("phases", PHASES)
def test_the_table_is_the_multisine_within_the_stated_error(phases: Any) -> None:
    excitation = new_table(phases=phases, seed=3)
    ideal = excitation.multisine(RATE, QUANTUM).period(RATE)
    off = np.abs(excitation.efforts(QUANTUM) - ideal)
    assert off.max() <= excitation.error * QUANTUM
    assert excitation.error < 0.05  # quanta: a tenth of what rounding a current to whole quanta costs
    assert np.sqrt(np.mean(off**2)) < 1e-4 * excitation.rms * QUANTUM
    assert excitation.rms * QUANTUM == pytest.approx(0.05, rel=1e-4)
    assert excitation.peak * QUANTUM == pytest.approx(np.abs(ideal).max(), rel=1e-3)


def test_schroeders_phases_are_those_of_the_host() -> None:
    mine, shape = new_table().multisine(RATE, QUANTUM), Multisine.schroeder(BAND, 1.0, rms=0.05)
    assert np.abs(np.exp(1j * mine.phases) - np.exp(1j * shape.phases)).max() < 1e-4
    assert mine.lines_hz == pytest.approx(shape.lines_hz)
    assert mine.amplitudes == pytest.approx(shape.amplitudes, rel=1e-5)
    assert mine.crest_factor < 2.0


def test_the_format_leaves_room_for_the_peak_and_no_more() -> None:
    excitation = new_table()
    assert 2**14 <= np.abs(excitation.table.astype(int)).max() < 2**15
    small = ExcitationTable(1, 1, 1, 100, 2**10).with_most_bits()
    assert small.bits == 15
    with pytest.raises(ConfigError, match="peak"):
        ExcitationTable(64, 1, 1, 1000, 2**31 - 1).with_most_bits()


def test_excitation_rises_along_a_raised_cosine_and_repeats() -> None:
    excitation = new_table(ramp=5000)
    ticks = np.arange(30_000)
    played = excitation.played(ticks) / 2**16
    wanted = np.tile(excitation.values, 2)[:30_000] * ramp(ticks, 5000)
    assert np.abs(played - wanted).max() <= 4e-5 * excitation.peak + 2**-16
    assert (played[5000:10_000] == played[25_000:]).all()


def test_parameters_are_those_of_the_device() -> None:
    excitation = new_table(phases="hashed", seed=2**32 - 1, ramp=7)
    values = excitation.parameters()
    assert set(values) == {p.name for p in PARAMETERS if p.name.startswith("excitation_")}
    encode_block(values)  # every one is in its range


@pytest.mark.parametrize(
    ("shape", "rate"),
    [
        (Multisine.schroeder(BAND, 1.0, rms=0.05, spectrum="mass"), RATE),
        (Multisine(1.0, [1.0, 2.0, 4.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]), RATE),
        (Multisine.schroeder(BAND, 1.0, rms=0.05), 20_000.5),
        (Multisine.schroeder(BAND, 1.0, rms=0.05), 100_000),
        (Multisine.schroeder(BAND, 1.0, rms=0.05), 500),
        (Multisine.schroeder(BAND, 1.0, rms=100.0), RATE),
    ],
    ids=["spectrum", "spacing", "no whole number of ticks", "too long", "above Nyquist", "too large"],
)
def test_excitation_a_device_cannot_play_is_refused(shape: Any, rate: Any) -> None:
    with pytest.raises(ConfigError):
        ExcitationTable.of(shape, rate, QUANTUM)


@pytest.mark.parametrize(
    "change", [{"lines": 0}, {"phases": "random"}, {"amplitude": 2**31 - 1}, {"first": 400}, {"bits": 16}]
)
def test_numbers_that_a_device_would_refuse_are_refused_here(change: Any) -> None:
    good = {"lines": 200, "first": 1, "step": 1, "period": 1000, "amplitude": 1}
    ExcitationTable(**good)
    with pytest.raises(ConfigError):
        ExcitationTable(**good | change)
