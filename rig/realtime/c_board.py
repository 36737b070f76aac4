"""Fill the firmware's struct board_setup, which describes a rig to firmware that is compiled for this computer.

The simulated board and the simulated drives use it, and load their C libraries with `CLibrary`. Every field comes from
the rig's configuration: this file must not contain a default.
"""

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
    """The C struct board_setup of `firmware/core/on_a_computer.h`: the rig as firmware on this computer sees it.

    The struct has only a pointer to the dictionary's bytes: the caller must keep `dictionary` alive as long as the
    struct.
    """

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
        """Return the C struct for a rig, with its dictionary's bytes (keep them alive) and hash, and the first rate."""
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
