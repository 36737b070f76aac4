"""Groups of arguments for kernels: swapped groups, members of a wrong type, and members by position are rejected."""

from typing import Annotated, Any, NamedTuple

import numba
import numpy as np
import pytest
from numba import types

from rig.config import controller, presets
from rig.loop import _host as host
from rig.loop.layout import SETTINGS, Buffers, SharedRing
from rig.realtime.groups import Address, Floats, Int, group, type_of
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE, LawPlug
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.rigs import rotary_rig


@group
class Wanted(NamedTuple):
    values: Floats
    place: Int


@group
class Measured(NamedTuple):
    """A group with the same members as `Wanted`."""

    values: Floats
    place: Int


@group
class Plugged(NamedTuple):
    law: LawPlug
    state: Floats
    address: Address


@group
class Both(NamedTuple):
    wanted: Annotated[Wanted, type_of(Wanted)]
    measured: Annotated[Measured, type_of(Measured)]


@kernel(types.float64(type_of(Wanted), type_of(Measured)))
def error(wanted: Any, measured: Any) -> Any:
    return wanted.values[wanted.place] - measured.values[measured.place]


@kernel(LAW_SIGNATURE)
def counting(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[0] += 1.0
    return state[0] if penetration >= 0.0 else 1.0 / 0.0


@kernel(types.float64(type_of(Plugged), types.int64))
def repeated(plugged: Any, times: Any) -> Any:
    last = 0.0
    for _ in range(times):
        last = plugged.law(0.0, 0.0, 1, plugged.state, plugged.state)
    return last + plugged.address


def wanted(**members: Any) -> Any:
    return Wanted(**{"values": np.array([3.0, 5.0]), "place": 1, **members})


def measured(**members: Any) -> Any:
    return Measured(**{"values": np.array([1.0, 2.0]), "place": 0, **members})


def test_a_kernel_takes_groups_and_their_arrays_are_the_callers() -> None:
    assert error(wanted(), measured()) == 4.0
    plugged = Plugged(law=counting, state=np.zeros(1), address=(1 << 63) + 4096)
    assert repeated(plugged, 3) == 3.0 + (1 << 63) + 4096
    assert plugged.state[0] == 3.0


@pytest.mark.parametrize(
    "make_groups", [(measured, wanted), (wanted, wanted), (lambda: tuple(wanted()), measured)]
)
def test_two_groups_in_each_others_place_are_refused(make_groups: Any) -> None:
    """They are rejected after a correct call too, and although all members have the same types."""
    assert error(wanted(), measured()) == 4.0
    with pytest.raises(TypeError, match="No matching definition"):
        error(*(make() for make in make_groups))


def test_two_arguments_of_the_loop_in_each_others_place_are_refused() -> None:
    """A controller in place of the port, or buffers in place of the ring, must not compile."""
    link = MemoryLink(SimulatedDevice(rotary_rig()))
    law = controller.for_experiment(presets.load("koul-compliant"), current_quantum_a=0.001).arguments()
    shared = SharedRing(words=0, mailbox=0, rows=np.zeros(1, np.int64))
    right = [link.port(), law, shared, np.zeros(1, SETTINGS), Buffers.allocate()]
    for one, other in ((0, 1), (2, 4)):
        swapped = list(right)
        swapped[one], swapped[other] = right[other], right[one]
        with pytest.raises(TypeError, match="No matching definition"):
            host.run(*swapped)


@pytest.mark.parametrize(
    "members",
    [
        {"values": np.zeros(2, np.float32)},
        {"values": np.zeros((2, 2))},
        {"values": np.zeros(4)[::2]},
        {"place": 1.5},
        {"place": True},
        {"place": None},
    ],
)
def test_a_member_of_another_type_is_refused(members: Any) -> None:
    with pytest.raises(TypeError, match="No matching definition"):
        error(wanted(**members), measured())


def test_a_group_in_a_group_is_of_its_type_where_all_of_its_members_are() -> None:
    assert numba.typeof(Both(wanted=wanted(), measured=measured())) is type_of(Both)
    for wrong in (measured(), tuple(wanted()), wanted(values=np.zeros(2, np.float32))):
        assert numba.typeof(Both(wanted=wrong, measured=measured())) != type_of(Both)


def test_a_plug_that_does_not_fit_and_an_address_below_zero_are_refused() -> None:
    state = np.zeros(1)
    for law in (error, None, 3.0):
        with pytest.raises((NotImplementedError, numba.core.errors.TypingError)):
            repeated(Plugged(law=law, state=state, address=0), 1)
    with pytest.raises(OverflowError):
        repeated(Plugged(law=counting, state=state, address=-1), 1)


def test_a_group_is_made_by_keyword_alone_and_whole() -> None:
    with pytest.raises(TypeError, match="positional"):
        Wanted(np.zeros(1), 0)
    with pytest.raises(TypeError, match="place"):
        Wanted(values=np.zeros(1))
    assert wanted()._replace(place=0).place == 0
