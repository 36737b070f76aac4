"""Definition of a force law: a compiled function that is called in each tick, and the computation of its parameters."""

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
    """A force law: its compiled function, the size of the memory that it keeps between calls, and its parameters.

    `design(wall)` receives the wall's settings by name (stiffness, damping, pull, …) and ``tick_s``, the time of one
    tick (s), and returns the parameters. `floats` is the number of float64 in the memory; the first is
    `rig.realtime.plugs.LAW_CLAMPED`, non-zero if the reaction was clamped. `device` has the device parameters for what
    the law does besides the wall; it is empty if the law does nothing else or if a device cannot run it.
    """

    name: str
    summary: str
    function: Any
    floats: int
    design: Callable[[Mapping[str, Any]], list[float]]
    device: Mapping[str, int] = field(default_factory=dict)

    def brief(self) -> list[Item]:
        """Return one line with name and summary of the law, for display."""
        return [f"law {self.name}: {self.summary}"]

    def prepare(self, wall: Mapping[str, Any]) -> PreparedLaw:
        """Return the law ready to run: parameters computed for `wall` (settings by name), memory set to zero."""
        parameters = np.array(self.design(wall), dtype=np.float64)
        return PreparedLaw(self, parameters, np.zeros(max(1, self.floats)))


@dataclass(frozen=True, slots=True)
class PreparedLaw:
    """A law ready to run, with its parameters and its memory, which changes."""

    law: Law
    parameters: NDArray[np.float64]
    state: NDArray[np.float64]

    def fits(self) -> bool:
        """Return True if the law's parameters and memory have the sizes that the compiled code requires."""
        return self.parameters.ndim == 1 and self.state.shape == (max(1, self.law.floats),)
