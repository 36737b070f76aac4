"""Definition of a parameter of the device: its number in messages, name, C type, unit and range.

The lists in `parameters` and `law_parameters` consist of it. It must not depend on a particular parameter.
"""

from dataclasses import dataclass

Value = int | float


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of the device: id in messages, name, C type, unit, range, default and meaning.

    `excluded` are values inside the range that the device rejects. A `live` parameter may change while the device is
    armed, in a parameter block that contains only live parameters.
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
        """Return True if `value` is in the parameter's range and not excluded; return False for NaN."""
        return self.minimum <= value <= self.maximum and value not in self.excluded
