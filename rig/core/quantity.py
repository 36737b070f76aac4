"""Unit, meaning and range of a dataclass field, declared once in the field's annotation.

Descriptions (`rig.core.model`, `rig.config`) are frozen dataclasses whose fields are ``Annotated[float, Gt(0),
Quantity("inertia", "…")]``. The validator, the error messages, the documentation and the metadata of recordings all
read these annotations.

This file must not validate a value; `rig.config` does.
"""

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, get_origin, get_type_hints

# Forbid unknown keys, infinities and silent conversions wherever such a dataclass is validated (see
# rig.config).
STRICT: dict[str, Any] = {"extra": "forbid", "allow_inf_nan": False, "strict": True}


@dataclass(frozen=True, slots=True)
class Quantity:
    """Unit and meaning of a dataclass field.

    Instead of a unit, `unit` may be a physical quantity such as "effort", whose unit (N·m or N) depends on the rig
    (`rig.core.sample.unit_of`).
    """

    unit: str
    meaning: str


@cache
def quantities(described: type) -> dict[str, Quantity]:
    """Return unit and meaning (`Quantity`) of each annotated field of a dataclass, by field name, in order."""
    return {
        name: mark
        for name, hint in get_type_hints(described, include_extras=True).items()
        if get_origin(hint) is Annotated
        for mark in hint.__metadata__
        if isinstance(mark, Quantity)
    }
