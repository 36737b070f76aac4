"""When a scope starts a sweep: at a contact, or where a column crosses a level."""

from __future__ import annotations

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
    """What to wait for.

    Attributes
    ----------
    on
        ``contact``, the first sample inside the wall, or a column of the row.
    level, edge
        Of the column (its unit); of a contact, ``falling`` is the first sample outside again.
    before
        Share of the window that lies before it.
    single
        Stop after the first.
    """

    on: Annotated[str, MaxLen(4096)] = CONTACT
    level: float = 0.0
    edge: Edge = "rising"
    before: Annotated[float, Ge(0), Le(1)] = 0.2
    single: bool = False

    __pydantic_config__ = STRICT

    def first(self, rows: NDArray[np.void]) -> int | None:
        """Place of the first row at which it happens, the one before having been on the other side; None: nowhere."""
        inside = (rows["flags"] & int(RowFlag.INSIDE)) != 0
        above = inside if self.on == CONTACT else rows[self.on] > self.level
        crossed = above[1:] & ~above[:-1] if self.edge == "rising" else above[:-1] & ~above[1:]
        found = np.flatnonzero(crossed)
        return int(found[0]) + 1 if len(found) else None
