"""Definition of a force law: a compiled function of type `rig.realtime.plugs.LAW_SIGNATURE`, and its design."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.present import Item
from rig.core.shown import Shown


@dataclass(frozen=True, slots=True, repr=False)
class Law(Shown):
    """A force law: its compiled function, the size of its memory, and its design.

    `design(wall)` receives the wall's settings by name (stiffness, damping, pull, …), with ``tick_s``, the time of one
    tick, among them, and returns the parameters. `floats` counts the whole memory, whose first number is the mark
    `rig.realtime.plugs.LAW_CLAMPED`. `device` are the parameters that tell a device what this law does beside rendering
    the wall; empty if it does nothing, or if a device cannot run it.
    """

    name: str
    summary: str
    function: Any
    floats: int
    design: Callable[[Mapping[str, Any]], list[float]]
    device: Mapping[str, int] = field(default_factory=dict)

    def brief(self) -> list[Item]:
        """Return name and summary, for people."""
        return [f"law {self.name}: {self.summary}"]

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

    def fits(self) -> bool:
        """Return True if stored memory has the size that the compiled code requires."""
        return self.parameters.ndim == 1 and self.state.shape == (max(1, self.law.floats),)
