"""The trigger of a scope: a sweep starts at a contact with the wall, or where a column crosses a level.

The scope of a page (`view`) searches new rows with it.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le, MaxLen
from numpy.typing import NDArray

from rig.core.quantity import STRICT
from rig.core.sample import RowFlag

Edge = Literal["rising", "falling"]
CONTACT = "contact"


@dataclass(frozen=True, slots=True)
class Trigger:
    """Condition that starts a sweep of a scope.

    Attributes
    ----------
    on
        ``contact``, the first sample inside the wall, or the name of a column.
    level, edge
        Threshold of the column (in its unit) and direction; for a contact, ``falling`` is the first sample outside.
    before
        Share of the window (0 to 1) before the trigger.
    single
        Stop after the first sweep.
    """

    on: Annotated[str, MaxLen(4096)] = CONTACT
    level: float = 0.0
    edge: Edge = "rising"
    before: Annotated[float, Ge(0), Le(1)] = 0.2
    single: bool = False

    __pydantic_config__ = STRICT

    def first(self, rows: NDArray[np.void]) -> int | None:
        """Return the index of the first row that crosses the level in the direction of `edge`; None if no row does."""
        inside = (rows["flags"] & int(RowFlag.INSIDE)) != 0
        above = inside if self.on == CONTACT else rows[self.on] > self.level
        crossed = above[1:] & ~above[:-1] if self.edge == "rising" else above[:-1] & ~above[1:]
        found = np.flatnonzero(crossed)
        return int(found[0]) + 1 if len(found) else None
