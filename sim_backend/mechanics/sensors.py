"""Convert true positions to encoder counts, and true currents to quanta, as the rig's sensors do.

The simulated device and the simulation without a byte link call the same functions. The encoder is a quadrature counter
(data sheet: cycles per revolution, times decoding). The current quantum is the one that the device's dictionary states.
"""

import math

from numba import types

from rig.realtime.kernel import kernel

CURRENT_QUANTA_LIMIT = 32767.0  # i16 on the wire; symmetric, so that negating a current never overflows


@kernel(types.int64(types.float64, types.float64, types.float64), inline=True)
def cell(position: float, resolution: float, offset: float) -> int:
    """Return the encoder cell that contains a position: floor(position / resolution + offset), as yet without a sign.

    Parameters
    ----------
    position
        True position of the side with the encoder (rad or m), finite.
    resolution
        Travel for one count (rad or m), above zero.
    offset
        Position zero within its encoder cell (count): 0.5 rounds to the nearest count, 0 rounds down.
    """
    return math.floor(position / resolution + offset)


@kernel(types.int64(types.float64, types.float64, types.float64, types.int64), inline=True)
def encoder_count(position: float, resolution: float, offset: float, sign: int) -> int:
    """Return the encoder count at a position: sign · floor(position / resolution + offset).

    Parameters
    ----------
    position, resolution
        True position of the side with the encoder, and travel for one count (rad or m).
    offset
        Position zero within its encoder cell (count); see `cell`.
    sign
        +1 if the count rises with the position, −1 if it falls.
    """
    return sign * cell(position, resolution, offset)


@kernel(types.int64(types.float64, types.float64), inline=True)
def current_quanta(current_a: float, quantum_a: float) -> int:
    """Return the current as a whole number of quanta: floor(current / quantum + ½), within ±32767.

    Parameters
    ----------
    current_a
        Current (A). NaN gives 0, ±∞ gives ±32767.
    quantum_a
        Size of one quantum (A), above zero.

    Notes
    -----
    Halves are rounded towards +∞, as in the encoder and in the command (`rig.control._guard.current_quanta`).
    """
    quanta = current_a / quantum_a
    if math.isnan(quanta):
        return 0
    return math.floor(min(max(quanta, -CURRENT_QUANTA_LIMIT), CURRENT_QUANTA_LIMIT) + 0.5)
