"""Groups of arguments: a kernel takes a port, a controller and buffers, not the thirty functions and arrays in them.

Of thirty arguments side by side, two of one type are swapped and nobody notices. So what belongs together is a
`NamedTuple` with the mark `group`. Each is a type of its own to numba, so that two in each other's place are a typing
error, and it is made by keyword alone. A field is annotated with the numba type of its values; a plug point
(`rig.realtime.plugs`) may hold whatever fits it. A call costs what it would cost with the members one by one.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

import numpy as np
from numba import types
from numba.extending import typeof_impl
from numpy.typing import NDArray

T = TypeVar("T", bound=tuple[Any, ...])

Floats = Annotated[NDArray[np.float64], types.float64[::1]]
Ints = Annotated[NDArray[np.int64], types.int64[::1]]
Bytes = Annotated[NDArray[np.uint8], types.uint8[::1]]
FloatRows = Annotated[NDArray[np.float64], types.float64[:, ::1]]
IntRows = Annotated[NDArray[np.int64], types.int64[:, ::1]]
Int = Annotated[int, types.int64]
Float = Annotated[float, types.float64]
Address = Annotated[int, types.uintp]


def group(cls: type[T]) -> type[T]:
    """Let kernels take a `NamedTuple`, and let it be made by keyword alone."""
    make: Any = cls.__new__

    def by_keyword(cls: type[T], /, **members: Any) -> Any:
        return make(cls, **members)

    cls.__new__ = by_keyword  # type: ignore[assignment]
    typeof_impl.register(cls)(_typeof)
    return cls


@cache
def type_of(cls: type[tuple[Any, ...]]) -> Any:
    """Return the numba type of a group, for the signature of a kernel."""
    hints = get_type_hints(cls, include_extras=True).values()
    return types.BaseTuple.from_types([hint.__metadata__[0] for hint in hints], cls)


def _typeof(value: tuple[Any, ...], context: Any) -> Any:
    """Type of an instance: what does not fit its field makes it another type, which no kernel takes."""
    cls = type(value)
    members = zip(value, type_of(cls), strict=True)
    return types.BaseTuple.from_types([_member(member, due, context) for member, due in members], cls)


def _member(member: Any, due: Any, context: Any) -> Any:
    number = isinstance(due, types.Integer) and type(member) is int
    if number or isinstance(
        due, types.FunctionType
    ):  # numba checks range and signature when it takes them apart
        return due
    return typeof_impl(member, context)
