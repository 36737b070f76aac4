"""Link a kernel into the kernels that call it: optimise and generate machine code only once, for the outermost caller.

This file extends numba's code libraries and disk cache; `rig.realtime.kernel` decides which kernels are linked.
`rig.realtime.kernel`, `rig.control.plain_functions` and `rig.testing` use it. It must not change what a kernel
computes.
"""

import contextlib
import hashlib
import time
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from llvmlite import binding
from numba.core import caching, codegen, compiler, dispatcher, sigutils
from numba.core.compiler_lock import require_global_compiler_lock
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python as runtime
from numba.core.runtime import rtsys

from rig.core.locks import lock
from rig.realtime import compiling
from rig.realtime.handlers import interrupts_now

PATIENCE_S = 60.0  # how long to wait for another process: longer than it compiles the largest kernel
POLL_S = 0.01  # interval at which the lock of the other process is tried again


class _Linked:
    """Base of numba code libraries that are linked with the libraries of all called kernels (compiled functions)."""

    _linking_libraries: list[Any]

    def parts(self) -> Iterator[Any]:
        """Yield the code libraries of all compiled functions that this one calls, also indirectly; callers first."""
        seen: set[int] = set()
        waiting = list(reversed(self._linking_libraries))
        while waiting:
            library = waiting.pop()
            if id(library) in seen:
                continue
            seen.add(id(library))
            yield library
            if isinstance(library, LinkedPart):
                waiting += reversed(library._linking_libraries)


# numba makes machine code of every function that another one calls, and optimises copies of it again with each caller.
# Of 135 kernels that a hit reaches, 15 are entered from outside: optimised there alone, the first hit with an empty
# cache takes 14 to 15 s of processor time instead of 23 to 24 s (numba 0.68.1, koul-compliant, 2026-11-29).
class LinkedPart(_Linked, codegen.JITCodeLibrary):  # type: ignore[misc]
    """Unoptimised LLVM code of a kernel (compiled function) that is linked into the `Whole` of its caller."""

    environment: Any = None  # numba knows it by its name alone
    _shared_module: Any

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Mark this code library as complete, without generating machine code."""
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            for function in self._final_module.functions:
                if not function.is_declaration and function.linkage == binding.Linkage.external:
                    function.linkage = "linkonce_odr"
            self._shared_module = self._final_module
        return self._shared_module


class Whole(_Linked, codegen.JITCodeLibrary):  # type: ignore[misc]
    """Machine code of a kernel (compiled function) together with all kernels that it calls."""

    def finalize(self) -> None:
        """Link the code of all called functions into this library, optimise it, and generate machine code."""
        require_global_compiler_lock()
        self._linking_libraries = list(self.parts())
        super().finalize()


class _SharedFlags(compiler.Flags):  # type: ignore[misc]
    """Compiler flags of numba's own functions (`min`, …), as one object for all kernels, so that each compiles once."""

    # numba compiles `min` once for each set of flags of a caller, and looks it up by comparing them for each operator.

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other


class _KernelFlags(compiler.Flags):  # type: ignore[misc]
    """Compiler flags of one kernel (compiled function); numba's own functions in it get `_SharedFlags` instead."""

    def copy(self) -> _SharedFlags:
        """Return the compiler flags for numba's own functions that the kernel calls."""
        return _shared_flags(self.nrt)


@cache
def _shared_flags(nrt: bool) -> _SharedFlags:
    flags = _SharedFlags()
    cpu_target.options.parse_as_flags(flags, {"nopython": True, "nogil": True, "error_model": "numpy"})
    flags.nrt = nrt
    return flags


@cache
def load_implementations() -> None:
    """Load the modules that numba's compiler needs, but not scipy.linalg, whose import takes the longest."""
    # numba imports a BLAS there for ``numpy.cov``, which takes longer than all the rest.
    linalg = import_module("numba.np.linalg")
    load_blas = linalg.ensure_blas
    linalg.ensure_blas = lambda: None  # type: ignore[attr-defined]
    try:
        cpu_target.target_context.refresh()
    finally:
        linalg.ensure_blas = load_blas  # type: ignore[attr-defined]


