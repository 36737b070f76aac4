"""Decorator of all compiled functions (kernels) of this project; their machine code is cached (`rig.realtime._cache`).

Laws, estimators, devices, doctor, the loop and the recorder decorate their functions with it. Kernels allocate nothing
and raise nothing. This file must not depend on what a kernel computes.
"""

import contextlib
import functools
import gc
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, cast

import numba
from numba.core import event, sigutils, typeinfer
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import make_concrete_template
from numba.extending import register_jitable

from rig.realtime import compiling
from rig.realtime._cache import open_cache
from rig.realtime.groups import kind_of
from rig.realtime.handlers import interrupts_later
from rig.realtime.parts import KernelCache, PartCompiler

F = TypeVar("F", bound=Callable[..., Any])


CACHE_DIRECTORY = open_cache()
KernelCache.directory = CACHE_DIRECTORY


class _Compilations(event.Listener):  # type: ignore[misc]
    """Listener that reports to `rig.realtime.compiling` when numba compiles a function instead of loading it."""

    def on_start(self, event: Any) -> None:
        compiling.report_begin()

    def on_end(self, event: Any) -> None:
        compiling.report_end()


event.register("numba:compile", _Compilations())


@contextlib.contextmanager
def _without_collections() -> Iterator[None]:
    # A compiler makes millions of objects that live as long as the program: scanning them takes time and frees none.
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A Python function that numba compiles, or loads from the disk cache, when it is first needed.

    Only the declared signatures are compiled: an argument of another type is converted or rejected. Call `prepare`
    before a loop starts, because nothing may compile inside a loop. If another kernel calls this function, its code is
    linked into that kernel (`rig.realtime.parts`).
    """

    declared: tuple[Any, ...] = ()
    _compiler: Any

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None) -> None:
        super().__init__(py_func, locals or {}, targetoptions or {})
        pipeline = self._compiler.pipeline_class
        self._compiler = PartCompiler(py_func, self.targetdescr, self.targetoptions, self.locals, pipeline)
        self._parts: dict[Any, tuple[Any, Any]] = {}
        self._results_for_pointers: dict[int, tuple[Any, Any]] = {}

    def enable_caching(self) -> None:
        """Store the machine code of this compiled function on disk, in a directory named after its module."""
        self._cache = KernelCache(self.py_func)

    @property
    def prepared(self) -> bool:
        """Return True if this function is compiled for all its signatures, so that a call does not compile."""
        return not self._can_compile

    def prepare(self) -> None:
        """Compile this function for all declared signatures, or load it from the disk cache, unless already done."""
        with (
            interrupts_later(),
            global_compiler_lock,
            _without_collections(),
            typeinfer.register_dispatcher(self),
        ):
            if self._can_compile:
                with self._while_no_other_process_compiles():
                    for signature in self.declared:
                        self.compile(signature)
                self.disable_compile()

    def _while_no_other_process_compiles(self) -> contextlib.AbstractContextManager[None]:
        machine_code = self._cache
        return machine_code.alone() if isinstance(machine_code, KernelCache) else contextlib.nullcontext()

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        if self.prepared:
            return super()._compile_for_args(*args, **kws)
        self.prepare()
        return self  # numba calls it again, and finds machine code

    def typeof_pyval(self, val: Any) -> Any:
        """Return the numba type of an argument; numba calls this method at each call of the compiled function."""
        # The type of a group is cached: numba's own way would hash all member types at each call.
        kind = kind_of(val)
        return super().typeof_pyval(val) if kind is None else kind

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return numba's template for a call from another compiled function, into which this one is then linked."""
        if self.prepared or self.is_compiling:
            return super().get_call_template(args, kws)
        if not self._parts:
            with self._compiling_counter:
                parts = [self._compiler.part(signature) for signature in self.declared]
            self._parts = {tuple(signature.args): (signature, key) for signature, key in parts}
        python_signature, args = self._compiler.fold_argument_types(args, kws)
        signatures = [signature for signature, _ in self._parts.values()]
        name = self.py_func.__name__
        template = make_concrete_template(f"CallTemplate({name})", key=name, signatures=signatures)
        return template, python_signature, args, {}

    def get_overload(self, sig: Any) -> Any:
        """Return the key by which numba finds this function's code when another compiled function calls it."""
        args = tuple(sigutils.normalize_signature(sig)[0])
        return self._parts[args][1] if args in self._parts else super().get_overload(sig)

    def get_compile_result(self, sig: Any) -> Any:
        """Return numba's compile result (types, machine code) for a call of this function by a function pointer."""
        # numba asks at each call with a plug point and compares all types then. Each plug point has one signature
        # object, so its identity suffices; it is stored with the result, or another object could get its id.
        known = self._results_for_pointers.get(id(sig))
        if known is None:
            prepare(self)
            result = super().get_compile_result(sig)
            library = result.library
            library.get_pointer_to_function = functools.cache(library.get_pointer_to_function)
            known = self._results_for_pointers[id(sig)] = (sig, result)
        return known[1]

    def get_function_type(self) -> Any:
        """Return this function's numba function type, so that it can be an argument of another compiled function."""
        self.prepare()
        return super().get_function_type()


def prepare(*functions: Any) -> None:
    """Compile the kernels (numba functions) among `functions`, or load them from the disk cache; ignore all others."""
    for function in functions:
        if isinstance(function, Kernel) and not function.prepared:
            function.prepare()


def rule(function: F) -> F:
    """Return a function that Python runs as it is, and that numba compiles into the compiled functions that call it."""
    return cast("F", register_jitable(function))


def kernel(
    signature: Any, *, cache: bool = True, inline: bool = False, no_refcount: bool = False
) -> Callable[[F], F]:
    """Return a decorator that makes a function a kernel: compiled by numba, without the GIL, cached on disk.

    Parameters
    ----------
    signature
        numba signature, or a list of signatures: the only ones for which the function is compiled.
    cache
        Store the machine code on disk. Use False for laws outside this project, because the cache does not notice when
        their sources change.
    inline
        Always inline the function into its callers; for small helpers.
    no_refcount
        Do not count references to array arguments, which the caller keeps alive. Such a kernel cannot create or return
        an array, also not by `carray`. Always set for a kernel that takes a group (`rig.realtime.groups`).

    Notes
    -----
    A kernel allocates nothing and raises nothing; a value that is not finite is handled by `rig.control._guard`.
    Division by zero returns inf or NaN, as in numpy. With ``NUMBA_DISABLE_JIT=1`` the function is returned unchanged,
    for tests and coverage.
    """
    arguments = getattr(signature, "args", ())  # a signature as text contains no group
    takes_group = any(isinstance(argument, numba.types.BaseNamedTuple) for argument in arguments)
    options: dict[str, Any] = {
        "nopython": True,
        "boundscheck": None,
        "nogil": True,
        "error_model": "numpy",
        # Not fast: reordered sums would differ from C and from a replay in the last bit.
        "fastmath": False,
        # State each, even a default: numba would otherwise inherit the option of the kernel that first needs this one.
        # numba counts references atomically, some 20 ns a call but in simple control flow. A law that raises would
        # leave the counts of a group's members too high for ever.
        "_nrt": not (no_refcount or takes_group),
        "forceinline": inline,
        "no_cfunc_wrapper": takes_group,  # a plug point cannot take a group
    }

    def decorate(function: F) -> F:
        if numba.config.DISABLE_JIT:
            return function
        declared = Kernel(py_func=function, targetoptions=options)
        if cache:
            declared.enable_caching()
        declared.declared = tuple(signature) if isinstance(signature, list) else (signature,)
        return cast("F", declared)

    return decorate
