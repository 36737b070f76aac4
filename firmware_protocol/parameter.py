"""Definition of a parameter of the device."""

from __future__ import annotations

from dataclasses import dataclass

Value = int | float


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its number on the wire, its name everywhere else, type, unit, range and meaning.

    `excluded` are values inside the range that are not allowed. `live` ones may change while the device is armed, in a
    block of their own.
    """

    id: int
    name: str
    ctype: str
    unit: str
    minimum: Value
    maximum: Value
    default: Value
    meaning: str
    excluded: tuple[Value, ...] = ()
    live: bool = False

    def accepts(self, value: Value) -> bool:
        """Return True if a value is in range; NaN is not."""
        return self.minimum <= value <= self.maximum and value not in self.excluded
