"""Stall check on two neighbouring counts: a hand that holds still keeps its wall, a dead encoder loses it."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.faults import LimitFlag
from firmware_protocol.parameters import DEFAULTS
from rig import config
from rig.config import presets
from sim_backend.board.safety import AT, FADES_A_SECOND, Safety, check, limit_current

RATE, CONFIRM_MS = 1_000, 200
LIMIT = 5_000


def armed(**changes: Any) -> Safety:
    safety = Safety(config.rig_model(presets.load("koul-compliant")))
    values = {
        **DEFAULTS,
        "position_rate": RATE,
        "current_limit": LIMIT,
        "continuous_current": LIMIT,
        "confirm_ms": CONFIRM_MS,
        "hold_to_run": 1,
        "window_minimum": -(10**6),
        "window_maximum": 10**6,
        "speed_limit": 10**9,
        **changes,
    }
    safety.configure(values, 0)
    return safety


def run(safety: Safety, wanted: Any, counts: Any) -> tuple[Any, Any]:
    """Return the active currents and the limit flags of each tick."""
    flowing, flags = [], []
    for want, count in zip(wanted, counts, strict=True):
        current = limit_current(safety.rules, safety.heat, int(want))
        check(safety.rules, safety.heat, safety.counts, safety.currents, int(count), current, current)
        flowing.append(current)
        flags.append(safety.rules[AT.flags])
        safety.rules[AT.flags] = 0
    return np.array(flowing), np.array(flags)


def test_without_an_edge_the_effort_fades_out_and_says_why() -> None:
    ticks = 1_000
    flowing, flags = run(armed(), [4_000] * ticks, [5] + [5] * (ticks - 1))
    fade = RATE // FADES_A_SECOND
    acting = (flags & LimitFlag.NOT_CONFIRMED) != 0
    first = int(np.argmax(acting))
    assert first in range(CONFIRM_MS - 1, CONFIRM_MS + 3)  # ticks of a millisecond
    assert (flowing[:first] == 4_000).all()
    falling = flowing[first : first + fade]
    assert (np.diff(falling) <= 0).all()
    assert np.abs(np.diff(falling)).max() <= 4_000 // fade + 1
    assert (flowing[first + fade :] == 0).all()


def test_a_dead_channel_does_not_keep_it_however_the_other_toggles() -> None:
    # The count of a moving handle then toggles.
    for first in (5, -5, 0):
        flowing, flags = run(armed(), [4_000] * 1_000, first + np.arange(1_000) % 2)
        assert (flags[CONFIRM_MS + 3 :] & LimitFlag.NOT_CONFIRMED).all()
        assert not flowing[CONFIRM_MS + RATE // FADES_A_SECOND + 3 :].any()


def test_motion_in_time_keeps_it_and_one_too_late_does_not_bring_it_back() -> None:
    keeps = np.arange(2_000) // (CONFIRM_MS // 2 - 1)
    flowing, flags = run(armed(), [4_000] * 2_000, keeps)
    assert (flowing == 4_000).all()
    assert not flags.any()
    moves = np.where(np.arange(2_000) < 300, 0, np.arange(2_000))
    flowing, _ = run(armed(), [4_000] * 2_000, moves)
    assert flowing[-1] == 0


def test_free_space_brings_it_back() -> None:
    wanted = np.r_[[4_000] * 900, [0], [4_000] * 100]
    flowing, _ = run(armed(), wanted, [0] * len(wanted))
    assert flowing[899] == 0
    assert (flowing[901:] == 4_000).all()


def test_zero_means_never() -> None:
    flowing, flags = run(armed(confirm_ms=0), [4_000] * 5_000, [0] * 5_000)
    assert (flowing == 4_000).all()
    assert not flags.any()


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.sampled_from([-1, 1]))
def test_it_only_ever_takes_from_an_effort(seed: int, sign: int) -> None:
    random = np.random.default_rng(seed)
    wanted = sign * random.integers(0, LIMIT, 1_500)
    counts = np.cumsum(random.random(1_500) < random.choice([0.0, 0.001, 0.01]))
    flowing, flags = run(armed(), wanted, counts)
    assert (np.abs(flowing) <= np.abs(wanted)).all()
    assert (flowing * wanted >= 0).all()
    untouched = (flags & LimitFlag.NOT_CONFIRMED) == 0
    assert (flowing[untouched] == wanted[untouched]).all()


@pytest.mark.parametrize("rate", [50, 20_000, 50_000])
def test_the_time_is_the_same_at_every_rate(rate: int) -> None:
    ticks = round(rate * 1e-3 * CONFIRM_MS)
    _, flags = run(armed(position_rate=rate), [100] * (ticks + 5), [0] * (ticks + 5))
    first = int(np.argmax((flags & LimitFlag.NOT_CONFIRMED) != 0))
    assert abs(first - ticks) <= 2
