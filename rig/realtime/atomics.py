"""Atomic loads and stores of 64-bit words by memory address, for memory that threads or processes share.

The loop, the recorder, the ring, the mailbox, stop requests and USB transfers use these functions. A shared word must
not be read or written in any other way.
"""

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
    """Return the int64 at `address` (acquire): writes that precede the `store_word` of this value are then visible."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # A plain load may be hoisted out of a loop by the compiler: a loop on a stop word would never end.
        return builder.load_atomic(_pointer(builder, args[0]), ordering="acquire", align=8)

    return types.int64(types.uintp), codegen


@intrinsic
def store_word(typingctx: Any, address: Any, value: Any) -> Any:
    """Store `value` at `address` (release): after `load_word`, another thread sees this thread's earlier writes."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # x86 orders plain stores, ARM does not: a reader there could see HEAD before the row.
        builder.store_atomic(args[1], _pointer(builder, args[0]), ordering="release", align=8)
        return context.get_dummy_value()

    return types.void(types.uintp, types.int64), codegen


@intrinsic
def exchange_word(typingctx: Any, address: Any, value: Any) -> Any:
    """Store `value` in the int64 at `address` and return the word's previous value, in one atomic step."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.atomic_rmw("xchg", _pointer(builder, args[0]), args[1], "acq_rel")

    return types.int64(types.uintp, types.int64), codegen


@intrinsic
def compare_exchange_word(typingctx: Any, address: Any, expected: Any, value: Any) -> Any:
    """Replace the int64 at `address` by `value` if it equals `expected`, atomically; return 1 if replaced, else 0."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pair = builder.cmpxchg(_pointer(builder, args[0]), args[1], args[2], "acq_rel", "acquire")
        return builder.zext(builder.extract_value(pair, 1), _WORD)

    return types.int64(types.uintp, types.int64, types.int64), codegen


@intrinsic
def add_word(typingctx: Any, address: Any, value: Any) -> Any:
    """Add `value` to the int64 at `address` and return the word's previous value; no concurrent addition is lost."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.atomic_rmw("add", _pointer(builder, args[0]), args[1], "acq_rel")

    return types.int64(types.uintp, types.int64), codegen


def static_words(name: str, count: int) -> Any:
    """Return a numba function that returns the address of `count` static int64, zero at first, with symbol `name`."""
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
    """Return a numba function that returns the address of `count` int64 on the stack, for example for a timespec."""

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
    """Return the int64 at `address`, loaded atomically with acquire order; Python code can call this function."""
    return int(load_word(address))


@kernel(types.void(types.uintp, types.int64))
def write_word(address: int, value: int) -> None:
    """Store `value` in the int64 at `address`, atomically with release order; Python code can call this function."""
    store_word(address, value)
