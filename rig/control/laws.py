"""The family of force laws, by name, as `rig.control.estimators` is that of the estimators.

A law is a compiled function with the signature `rig.realtime.plugs.LAW_SIGNATURE` and a design that turns the
``[wall]`` section into its parameter vector. A third party adds one by the entry-point group ``rig.laws``,
or passes a `Law` to a command's function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.core.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Law:
    """A force law: its compiled function, the size of its memory, and its design.

    `design(wall)` receives the wall's settings by name (stiffness, damping, pull, …) and returns the
    parameters. `floats` counts the whole memory, whose first number is the mark `rig.realtime.plugs.LAW_CLAMPED`.
    `device` are the parameters that tell a device what this law does beside rendering the wall; empty if it does
    nothing, or if a device cannot run it.
    """

    name: str
    summary: str
    function: Any
    floats: int
    design: Callable[[Mapping[str, Any]], list[float]]
    device: Mapping[str, int] = field(default_factory=dict)

    def prepare(self, wall: Mapping[str, Any]) -> PreparedLaw:
        """Design the parameters and allocate a memory of zeros."""
        parameters = np.array(self.design(wall), dtype=np.float64)
        return PreparedLaw(self, parameters, np.zeros(max(1, self.floats)))


@dataclass(frozen=True, slots=True)
class PreparedLaw:
    """A law ready to run: its parameter vector and its (mutable) memory."""

    law: Law
    parameters: NDArray[np.float64]
    state: NDArray[np.float64]


def _spring_damper() -> Law:
    from rig.control import wall  # noqa: PLC0415  (numba only when a law is built)

    def design(section: Mapping[str, Any]) -> list[float]:
        may_pull = 1.0 if section["pull"] == "allow" else 0.0
        entry_only = 1.0 if section["damping_on"] == "entry" else 0.0
        return [section["stiffness"], section["damping"], may_pull, entry_only]

    return Law("spring-damper", "unilateral spring and damper", wall.spring_damper, wall.STATE, design)


def _bilateral() -> Law:
    from rig.control import bilateral  # noqa: PLC0415

    return Law("bilateral", "spring and damper on both sides", bilateral.bilateral, 1, bilateral.design)


def shaken(efforts: ArrayLike = (0.0,), ramp_ticks: int = 0, device: Mapping[str, int] | None = None) -> Law:
    """Return the bilateral wall with an excitation that the rig's own motor plays.

    Parameters
    ----------
    efforts
        One period at the loop's rate, positive along the position (N·m or N), at least one sample.
    ramp_ticks
        Ticks in which the excitation rises.
    device
        Parameters from which a device makes the same table (`rig.control.excitation_table`).
    """
    from rig.control import bilateral  # noqa: PLC0415

    table = np.atleast_1d(np.asarray(efforts, dtype=np.float64))

    def design(section: Mapping[str, Any]) -> list[float]:
        return bilateral.design_shaken(section, table, ramp_ticks)

    summary = "bilateral, and shaken by the rig's own motor"
    return Law("shaken", summary, bilateral.shaken, bilateral.SHAKEN_STATE, design, dict(device or {}))


BUILT_IN: dict[str, Callable[[], Law]] = {
    "spring-damper": _spring_damper,
    "bilateral": _bilateral,
    "shaken": shaken,
}


_MOTIONS = {
    "traced": "traced_law",
    "nudges": "nudged_law",
}  # name → function of rig.control.motions, which stands above this file
_COMPENSATED = "+friction"  # rig.control.friction.SUFFIX


def names() -> list[str]:
    """Names of all laws, built-in ones first."""
    return [*BUILT_IN, *(name for name in _plugins(entry_points) if name not in BUILT_IN)]


@cache  # it looks through every installed package, which costs milliseconds
def _plugins(find: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(sorted(point.name for point in find(group="rig.laws")))


def get(name: str) -> Law:
    """Return the law of that name; `ConfigError` for an unknown one or a broken plug-in.

    Laws whose numbers come from an experiment (motions, a wrapper with friction compensation) are found by the names
    that recordings give them: with the recorded parameters they replay.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]()
    if name in _MOTIONS:
        return cast("Law", getattr(import_module("rig.control.motions"), _MOTIONS[name])())
    if name.endswith(_COMPENSATED):
        return cast("Law", import_module("rig.control.friction").around(get(name.removesuffix(_COMPENSATED))))
    for point in entry_points(group="rig.laws", name=name):
        try:
            return cast("Law", point.load())
        except Exception as error:
            raise ConfigError(
                f"law {name!r} ({point.value}) does not load: {error!r}", remedy="mend or remove that package"
            ) from error
    raise ConfigError(f"there is no law {name!r}", remedy=f"choose one of: {', '.join(names())}")
