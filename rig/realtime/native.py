"""Call C functions by their address from compiled code, for libraries that are loaded while the program runs.

The USB queue of `rig.devices` and stop requests use it; functions of the C library are called by name
(`rig.realtime.system`). An address must not become a constant of compiled code: the cached code is used in other
processes, where the address is wrong.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def native_call(arity: int) -> Any:
    """Return a numba function ``call(address, arguments…)`` that calls the C function ``int f(…)`` at `address`.

    `arity` is the number of its arguments (1 to 3), each a 64-bit word. The address is not checked: it must be that of
    such a function. The call does not take the GIL.
    """
    word, answer = ir.IntType(64), ir.IntType(32)
    function = ir.FunctionType(answer, [word] * arity)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # From an argument: a library such as libusb is found after the code was compiled, at another address each time.
        target = builder.inttoptr(args[0], function.as_pointer())
        return builder.sext(builder.call(target, args[1:]), word)

    if arity == 1:

        @intrinsic
        def call_one(typingctx: Any, address: Any, first: Any) -> Any:
            return types.int64(types.uintp, types.uintp), codegen

        return call_one
    if arity == 2:

        @intrinsic
        def call_two(typingctx: Any, address: Any, first: Any, second: Any) -> Any:
            return types.int64(types.uintp, types.uintp, types.uintp), codegen

        return call_two
    if arity == 3:

        @intrinsic
        def call_three(typingctx: Any, address: Any, first: Any, second: Any, third: Any) -> Any:
            return types.int64(types.uintp, types.uintp, types.uintp, types.uintp), codegen

        return call_three
    raise ValueError(f"arity = {arity} is not supported: use 1, 2 or 3")


def address_of(kernel: Any, signature: Any) -> int:
    """Return the address of a compiled function as a C function for one signature; compile it if necessary."""
    found = kernel.get_compile_result(signature)
    return int(found.library.get_pointer_to_function(found.fndesc.llvm_cfunc_wrapper_name))
