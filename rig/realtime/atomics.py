"""Atomic 64-bit words by address: how the two sides of a ring or a stop flag publish to each other.

The loop, the recorder, the ring, the mailbox, stop requests and USB transfers call it. A word that two sides share must
not be read or written in any other way.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from rig.realtime.kernel import kernel

_WORD = ir.IntType(64)


def _pointer(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, _WORD.as_pointer())


@intrinsic
def load_word(typingctx: Any, address: Any) -> Any:
    """Load an int64 with acquire order: what the other side wrote before its store is visible afterwards."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # A plain load may be hoisted out of a loop by the compiler: a loop on a stop word would never end.
        return builder.load_atomic(_pointer(builder, args[0]), ordering="acquire", align=8)

    return types.int64(types.uintp), codegen


@intrinsic
def store_word(typingctx: Any, address: Any, value: Any) -> Any:
    """Store an int64 with release order: a thread that loads it (`load_word`) sees everything written before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # x86 orders plain stores, ARM does not: a reader there could see HEAD before the row.
        builder.store_atomic(args[1], _pointer(builder, args[0]), ordering="release", align=8)
        return context.get_dummy_value()

    return types.void(types.uintp, types.int64), codegen


@intrinsic
def exchange_word(typingctx: Any, address: Any, value: Any) -> Any:
    """Swap an int64 and return the old one, ordered both ways."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.atomic_rmw("xchg", _pointer(builder, args[0]), args[1], "acq_rel")

    return types.int64(types.uintp, types.int64), codegen


@intrinsic
def compare_exchange_word(typingctx: Any, address: Any, expected: Any, value: Any) -> Any:
    """Store an int64 if the word still is `expected`, ordered both ways: 1 when it was stored, else 0."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pair = builder.cmpxchg(_pointer(builder, args[0]), args[1], args[2], "acq_rel", "acquire")
        return builder.zext(builder.extract_value(pair, 1), _WORD)

    return types.int64(types.uintp, types.int64, types.int64), codegen


@intrinsic
def add_word(typingctx: Any, address: Any, value: Any) -> Any:
    """Add to an int64 and return the old one, ordered both ways: no concurrent addition is lost."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.atomic_rmw("add", _pointer(builder, args[0]), args[1], "acq_rel")

    return types.int64(types.uintp, types.int64), codegen


def static_words(name: str, count: int) -> Any:
    """Make an intrinsic for the address of `count` zeroed int64 that live as long as the kernel that uses it."""
    kind = ir.ArrayType(_WORD, count)

    @intrinsic
    def words(typingctx: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            memory = builder.module.globals.get(name)
            if memory is None:
                memory = ir.GlobalVariable(builder.module, kind, name)
                memory.linkage, memory.align, memory.initializer = "internal", 64, ir.Constant(kind, None)
            return builder.ptrtoint(memory, _WORD)

        return types.uintp(), codegen

    return words


def stack_words(count: int) -> Any:
    """Make an intrinsic for the address of `count` int64 on the stack: a timespec without an allocation."""

    @intrinsic
    def words(typingctx: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            # In the entry block: an alloca in a loop would take new stack in each pass.
            with builder.goto_entry_block():
                memory = builder.alloca(ir.ArrayType(_WORD, count))
            return builder.ptrtoint(memory, _WORD)

        return types.uintp(), codegen

    return words


@kernel(types.int64(types.uintp))
def read_word(address: int) -> int:
    """Load a word atomically, for Python (`load_word`)."""
    return int(load_word(address))


@kernel(types.void(types.uintp, types.int64))
def write_word(address: int, value: int) -> None:
    """Store a word atomically, for Python (`store_word`)."""
    store_word(address, value)
