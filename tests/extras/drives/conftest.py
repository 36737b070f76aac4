"""Fixtures of the tests of drives: the compiled bridge, and variants of the test rig."""

from dataclasses import replace
from typing import Any

import pytest

from rig.core.model import RigModel
from tests.conformance.bridged import bridged_rig
from tests.conformance.firmware import need_compiler


@pytest.fixture(scope="session", autouse=True)
def _compiler() -> None:
    need_compiler()


def other(**parts: Any) -> RigModel:
    """Return the rig of the tests with changed parts: ``encoder`` and ``amplifier`` by their keys, or whole."""
    model = bridged_rig()
    for name, changed in parts.items():
        part = replace(getattr(model, name), **changed) if isinstance(changed, dict) else changed
        model = replace(model, **{name: part})
    return model
