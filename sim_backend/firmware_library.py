"""The firmware's C code as a library of this machine: compiled by its C compiler on first use, and kept.

The device at the far end of a law that runs on the device is the firmware itself, not a copy of it in Python. Its
sources come with the package; the library lies beside the compiled kernels, under a name that says of which sources,
flags and compiler it was made. Two processes that want it at once both make it, and the later one's replaces the
other's in one step.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import firmware_protocol
from rig.core.errors import ConfigError
from rig.realtime.kernel import CACHE_DIRECTORY

FIRMWARE = Path(firmware_protocol.__file__).with_name("firmware")
PARTS = ("core", "law", "host")
# Without contraction, as golden vectors have it; what is missing is an error here, not when it is opened.
FLAGS = ["-std=c99", "-O1", "-shared", "-ffp-contract=off"]
if sys.platform == "linux":  # the linkers of the others want all symbols defined anyway
    FLAGS.append("-Wl,-z,defs")
if sys.platform != "win32":  # where code is relocated
    FLAGS.append("-fPIC")
COMPILERS = ("cc", "gcc", "clang")
ZIG = "ziglang"  # a C compiler as a package of Python, for systems that have none
COMPILE_S = 600.0  # which builds its C library first, once
_SHOWN_LINES = 6  # of what a compiler says


class Mechanics(ctypes.Structure):
    """Struct mechanics of board.h."""

    _fields_ = [
        (name, ctypes.c_double)
        for name in ("effort_quantum", "effort_limit", "friction", "travel", "inertia", "damping", "lag_s")
    ]


class CurrentSensor(ctypes.Structure):
    """Struct current_sensor of board.h."""

    _fields_ = [(name, ctypes.c_double) for name in ("noise", "lag_s", "back_emf")]


class Setup(ctypes.Structure):
    """Struct host_setup of host.h."""

    _fields_ = [
        ("dictionary", ctypes.c_char_p),
        ("dictionary_hash", ctypes.c_uint64),
        ("dictionary_bytes", ctypes.c_uint32),
        ("rate_initial", ctypes.c_uint32),
        ("encoder_sign", ctypes.c_int32),
        ("over_current", ctypes.c_uint32),
        ("mechanics", Mechanics),
        ("current_sensor", CurrentSensor),
    ]


class Counters(ctypes.Structure):
    """Struct counters of counters.h."""

    _fields_ = [
        (name, ctypes.c_uint32)
        for name in (
            "frames", "framing_errors", "crc_errors", "malformed", "unknown_type", "wrong_direction",
            "foreign_major", "stale_session", "out_of_state", "lost", "duplicated", "reordered",
        )
    ]  # fmt: skip


class Status(ctypes.Structure):
    """Struct host_status of host.h."""

    _fields_ = [
        ("time", ctypes.c_uint64),
        ("due", ctypes.c_uint64),
        *(
            (name, ctypes.c_uint32)
            for name in ("sample_index", "rate", "cuts", "feeds", "bite_us", "dropped", "frames_driven")
        ),
        ("current", ctypes.c_int32),
        *((name, ctypes.c_uint8) for name in ("state", "session", "fault", "enabled")),
        ("counters", Counters),
        ("sync", ctypes.c_uint8),
        ("left", ctypes.c_uint8),
    ]


_P, _U8, _U32, _U64, _N = (
    ctypes.c_void_p,
    ctypes.c_uint8,
    ctypes.c_uint32,
    ctypes.c_uint64,
    ctypes.c_size_t,
)
_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "host_bytes": (_N, []),
    "host_setup": (None, [_P, ctypes.POINTER(Setup)]),
    "host_narrow": (None, [_P, _U8, _U32, _U32]),
    "host_set_excitation": (None, [_P, _U32]),
    "host_start": (None, [_P]),
    "host_restart": (None, [_P]),
    "host_set_world": (None, [_P, _U64, ctypes.c_int32, _U64, ctypes.c_int16, _U8]),
    "host_set_clock": (None, [_P, _U64, _U64]),
    "host_set_inputs": (None, [_P, _U8]),
    "host_fail_encoder": (None, [_P]),
    "host_refuse_rate": (None, [_P, _U32]),
    "host_set_sync_time": (None, [_P, _U64]),
    "host_set_index": (None, [_P, _U32, ctypes.c_int32]),
    "host_set_room": (None, [_P, _N]),
    "host_drive": (ctypes.c_int16, [_P]),
    "host_sample": (None, [_P]),
    "host_tell": (None, [_P]),
    "host_tick": (None, [_P]),
    "host_tick_alone": (None, [_P]),
    "host_was_reset": (None, [_P, _U32]),
    "host_let_leave": (None, [_P]),
    "host_fault": (None, [_P, _U8]),
    "host_receive": (None, [_P, ctypes.c_char_p, _N]),
    "host_poll": (_N, [_P, ctypes.c_char_p, _N]),
    "host_take": (_N, [_P, _P, _N]),
    "host_law": (ctypes.c_bool, [_P, _P]),
    "host_status": (None, [_P, ctypes.POINTER(Status)]),
    "lockstep_drive": (ctypes.c_int, [_P, _P]),
    "lockstep_sample": (ctypes.c_int, [_P, _P]),
    "lockstep_receive": (ctypes.c_int, [_P, _P]),
}


def load(path: Path) -> ctypes.CDLL:
    """Open a library that was compiled, with its signatures."""
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


@cache
def library() -> ctypes.CDLL:
    """Open the firmware's library, compiled before if it has to be.

    Raises
    ------
    ConfigError
        There is no C compiler, it fails, or what it made does not open.
    """
    path = compiled(CACHE_DIRECTORY)
    try:
        return load(path)
    except (OSError, AttributeError) as error:
        raise ConfigError(
            f"the firmware's library {path} does not open: {error}", remedy="remove it: it is built again"
        ) from error


def sources() -> list[Path]:
    """The C files that the library is made of."""
    return [path for part in PARTS for path in sorted((FIRMWARE / part).glob("*.c"))]


def compiler() -> list[str]:
    """Command of the C compiler: ``$CC``, the first of `COMPILERS` there is, or `ZIG`; `ConfigError` without one."""
    named = shlex.split(os.environ.get("CC", ""))
    for command in (named, *([name] for name in COMPILERS)):
        found = shutil.which(command[0]) if command else None
        if found is not None:
            return [found, *command[1:]]
    if find_spec(ZIG) is not None:
        return [sys.executable, "-P", "-m", ZIG, "cc"]
    raise ConfigError(
        "there is no C compiler: a simulated device that runs the law itself is the firmware, compiled on first use",
        remedy="install one (Debian: apt install gcc libc6-dev; elsewhere: pip install ziglang) or name it in CC; or "
        'set controller.loop = "host"',
    )


def compiled(directory: Path) -> Path:
    """Make the library in a directory unless it is there; errors as `library`."""
    command = compiler()
    path = directory / f"firmware-{_key(command)}.so"
    if path.exists():
        return path
    with tempfile.TemporaryDirectory(dir=directory, prefix="firmware-") as workplace:
        made = Path(workplace) / "firmware.so"
        _compile([*command, *FLAGS, "-o", str(made), *map(str, sources()), "-lm"])
        made.replace(path)
    return path


def _key(command: list[str]) -> str:
    """Sixteen hex digits over the sources, the flags and the compiler."""
    facts = Path(command[0]).resolve().stat()
    digest = hashlib.sha256(f"{command} {facts.st_size} {facts.st_mtime_ns} {FLAGS}".encode())
    for part in PARTS:
        for path in sorted((FIRMWARE / part).glob("*.[ch]")):
            digest.update(f"{part}/{path.name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _compile(command: list[str]) -> None:
    remedy = 'name another compiler in CC, or set controller.loop = "host"'
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=COMPILE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ConfigError(f"the C compiler {command[0]} does not run: {error}", remedy=remedy) from error
    if done.returncode != 0:
        said = "\n".join((done.stderr or done.stdout).strip().splitlines()[:_SHOWN_LINES])
        raise ConfigError(f"the C compiler {command[0]} failed on the firmware:\n{said}", remedy=remedy)