class PartCompiler(dispatcher._FunctionCompiler):  # type: ignore[misc,name-defined]
    """Compiler of one numba function, to machine code (`Whole`) or to code for linking into callers (`LinkedPart`)."""

    def part(self, signature: Any) -> tuple[Any, Any]:
        """Compile the function for linking into a caller; return its signature and the key by which numba finds it."""
        args, return_type = sigutils.normalize_signature(signature)
        result = self._compile_as(args, return_type, LinkedPart)
        result.library.environment = result.environment
        key = (result.fndesc.unique_name, result.signature)
        self.targetdescr.target_context.insert_user_function(key, result.fndesc, [result.library])
        return result.signature, key

    def _compile_core(self, args: Any, return_type: Any) -> Any:
        result = self._compile_as(args, return_type, Whole)
        for environment in result._find_referenced_environments():  # of parts too: their exceptions need it
            result.library.codegen.set_env(environment.env_name, environment)
        return result

    def _compile_as(self, args: Any, return_type: Any, kind: type[LinkedPart | Whole]) -> Any:
        load_implementations()
        target = self.targetdescr
        flags = _KernelFlags()
        target.options.parse_as_flags(flags, self.targetoptions)
        if kind is LinkedPart:
            flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        library = kind(target.target_context.codegen(), self.py_func.__qualname__)
        library.enable_object_caching()
        result = compiler.compile_extra(
            target.typing_context,
            target.target_context,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=library,
            pipeline_class=self.pipeline_class,
        )
        compiling.count_kernel()
        interrupts_now()
        return result


_NumbaCache: Any = caching.FunctionCache._impl_class
_ConfiguredLocator: Any = _NumbaCache._locator_classes[0]  # in a directory that is configured


class _ByModule(_ConfiguredLocator):  # type: ignore[misc]
    """Locator of a compiled function's machine code: a directory in the cache, named after the function's module.

    The cache's own directory is named by a hash of all sources, so a wheel and a clone with equal sources share a
    cache.
    """

    # Not numba's setting CACHE_DIR: a .numba_config.yaml in the current directory can change it, and a cache is code.
    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(KernelCache.directory / py_func.__module__)

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        return super(_ConfiguredLocator, cls).from_function(py_func, py_file)  # whatever CACHE_DIR is

    def get_source_stamp(self) -> bytes:
        """Return the SHA-256 hash of the function's source file; numba compiles the function again if it changes."""
        # numba before 0.68 takes the file's time, by which every fresh checkout would be compiled again.
        return hashlib.sha256(Path(self._py_file).read_bytes()).digest()


class _Implementation(_NumbaCache):  # type: ignore[misc]
    _locator_classes = (_ByModule, *_NumbaCache._locator_classes)


class KernelCache(caching.FunctionCache):  # type: ignore[misc]
    """Disk cache of the machine code of one kernel (compiled function).

    Attributes
    ----------
    directory
        Directory of the machine code of all kernels (`rig.realtime._cache`).
    """

    directory: Path
    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return numba's compile result for the signature `sig`, loaded from disk; None if it is not cached."""
        # Machine code needs the runtime that counts references alone, not the whole compiler that numba would load.
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Hold a file lock within this context, so that no other process compiles this function at the same time."""
        with contextlib.ExitStack() as held:
            # Without write access or locks every process compiles by itself: slower, but not wrong.
            with contextlib.suppress(OSError):
                directory = Path(self._cache_path)
                directory.mkdir(exist_ok=True)
                file = held.enter_context(open(directory / f"{self._impl.filename_base}.lock", "ab"))
                if not lock(file.fileno()):
                    _wait_for_lock(file.fileno())
            yield


def _wait_for_lock(descriptor: int) -> None:
    """Wait until the lock of a file is free, at most `PATIENCE_S` (60 s): its owner may be a suspended process."""
    deadline = time.monotonic() + PATIENCE_S
    compiling.report_begin()  # elsewhere, which takes as long
    try:
        while not lock(descriptor) and time.monotonic() < deadline:
            interrupts_now()
            time.sleep(POLL_S)
    finally:
        compiling.report_end()


def count_allocations(run: Callable[[], object]) -> int:
    """Call `run` and return how often compiled code allocated memory meanwhile."""
    runtime.memsys_enable_stats()
    allocations_before = runtime.memsys_get_stats_alloc()
    run()
    allocations = int(runtime.memsys_get_stats_alloc() - allocations_before)
    runtime.memsys_disable_stats()
    return allocations
