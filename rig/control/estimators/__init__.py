"""The family of velocity estimators, by name.

A third party makes one of a plain function (`rig.control.estimators.plain_estimator`), and adds it by the entry-point
group ``rig.estimators``: a name and the ``module:attribute`` of an
`rig.control.estimators.estimator.Estimator`. `estimate` runs any of them over an array of counts, `quantise` makes
counts.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.control.estimators.family import BUILT_IN, broken, get, names

if TYPE_CHECKING:
    from rig.control.estimators.arrays import estimate, estimate_with_window, quantise

__all__ = ["BUILT_IN", "broken", "estimate", "estimate_with_window", "get", "names", "quantise"]

_ON_ARRAYS = ("estimate", "estimate_with_window", "quantise")  # of `arrays`, imported on first use


def __getattr__(name: str) -> Any:
    if name in _ON_ARRAYS:
        return getattr(import_module("rig.control.estimators.arrays"), name)
    raise AttributeError(f"module 'rig.control.estimators' has no attribute {name!r}")
