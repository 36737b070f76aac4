"""Struct board_setup of the firmware: the description of the rig for firmware that is compiled for this computer.

The simulated board and the simulated drives fill it, and load their libraries with `CLibrary`. It must not
contain a default: every field comes from the rig.
"""

from __future__ import annotations

import ctypes
from dataclasses import asdict
from typing import Self

from rig.core import board, current_sensor
from rig.core.model import RigModel
from rig.realtime._c_library import FLAGS, CLibrary, doubles

__all__ = [
    "FLAGS",
    "BoardSetup",
    "CLibrary",
    "CurrentSensor",
    "Mechanics",
]

Mechanics = doubles(board.MovedMechanics)
CurrentSensor = doubles(current_sensor.CurrentSensor)


class BoardSetup(ctypes.Structure):
    """The struct of `firmware/core/on_a_computer.h`; the bytes of the dictionary must exist as long as the struct."""

    _fields_ = [
        ("dictionary", ctypes.c_char_p),
        ("dictionary_hash", ctypes.c_uint64),
        *((name, ctypes.c_uint32) for name in ("dictionary_bytes", "rate_initial")),
        ("encoder_sign", ctypes.c_int32),
        ("over_current", ctypes.c_uint32),
        ("mechanics", Mechanics),
        ("current_sensor", CurrentSensor),
    ]

    @classmethod
    def of(cls, model: RigModel, dictionary: bytes, fingerprint: int, rate: int) -> Self:
        """Return the struct for a rig: its model, encoded dictionary, hash of the dictionary, and first rate (Hz)."""
        return cls(
            dictionary=dictionary,
            dictionary_hash=fingerprint,
            dictionary_bytes=len(dictionary),
            rate_initial=rate,
            encoder_sign=model.encoder.sign,
            over_current=board.over_current(model),
            mechanics=Mechanics(**asdict(board.moved_mechanics(model))),
            current_sensor=CurrentSensor(**asdict(board.current_sensor(model))),
        )
