"""Which commanded current is active, for every order in which commands reach a device."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.connection import State
from firmware_protocol.faults import LimitFlag
from firmware_protocol.messages import NO_COMMAND_YET
from rig.control.step import new_memory
from rig.core.sample import RowFlag
from rig.loop._currents import OLDER, compare_command, keep_command
from rig.loop.layout import COMMANDS_KEPT, Buffers
from rig.realtime.codec import STATE


def is_marked(buffers: Any, sequence: int, current: int, age: int = 2, limits: int = 0) -> bool:
    memory = new_memory()
    buffers.state[STATE.state] = State.RUNNING
    buffers.state[STATE.command_sequence], buffers.state[STATE.command_age] = sequence % 65536, age
    buffers.state[STATE.current_commanded], buffers.state[STATE.limits] = current, limits
    compare_command(buffers, memory)
    return bool(memory[0]["flags"] & RowFlag.OTHER_CURRENT)


@given(
    st.integers(0, 65_535),
    st.lists(st.integers(-32_767, 32_767), min_size=OLDER + 2, max_size=40),
    st.integers(0, OLDER),
    st.integers(-3, 3),
)
def test_only_a_current_that_was_not_sent_is_marked(
    first: int, currents: list[int], back: int, wrong: int
) -> None:
    buffers = Buffers.allocate()
    for number, current in enumerate(currents):
        keep_command(buffers.sent, (first + number) % 65536, current, number)
    newest = first + len(currents) - 1
    assert is_marked(buffers, newest, currents[-1] + wrong) == (wrong != 0)
    assert not is_marked(buffers, newest, currents[-1 - back], age=1), (
        "it drove the tick in which the newest came"
    )
    elsewhere = currents[-1 - back] + wrong
    recent = currents[-1 - OLDER :]
    assert is_marked(buffers, newest, elsewhere, age=1) == (elsewhere not in recent)


@pytest.mark.parametrize("limit", list(LimitFlag))
def test_a_limit_explains_another_current_and_a_warning_does_not(limit: LimitFlag) -> None:
    buffers = Buffers.allocate()
    keep_command(buffers.sent, 7, 100, 0)
    warns = limit in (LimitFlag.SPEED, LimitFlag.POSITION)
    assert is_marked(buffers, 7, 50, limits=int(limit)) == warns


def test_without_the_active_command_no_current_is_marked() -> None:
    buffers = Buffers.allocate()
    for number in range(COMMANDS_KEPT + 1):
        keep_command(buffers.sent, number, 100, number)
    assert not is_marked(buffers, 0, 3)
    assert is_marked(buffers, 1, 3)
    assert not is_marked(Buffers.allocate(), 5, 3)
    assert not is_marked(buffers, 1, 3, age=NO_COMMAND_YET)
    assert np.all(buffers.sent >= 0)
