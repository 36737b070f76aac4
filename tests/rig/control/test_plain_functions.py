"""Laws and estimators from plain functions: their results, their arguments, and the errors of invalid ones."""

import math
from typing import Any

import numba
import numpy as np
import pytest

from rig.control.plain_functions import Memory, Parameters
from rig.control.plain_law import law
from rig.core.errors import ConfigError
from rig.testing.estimators import velocities
from rig.testing.laws import reactions
from tests.conformance.own_parts import blend, stiffening

compiled = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled here")


def test_a_law_knows_its_parameters_by_name_and_acts_inside_the_wall_alone() -> None:
    depth, speed = np.array([-0.01, 0.0, 0.01]), np.array([1.0, 1.0, -0.2])
    found = reactions(stiffening(), depth, speed, stiffness=100.0, damping=0.5)
    assert found == pytest.approx([0.0, 0.0, 100.0 * 0.01 + 1e5 * 1e-4 - 0.1])
    assert (stiffening().name, stiffening().summary) == ("stiffening", "A wall that grows harder with depth.")


def test_other_parameters_make_another_law_and_leave_this_one_alone() -> None:
    softer = stiffening().with_parameters(quadratic=0.0)
    assert reactions(softer, [0.01], stiffness=100.0).tolist() == pytest.approx([1.0])
    assert reactions(stiffening(), [0.01], stiffness=100.0).tolist() == pytest.approx([11.0])
    with pytest.raises(ConfigError, match=r"unknown parameter 'quadratc'; did you mean quadratic\?"):
        stiffening().with_parameters(quadratc=0.0)
    with pytest.raises(ConfigError, match=r"quadratic = -1 is out of range; .* from 0 to 1e\+06 N·m/rad²"):
        stiffening().with_parameters(quadratic=-1)
    with pytest.raises(ConfigError, match=r"quadratic = nan"):
        stiffening().with_parameters(quadratic=math.nan)


def test_memory_lasts_and_time_is_in_seconds() -> None:
    """A Maxwell element of ten ticks: by backward Euler, (10/11)^10 of a step remains after ten ticks."""

    @law(memory=("held", "calls"), everywhere=True)
    def relaxing_wall(elapsed_s: float, memory: Memory, penetration: float, p: Parameters) -> float:
        memory.calls += 1.0
        memory.held += (penetration - memory.held) * elapsed_s / (elapsed_s + 10.0 * p.tick_s)
        return p.stiffness * (penetration - memory.held)

    assert relaxing_wall.name == "relaxing-wall", "as the name of a file"
    made = relaxing_wall.prepare({"stiffness": 2.0, "damping": 0.0, "tick_s": 1e-3})
    found = [made.law.function(1.0, 0.0, 1, made.state, made.parameters) for _ in range(10)]
    assert found[-1] == pytest.approx(2.0 * (10 / 11) ** 10)
    assert made.state.tolist() == [0.0, pytest.approx(1.0 - (10 / 11) ** 10), 10.0]
    lost = made.law.function(1.0, 0.0, 10, made.state, made.parameters)
    assert lost == pytest.approx(0.5 * found[-1]), "ten ticks at once: 10/(10 + 10)"


def test_an_estimator_is_given_travel_whatever_encoder_and_link_do() -> None:
    assert (blend().name, blend().source) == ("mine", "a paper")
    made = blend().prepare({"weight": 0.0}, -1e-3, 0.5)
    counts, elapsed = [2**31 - 2, -(2**31), -(2**31) + 4], [1, 1, 2]
    assert velocities(made, counts, elapsed).tolist() == [0.0, pytest.approx(-4e-3), pytest.approx(-4e-3)]
    assert made.state_i[0] == 2, "the row shows how many periods the estimate spans"


def test_an_estimators_settings_are_those_of_an_experiment() -> None:
    slopes = velocities(blend().prepare({"weight": 0.25}, 1.0, 1.0), [0, 4, 4])
    assert slopes.tolist() == [0.0, 3.0, 1.0]
    with pytest.raises(ConfigError, match="weight = 2 is out of range"):
        blend().prepare({"weight": 2.0}, 1.0, 1.0)


