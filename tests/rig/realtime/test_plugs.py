"""Plug points: a function that is compiled once accepts any function of the right signature."""

import ctypes
import ctypes.util
from typing import Any

import numpy as np
from numba import types

from rig.control import estimators, laws
from rig.realtime import plugs
from rig.realtime.kernel import kernel


@kernel(types.float64(plugs.LAW, types.float64, types.float64[::1], types.float64[::1]))
def ask_law(law: Any, penetration: Any, state: Any, parameters: Any) -> Any:
    return law(penetration, 0.0, 1, state, parameters)


@kernel(types.int64(plugs.NOW, types.int64))
def ask_clock(now: Any, handle: Any) -> Any:
    return now(handle)


@kernel(plugs.LAW_SIGNATURE)
def magnet(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    return -parameters[0] * penetration


def test_every_estimator_and_every_law_has_the_signature_of_its_plug() -> None:
    for name in estimators.names():
        assert estimators.get(name).update.declared == (plugs.ESTIMATOR_SIGNATURE,)
    for name in laws.names():
        assert laws.get(name).function.declared == (plugs.LAW_SIGNATURE,)


def test_a_third_partys_law_runs_in_a_caller_compiled_before_it_was_known() -> None:
    state, parameters = np.zeros(1), np.array([100.0, 0.0, 0.0, 0.0])
    assert ask_law(magnet, 0.5, state, parameters) == -50.0
    assert ask_law(laws.get("spring-damper").function, 0.5, state, parameters) == 50.0
    assert len(ask_law.signatures) == 1


def test_a_c_librarys_function_plugs_in_by_its_address() -> None:
    labs = ctypes.CDLL(ctypes.util.find_library("c")).labs
    plug = plugs.NativeFunction(ctypes.cast(labs, ctypes.c_void_p).value, plugs.NOW_SIGNATURE, keep=labs)
    assert ask_clock(plug, -(1 << 40)) == 1 << 40


def test_a_plug_keeps_its_callback_alive() -> None:
    @ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)
    def now(handle: Any) -> Any:
        return handle + 1

    plug = plugs.NativeFunction(ctypes.cast(now, ctypes.c_void_p).value, plugs.NOW_SIGNATURE, keep=now)
    del now
    assert [ask_clock(plug, n) for n in range(100)] == list(range(1, 101))
