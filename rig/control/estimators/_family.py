"""Names of all velocity estimators; the module of an estimator is imported when `get` first needs it."""

from importlib import import_module
from typing import cast

from rig.control.estimators.estimator import Estimator
from rig.core import plugins
from rig.core.errors import ConfigError

BUILT_IN = {
    "fdm": "rig.control.estimators._fdm",
    "fdm-butterworth": "rig.control.estimators._fdm_butterworth",
    "fdm-butterworth-fixed": "rig.control.estimators._fdm_butterworth_fixed",
    "period": "rig.control.estimators._period",
    "period-frequency": "rig.control.estimators._period_frequency",
    "foaw-end": "rig.control.estimators._foaw_end",
    "foaw-best": "rig.control.estimators._foaw_best",
    "kalman": "rig.control.estimators._kalman",
    "levant": "rig.control.estimators._levant",
    "foaw-levant": "rig.control.estimators._hybrid",
    "optimal": "rig.control.estimators._optimal",
    "tracking": "rig.control.estimators._tracking",
    "disturbance": "rig.control.estimators._disturbance",
    "disturbance-two-mass": "rig.control.estimators._disturbance_two_mass",
}


def names() -> list[str]:
    """Return the names of all velocity estimators, built-in estimators first."""
    return [*BUILT_IN, *plugins.names("rig.estimators", BUILT_IN)]


def broken(name: str) -> str:
    """Return why the estimator with this name cannot be loaded (for example a broken plug-in); "" if it can."""
    try:
        get(name)
    except ConfigError as error:
        return str(error)
    return ""


def get(name: str) -> Estimator:
    """Return the estimator with this name; raise `ConfigError` if it is unknown or its plug-in is broken."""
    if name in BUILT_IN:
        return cast("Estimator", import_module(BUILT_IN[name]).ESTIMATOR)
    found = plugins.load("rig.estimators", "estimator", name, lambda part: isinstance(part, Estimator))
    if found is not None:
        return cast("Estimator", found)
    raise ConfigError(f"unknown estimator {name!r}", remedy=f"choose one of: {', '.join(names())}")