def helper(x: float) -> float:
    return x


def misspelt(penetration: float, p: Parameters) -> float:
    return p.stifness * penetration


def forgets(penetration: float, memory: Memory) -> float:
    memory.depest = penetration
    return penetration


def allocates(penetration: float) -> float:
    table = np.zeros(3)
    return float(table[0] + penetration)


def calls(penetration: float) -> float:
    return helper(penetration)


def undefined(penetration: float) -> float:
    return penetration * gain  # type: ignore[name-defined]  # noqa: F821


def silent(penetration: float) -> float:  # type: ignore[return]
    if penetration > 1.0:
        return 1.0


def says(penetration: float) -> str:
    return "hard"


def sets(penetration: float, p: Parameters) -> float:
    p.stiffness = 3.0
    return penetration


def imports(penetration: float) -> float:
    import os  # noqa: PLC0415

    return penetration * len(os.sep)


def absent(penetration: float) -> float:
    return math.hypotenuse(penetration)  # type: ignore[attr-defined, no-any-return]


@compiled
@pytest.mark.parametrize(
    ("function", "line", "message"),
    [
        (misspelt, 1, r"p: unknown number 'stifness'; did you mean stiffness\?"),
        (forgets, 0, r"memory: unknown number 'depest'; did you mean deepest\?"),
        (allocates, 1, r"it creates an array, a list or a text, .*; use single numbers"),
        (calls, 1, r"helper cannot be used in compiled code; .* helpers decorated by numba.njit"),
        (undefined, 0, r"the name gain is not defined;"),
        (silent, 0, r"returns no value on one of its paths; return a number on every"),
        (says, 0, r"returns .*str.*; return a number"),
        (sets, 0, r"it assigns to a parameter; store values that change in memory"),
        (imports, 1, r"unsupported opcode \(IMPORT_NAME\) found; use numbers"),
        (absent, 0, r"module 'math' has no attribute 'hypotenuse'"),
    ],
)
def test_uncompilable_function_is_refused_with_its_reason(function: Any, line: int, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as refused:
        law(memory=("deepest",))(function)
    number = function.__code__.co_firstlineno + line
    assert f"law '{function.__name__}' (test_plain_functions.py, line {number})" in str(refused.value)
    assert "\n" not in str(refused.value)
    error = refused.value
    assert error.__context__ is None or error.__suppress_context__, "without the compiler's own report"


def named(penetraton: float) -> float:
    return penetraton


def unknown(penetration: float, colour: float) -> float:
    return penetration


def defaulted(penetration: float, p: float = 3.0) -> float:
    return penetration


def remembers(memory: Memory) -> float:
    return 0.0


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (named, r"argument 'penetraton' is unknown; did you mean penetration\?"),
        (unknown, r"argument 'colour' is .*; choose from penetration: .* \(rad or m\); velocity"),
        (defaulted, r"argument 'p' must be positional, without a default; write only its name"),
        (remembers, r"argument 'memory' is used, but no memory is declared; declare .*: memory="),
        (math.sin, r"law 'sin' is not a plain Python function"),
    ],
)
def test_an_unknown_argument_is_refused_with_a_list_of_the_valid_ones(function: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        law()(function)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"parameters": {"stiffness": 1.0}},
            r"'stiffness' .* reserved: every p has stiffness, damping, tick_s",
        ),
        ({"parameters": {"two words": 1.0}}, r"parameter 'two words' is not a valid name"),
        ({"parameters": {"gain": math.inf}}, r"gain = inf is out of range"),
        ({"parameters": {"gain": "much"}}, r"gain = 'much' is out of range"),
        ({"memory": ("x", "x")}, r"name 'x' of a memory is given twice"),
        ({"memory": ("_x",)}, r"memory '_x' is not a valid name"),
        ({"memory": ("class",)}, r"memory 'class' is not a valid name"),
    ],
)
def test_names_and_numbers_that_cannot_be_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        law(**given)(helper_law)


def helper_law(penetration: float) -> float:
    return penetration
