"""Pass many values to a kernel as one argument: a group is a `NamedTuple` that numba accepts as a struct.

A group is a `NamedTuple` with the decorator `group`. Each field is annotated with the numba type of its values; a field
with a function type (`rig.realtime.plugs`) accepts any function with that signature. A call costs as much as with
single arguments.

Laws, ports and the loop define groups, and `rig.realtime.kernel` compiles them. This file must not depend on a
particular group or on the meaning of its members.
"""

from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.registry import cpu_target
from numba.experimental import function_type  # noqa: F401  (what a plug takes in memory)
from numba.extending import intrinsic, typeof_impl
from numba.np.numpy_support import as_dtype
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

_GROUPS: set[type] = set()


def group(cls: type[T]) -> type[T]:
    """Register a `NamedTuple` class as an argument type of compiled functions; its instances then need keywords."""
    # By keyword alone: among thirty positional arguments, two of one type are swapped unnoticed.
    make: Any = cls.__new__

    def by_keyword(cls: type[T], /, **members: Any) -> Any:
        return make(cls, **members)

    cls.__new__ = by_keyword  # type: ignore[assignment]
    _GROUPS.add(cls)
    typeof_impl.register(cls)(_typeof)
    return cls


@cache
def type_of(cls: type[tuple[Any, ...]]) -> Any:
    """Return the numba type of a group (`NamedTuple` argument of compiled functions), for a signature."""
    hints = get_type_hints(cls, include_extras=True).values()
    return types.BaseTuple.from_types([hint.__metadata__[0] for hint in hints], cls)


class _ArrayKind(NamedTuple):
    dtype: Any
    dimensions: int
    writable: bool


@cache
def _expected_members(cls: type[tuple[Any, ...]]) -> tuple[tuple[tuple[type, ...], _ArrayKind | None], ...]:
    """Return for each field of a `NamedTuple` argument its Python classes, and what it must be if it is an array."""
    return tuple(
        (
            _classes(t),
            _ArrayKind(as_dtype(t.dtype), t.ndim, t.mutable) if isinstance(t, types.Array) else None,
        )
        for t in type_of(cls).types
    )


def _classes(numba_type: Any) -> tuple[type, ...]:
    if isinstance(numba_type, types.FunctionType):
        return ()
    if isinstance(numba_type, types.BaseNamedTuple):
        return (numba_type.instance_class,)
    return (int, float, np.integer) if isinstance(numba_type, types.Float) else (int, np.integer)


def kind_of(value: Any) -> Any:
    """Return the numba type of a group (`NamedTuple` of compiled functions); None if a member has a wrong type."""
    return _type_if_fitting(value) if type(value) in _GROUPS else None


def _type_if_fitting(value: tuple[Any, ...]) -> Any:
    cls = type(value)
    for member, (classes, array) in zip(value, _expected_members(cls), strict=True):
        if not _fits(member, classes, array):
            return None
    return type_of(cls)


def _typeof(value: tuple[Any, ...], context: Any) -> Any:
    """Return the numba type of a group; with a member of a wrong type, a type that every compiled function rejects."""
    kind = _type_if_fitting(value)
    if kind is None:
        kind = types.BaseTuple.from_types([typeof_impl(member, context) for member in value], type(value))
    return kind


def _fits(member: Any, classes: tuple[type, ...], array: _ArrayKind | None) -> bool:
    """Return True if a member of a `NamedTuple` argument has one of the `classes`, or is an array like `array`."""
    # Not by numba's typeof: finding the type of a record array takes as long as many ticks.
    if array is not None:
        if type(member) is not np.ndarray or member.dtype != array.dtype or member.ndim != array.dimensions:
            return False
        flags = member.flags
        return flags.carray or (not array.writable and flags.c_contiguous and flags.aligned)
    # numba checks the signature of a function, and the range of a number, when it unpacks the group.
    if not classes:
        return True
    if isinstance(member, tuple):
        return type(member) is classes[0] and _type_if_fitting(member) is not None
    # A bool is an int to Python and another type to numba.
    return isinstance(member, classes) and type(member) is not bool


@cache
def group_bytes(cls: type[tuple[Any, ...]]) -> int:
    """Return the number of bytes that a group (`NamedTuple` argument of compiled functions) needs in memory."""
    context = cpu_target.target_context
    return int(context.get_abi_sizeof(context.get_value_type(type_of(cls))))


def group_at(cls: type[tuple[Any, ...]]) -> tuple[Any, Any]:
    """Return two numba functions, ``put(address, group)`` and ``get(address)``, for a `NamedTuple` in memory.

    They pass a group of arguments by its address, where the memory must have `group_bytes` bytes. The caller of `put`
    must keep the group alive: references to its arrays are not counted.
    """
    kind = type_of(cls)

    def place(context: Any, builder: Any, address: Any) -> Any:
        return builder.inttoptr(address, ir.PointerType(context.get_value_type(kind)))

    def store(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[1], place(context, builder, args[0]), align=8)
        return context.get_dummy_value()

    def load(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(place(context, builder, args[0]), align=8)

    @intrinsic
    def put(typingctx: Any, address: Any, group: Any) -> Any:
        return types.none(types.uintp, kind), store

    @intrinsic
    def get(typingctx: Any, address: Any) -> Any:
        return kind(types.uintp), load

    return put, get
