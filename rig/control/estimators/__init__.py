"""Velocity estimators: find one by name, read its settings, and run it over an array of counts.

Controllers, theory, comparisons and the documentation use it. It runs no loop and reads no recording. A user makes an
estimator from a plain function (`rig.control.estimators.plain_estimator`) and registers it in the entry-point group
``rig.estimators`` by a name and the ``module:attribute`` of an `Estimator`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.control.estimators._family import BUILT_IN, broken, get, names
from rig.control.estimators.estimator import (
    PERIOD,
    RESOLUTION,
    Choice,
    Estimator,
    Floats,
    Ints,
    Prepared,
    Setting,
)

if TYPE_CHECKING:
    from rig.control.estimators._own_counts import (
        COUNTS,
        age_of_last_change,
        real_numbers,
        unwrap,
        whole_numbers,
    )
    from rig.control.estimators.arrays import (
        checked_efforts,
        estimate,
        estimate_with_window,
        inputs,
        own_inputs,
        quantise,
        require_effort,
        run,
    )

__all__ = [
    "BUILT_IN",
    "COUNTS",
    "PERIOD",
    "RESOLUTION",
    "Choice",
    "Estimator",
    "Floats",
    "Ints",
    "Prepared",
    "Setting",
    "age_of_last_change",
    "broken",
    "checked_efforts",
    "estimate",
    "estimate_with_window",
    "get",
    "inputs",
    "names",
    "own_inputs",
    "quantise",
    "real_numbers",
    "require_effort",
    "run",
    "unwrap",
    "whole_numbers",
]

# Imported on first use: compiled code over arrays, and counts of other loggers.
_LATER = {
    "rig.control.estimators.arrays": (
        "checked_efforts",
        "estimate",
        "estimate_with_window",
        "inputs",
        "own_inputs",
        "quantise",
        "require_effort",
        "run",
    ),
    "rig.control.estimators._own_counts": (
        "COUNTS",
        "age_of_last_change",
        "real_numbers",
        "unwrap",
        "whole_numbers",
    ),
}


# Hidden from mypy, which would accept every name of a module that has one: a renamed function was imported in vain.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        for module, found in _LATER.items():
            if name in found:
                return getattr(import_module(module), name)
        raise AttributeError(f"module 'rig.control.estimators' has no attribute {name!r}")
