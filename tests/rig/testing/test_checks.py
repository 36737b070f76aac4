"""Checks for a lab's own tests find each rule that a law or an estimator breaks."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.control import estimators, friction, laws
from rig.control.estimators.estimator import Estimator
from rig.control.law import Law
from rig.control.plain_law import law
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE, LAW_SIGNATURE
from rig.testing import check_estimator, check_law

Floats = NDArray[np.float64]
compiled = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled here")


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("spring-damper", {}),
        ("spring-damper", {"pull": "allow"}),
        ("spring-damper", {"damping_on": "entry"}),
        ("bilateral", {"everywhere": True}),
        ("excited", {"everywhere": True}),
    ],
)
def test_our_own_laws_keep_the_promises(name: str, given: dict[str, Any]) -> None:
    check_law(name, **given)


def test_a_wall_with_friction_compensation_keeps_them_where_it_acts() -> None:
    """Outside the wall the compensation acts too, and on the way in it pulls by less than the rig's friction."""
    wanted = friction.Compensation(up=0.1, down=0.1, dead_band=0.1)
    check_law(friction.compensate_friction(laws.get("spring-damper"), wanted), everywhere=True, passive=False)


@cache
def bad(function: Callable[..., float]) -> Law:
    return Law("bad", "", kernel(LAW_SIGNATURE)(function), 2, lambda wall: [wall["stiffness"]])


def allocates(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    found = np.full(3, depth)
    return float(max(0.0, found[elapsed]))


def writes_beside(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    state[2] = depth
    return max(0.0, depth)


def tunes_itself(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    numbers[0] += 1.0
    return max(0.0, depth)


def divides(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    return 0.0 if depth <= 0.0 else depth / (1.0 - depth)


def reaches_out(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    return numbers[0] * abs(depth)


def attracts(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    return 0.0 if depth <= 0.0 else numbers[0] * (depth - 0.001)


def drives(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    return 0.0 if depth <= 0.0 else max(0.0, numbers[0] * depth - velocity)


def marks(depth: float, velocity: float, elapsed: int, state: Floats, numbers: Floats) -> float:
    state[0] = depth
    return max(0.0, depth)


@compiled
@pytest.mark.parametrize(
    ("function", "message"),
    [
        (allocates, "the law allocates while it runs"),
        (writes_beside, "writes outside of its memory"),
        (tunes_itself, "changes its parameters"),
        (marks, "is neither 0 nor 1"),
        (divides, "gives a reaction that is not finite: penetration 1"),
        (reaches_out, "acts outside of the wall: penetration -"),
        (attracts, "pulls a handle at rest into the wall"),
        (drives, r"gives .* J in a cycle 0.01 deep .*: it feeds energy into the handle"),
    ],
)
def test_the_error_of_a_law_names_the_broken_promise(function: Callable[..., float], message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_law(bad(function))


def test_a_law_that_remembers_outside_of_its_arrays_is_found() -> None:
    if not numba.config.DISABLE_JIT:  # compiled code freezes what it finds, and cannot
        pytest.skip("plain Python alone can do that")
    calls = [0.0]

    def ages(penetration: float, *_: Any) -> float:
        calls[0] += 1.0
        return max(0.0, penetration) * calls[0]

    with pytest.raises(AssertionError, match="restart"):
        check_law(bad(ages))


def test_an_argument_allows_what_a_law_does_on_purpose() -> None:
    check_law(bad(reaches_out), everywhere=True)
    check_law(bad(attracts), pulls=True)
    check_law(bad(drives), passive=False)

    @law(everywhere=True)
    def magnet(penetration: float) -> float:
        return max(penetration, -1e-3)

    check_law(magnet)  # declares it itself


def leaks(count: Any, age: Any, elapsed: Any, effort: Any, floats: Any, ints: Any, numbers: Any) -> float:
    found = np.full(2, 0.0)
    return float(found[0])


def overflows(count: Any, age: Any, elapsed: Any, effort: Any, floats: Any, ints: Any, numbers: Any) -> float:
    ints[3] = count
    return 0.0


@compiled
@pytest.mark.parametrize(
    ("function", "message"),
    [(leaks, "the estimator allocates while it runs"), (overflows, "writes outside of its memory")],
)
def test_the_error_of_an_estimator_names_the_broken_promise(function: Any, message: str) -> None:
    fdm = estimators.get("fdm")
    broken: Estimator = replace(fdm, update=kernel(ESTIMATOR_SIGNATURE)(function))
    with pytest.raises(AssertionError, match=message):
        check_estimator(broken)
