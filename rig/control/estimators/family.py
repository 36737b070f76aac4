"""Every velocity estimator by name, each imported when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, cast

from rig.control.estimators.estimator import Estimator
from rig.core.errors import ConfigError

BUILT_IN = {
    "fdm": "rig.control.estimators.fdm",
    "fdm-butterworth": "rig.control.estimators.fdm_butterworth",
    "fdm-butterworth-fixed": "rig.control.estimators.fdm_butterworth_fixed",
    "period": "rig.control.estimators.period",
    "period-frequency": "rig.control.estimators.period_frequency",
    "foaw-end": "rig.control.estimators.foaw_end",
    "foaw-best": "rig.control.estimators.foaw_best",
    "kalman": "rig.control.estimators.kalman",
    "levant": "rig.control.estimators.levant",
    "foaw-levant": "rig.control.estimators.hybrid",
    "optimal": "rig.control.estimators.optimal",
}


def names() -> list[str]:
    """Names of all estimators, built-in ones first."""
    return [*BUILT_IN, *(name for name in _plugins(entry_points) if name not in BUILT_IN)]


@cache  # it looks through every installed package, which costs milliseconds, for each scheme and each check
def _plugins(find: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(sorted(point.name for point in find(group="rig.estimators")))


def get(name: str) -> Estimator:
    """Return the estimator of that name; `ConfigError` for an unknown one or a broken plug-in."""
    if name in BUILT_IN:
        return cast("Estimator", import_module(BUILT_IN[name]).ESTIMATOR)
    for point in entry_points(group="rig.estimators", name=name):
        try:
            return cast("Estimator", point.load())
        except Exception as error:
            raise ConfigError(
                f"estimator {name!r} ({point.value}) does not load: {error!r}",
                remedy="fix or remove that package",
            ) from error
    raise ConfigError(f"there is no estimator {name!r}", remedy=f"choose one of: {', '.join(names())}")
