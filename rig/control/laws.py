"""The family of force laws, by name, as `rig.control.estimators` is that of the estimators.

A third party adds one by the entry-point group ``rig.laws``: a name and the ``module:attribute`` of a
`rig.control.law.Law`; or passes a `Law` to a command's function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, cast

from rig.control.law import Law
from rig.core.errors import ConfigError

# Name → function that makes the law, imported with the compiled code of it.
BUILT_IN = {
    "spring-damper": "rig.control.wall:spring_damper_law",
    "bilateral": "rig.control.bilateral:bilateral_law",
    "excited": "rig.control.bilateral:excited_law",
}
# Laws whose numbers come from an experiment, by the names that recordings give them: with the recorded parameters
# they replay.
_OF_RECORDINGS = {
    "traced": "rig.control.motions:traced_law",
    "nudges": "rig.control.motions:nudged_law",
}
_COMPENSATED = "+friction"  # a wrapper around any of them: rig.control.friction


def names() -> list[str]:
    """Names of all laws, built-in ones first."""
    return [*BUILT_IN, *(name for name in _plugins(entry_points) if name not in BUILT_IN)]


@cache  # it looks through every installed package, which costs milliseconds
def _plugins(find: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(sorted(point.name for point in find(group="rig.laws")))


def get(name: str) -> Law:
    """Return the law of that name; `ConfigError` for an unknown one or a broken plug-in."""
    maker = (BUILT_IN | _OF_RECORDINGS).get(name)
    if maker is not None:
        return cast("Law", _made_by(maker)())
    if name.endswith(_COMPENSATED):
        return cast("Law", _made_by("rig.control.friction:around")(get(name.removesuffix(_COMPENSATED))))
    for point in entry_points(group="rig.laws", name=name):
        try:
            return cast("Law", point.load())
        except Exception as error:
            raise ConfigError(
                f"law {name!r} ({point.value}) does not load: {error!r}", remedy="fix or remove that package"
            ) from error
    raise ConfigError(f"there is no law {name!r}", remedy=f"choose one of: {', '.join(names())}")


def _made_by(maker: str) -> Callable[..., Any]:
    module, _, function = maker.partition(":")
    return cast("Callable[..., Any]", getattr(import_module(module), function))
