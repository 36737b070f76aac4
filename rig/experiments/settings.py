"""The keys of an experiment that people set by a name of their own, where a whole key would be too much to write.

Each name is that of its key in an experiment file, in SI units of the rig (`rig.core.sample.unit_of`): stiffness in
N·m/rad or N/m, a time that ends in ``_s`` in seconds, a rate in Hz. Any other key is reached by ``changes``, which has
whole keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Literal, TypedDict, get_args, get_origin, get_type_hints

from rig.core.errors import ConfigError


class Settings(TypedDict, total=False):
    """What drives the handle, and how it is sampled."""

    side: Annotated[Literal[-1, 1], "wall.side"]
    pull: Annotated[Literal["clamp", "allow"], "wall.pull"]
    damping_on: Annotated[Literal["both", "entry"], "wall.damping_on"]
    position_rate: Annotated[int, "controller.position_rate"]
    velocity_rate: Annotated[int, "controller.velocity_rate"]
    parameters: Annotated[Mapping[str, float | str], "controller.parameters"]
    prediction: Annotated[Literal["hold", "extrapolate"], "controller.prediction"]
    loop: Annotated[Literal["host", "device"], "controller.loop"]
    friction_compensation: Annotated[float, "controller.friction_compensation"]
    effort: Annotated[float, "trial.effort"]
    start: Annotated[float, "trial.start"]
    duration_s: Annotated[float, "trial.duration_s"]
    release_s: Annotated[float, "trial.release_s"]
    minimum_rest_counts: Annotated[float, "trial.minimum_rest_counts"]
    seed: Annotated[int, "trial.seed"]
    operator: Literal["none", "relaxed", "normal", "firm"]
    changes: Mapping[str, Any]


class WallSettings(Settings, total=False):
    """And one wall."""

    stiffness: Annotated[float, "wall.stiffness"]
    damping: Annotated[float, "wall.damping"]


def changes_of(options: Mapping[str, Any], known: type) -> dict[str, Any]:
    """Changes by dotted key that the settings among some options mean, those of ``changes`` last.

    `known` is the TypedDict whose names may be said; `ConfigError` for another one, with the closest of them.
    """
    names = get_type_hints(known, include_extras=True)
    changes: dict[str, Any] = {}
    for name, value in options.items():
        if name not in names:
            close = get_close_matches(name, names, n=1)
            remedy = f"did you mean {close[0]}?" if close else f"choose one of: {', '.join(names)}"
            raise ConfigError(f"there is no setting {name!r}", remedy=remedy)
        if name == "operator":
            changes |= _pushed_by(str(value))
        elif get_origin(names[name]) is Annotated:
            changes[get_args(names[name])[1]] = value
    return changes | dict(options.get("changes", {}))


def _pushed_by(operator: str) -> dict[str, Any]:
    """Who pushes: a hand of that grip, or the motor alone; the rules of an experiment refuse an unknown grip."""
    if operator == "none":
        return {"trial.kind": "constant-effort"}
    return {"trial.kind": "human", "operator.grip": operator}
