"""Find a force law by its name: built-in laws, laws of recordings, and laws of plug-ins.

Preparations of a run and replays use it; it renders nothing itself. A user writes a law as a plain function
(`rig.control.plain_law`) and passes it to a command's function, or registers it in the entry-point group ``rig.laws``
by a name and the ``module:attribute`` of a `Law`.
"""

from pkgutil import resolve_name
from typing import cast

from rig.control.law import Law, PreparedLaw
from rig.core import plugins
from rig.core.errors import ConfigError

__all__ = ["BUILT_IN", "Law", "PreparedLaw", "get", "names"]

# Name → function that makes the law, imported with the compiled code of it.
BUILT_IN = {
    "spring-damper": "rig.control._wall:spring_damper_law",
    "bilateral": "rig.control.bilateral:bilateral_law",
    "excited": "rig.control.bilateral:excited_law",
}
# Laws whose numbers come from an experiment, by the names that recordings give them: with the recorded parameters
# they replay.
_OF_RECORDINGS = {"traced": "rig.control.motions:traced_law", "nudges": "rig.control.motions:nudged_law"}
_COMPENSATED = {  # wrappers around any of them
    "+cogging": "rig.control.cogging:around",
    "+friction": "rig.control.friction:around",
}


def names() -> list[str]:
    """Return the names of all force laws, built-in laws first."""
    return [*BUILT_IN, *plugins.names("rig.laws", BUILT_IN)]


def get(name: str) -> Law:
    """Return the force law with this name; raise `ConfigError` if the name is unknown or its plug-in is broken."""
    maker = (BUILT_IN | _OF_RECORDINGS).get(name)
    if maker is not None:
        return cast("Law", resolve_name(maker)())
    for suffix, around in _COMPENSATED.items():
        if name.endswith(suffix):
            return cast("Law", resolve_name(around)(get(name.removesuffix(suffix))))
    found = plugins.load("rig.laws", "law", name, lambda part: isinstance(part, Law))
    if found is not None:
        return cast("Law", found)
    raise ConfigError(f"unknown law {name!r}", remedy=f"choose one of: {', '.join(names())}")
