"""Presentation of results: JSON, rows with units, and a list of items on the terminal."""

import json
import math
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.check import Check, Outcome, refuse, refused
from rig.core.errors import PlanError
from rig.core.present import plain, reported


class Colour(StrEnum):
    RED = "red"


class Level(IntEnum):
    HIGH = 3


@dataclass(frozen=True, slots=True)
class Part:
    settling_s: float
    effort: float
    trace: tuple[float, ...] = field(default=(1.0, 2.0), repr=False)

    @reported
    def ok(self) -> bool:
        return math.isfinite(self.settling_s)


@dataclass(frozen=True, slots=True)
class Whole:
    parts: tuple[Part, ...]
    colours: dict[Colour, Level]
    path: Path
    spectrum: np.ndarray


def test_a_result_is_its_fields_and_reported_properties_without_bulk() -> None:
    whole = Whole((Part(0.5, 2.0),), {Colour.RED: Level.HIGH}, Path("a/b"), np.array([1 + 2j]))
    assert plain(whole) == {
        "parts": [{"settling_s": 0.5, "effort": 2.0, "ok": True}],
        "colours": {"red": 3},
        "path": "a/b",
        "spectrum": {"real": [1.0], "imaginary": [2.0]},
    }


def test_a_number_that_json_lacks_is_null_or_text() -> None:
    assert plain([math.nan, math.inf, 1.0]) == [None, None, 1.0]
    assert repr(plain((np.int64(1), np.float32(0.5), np.bool_(True)))) == "[1, 0.5, True]"
    assert plain({"a": -math.inf}, str) == {"a": "-inf"}


@pytest.mark.parametrize(
    "value", [object(), {None: "a"}, b"a", {1}, Part], ids=["object", "key", "bytes", "set", "class"]
)
def test_a_type_without_json_is_refused(value: object) -> None:
    with pytest.raises(TypeError):
        plain(value)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner),
        max_leaves=20,
    )
)
def test_plain_values_are_json_and_plain_again(value: object) -> None:
    once = plain(value)
    assert plain(once) == once
    assert json.loads(json.dumps(once, allow_nan=False)) == once


def test_refused_checks_raise_with_each_remedy_once() -> None:
    checks = [
        Check("a", Outcome.OK, "fine"),
        Check("b", Outcome.REFUSED, "too fast", remedy="go slower"),
        Check("c", Outcome.REFUSED, "too far", remedy="go slower"),
        Check("d", Outcome.WARNING, "warm", remedy="wait"),
    ]
    assert [check.name for check in refused(checks)] == ["b", "c"]
    with pytest.raises(PlanError) as caught:
        refuse(checks)
    assert caught.value.message == "b: too fast; c: too far"
    assert caught.value.remedy == "go slower"
    refuse(checks[:1])
