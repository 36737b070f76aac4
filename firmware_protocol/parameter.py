"""Definition of a parameter of the device."""

from __future__ import annotations

from dataclasses import dataclass

Value = int | float


@dataclass(frozen=True, slots=True)
class Parameter:
    """Definition of a parameter: number on the wire, name, C type, unit, range, default and meaning.

    `excluded` are values inside the range that are not allowed. A `live` parameter may change while the device is
    armed, in a block that contains only live parameters.
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
        """Return True if a value is in the range and not excluded; NaN is not accepted."""
        return self.minimum <= value <= self.maximum and value not in self.excluded
