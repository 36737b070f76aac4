"""Compile the firmware's C code as a shared library of this computer, and declare its functions for Python.

A simulated device that runs the control law itself uses this library, not a copy of the law in Python. The sources come
with the package. The simulated boards load it. It must not contain a part of the law itself.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import firmware_protocol
from rig.realtime.c_board import BoardSetup, CLibrary
from rig.realtime.kernel import CACHE_DIRECTORY

FIRMWARE = CLibrary(
    name="firmware",
    root=Path(firmware_protocol.__file__).with_name("firmware"),
    parts=("core", "law", "host"),
    purpose="the simulated device is the firmware",
)


class Counters(ctypes.Structure):
    """The C structure `struct counters` of counters.h: counters of received and dropped frames."""

    _fields_ = [
        (name, ctypes.c_uint32)
        for name in (
            "frames",
            "framing_errors",
            "crc_errors",
            "malformed",
            "unknown_type",
            "wrong_direction",
            "foreign_major",
            "stale_session",
            "out_of_state",
            "lost",
            "duplicated",
            "reordered",
        )
    ]


class HostStatus(ctypes.Structure):
    """The C structure `struct host_status` of host.h: state of the firmware, and its requests to the hardware."""

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
    "host_setup": (None, [_P, ctypes.POINTER(BoardSetup)]),
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
    "host_report": (None, [_P]),
    "host_tick": (None, [_P]),
    "host_tick_alone": (None, [_P]),
    "host_was_reset": (None, [_P, _U32]),
    "host_let_leave": (None, [_P]),
    "host_fault": (None, [_P, _U8]),
    "host_receive": (None, [_P, ctypes.c_char_p, _N]),
    "host_poll": (_N, [_P, ctypes.c_char_p, _N]),
    "host_take": (_N, [_P, _P, _N]),
    "host_law": (ctypes.c_bool, [_P, _P]),
    "host_status": (None, [_P, ctypes.POINTER(HostStatus)]),
    "lockstep_drive": (ctypes.c_int, [_P, _P]),
    "lockstep_sample": (ctypes.c_int, [_P, _P]),
    "lockstep_receive": (ctypes.c_int, [_P, _P]),
}


def load(path: Path) -> ctypes.CDLL:
    """Open the compiled library at a path and declare the signatures of its functions."""
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


@cache
def library() -> ctypes.CDLL:
    """Return the firmware's compiled library; compile it first if necessary.

    Raise `ConfigError` if the C compiler is missing or fails, or the compiled library cannot be opened.
    """
    return FIRMWARE.opened(CACHE_DIRECTORY, load)
