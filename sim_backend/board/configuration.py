"""Store the device's dictionary and the active parameters of a simulated device, and answer the requests about them.

Both simulated devices use it. It must not depend on the plant.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache

from firmware_protocol import dictionary as dictionaries
from firmware_protocol import messages as m
from firmware_protocol.faults import Status
from firmware_protocol.packing import data_limit
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import (
    BY_NAME,
    LIVE,
    ParameterError,
    block_crc,
    check_together,
    decode_block,
    encode_block,
)
from firmware_protocol.transfer import Assembler, page
from rig.core import board
from rig.core.model import RigModel

FIRMWARE = "simulated 1"


@lru_cache(maxsize=64)  # all devices of a rig have the same dictionary, which takes 5 ms to pack
def describe(
    model: RigModel, name: str, rate_default: int, rate_maximum: int, law_maximum: int = 0
) -> dictionaries.Dictionary:
    """Return a simulated device's dictionary (description of itself) for a rig, with default and highest rate (Hz).

    `law_maximum` is the largest value of the parameter `law`: 0 for a device without a law.
    """
    return board.describe(
        model,
        firmware=FIRMWARE,
        simulated=True,
        rate_default=rate_default,
        rate_maximum=rate_maximum,
        name=name,
        narrower={"law": (0, law_maximum)},
    )


class Configuration:
    """The active parameters of a device. A parameter block is activated completely, between two ticks, or rejected.

    Parameters
    ----------
    dictionary
        Dictionary of the device; its default values are active at the start.
    apply
        Called with all values before they are activated; it raises `ParameterError` to reject them.

    Attributes
    ----------
    values
        Active value of each parameter, by name.
    crc
        CRC-32 of the active block.
    homed
        True if position zero (`reference_count`) was set since the start.
    hash
        Hash of the device's dictionary.
    """

    def __init__(
        self, dictionary: dictionaries.Dictionary, apply: Callable[[Mapping[str, Value]], None]
    ) -> None:
        self._dictionary = dictionary
        self._packed, self.hash = dictionary.packed, dictionary.hash
        self._apply = apply
        self._assembler = Assembler()
        self.homed = False
        self._activate({info.name: info.default for info in self._dictionary.parameters})

    def identity(self, request: m.Identify, state: int) -> m.Identity:
        """Return the IDENTITY message with the requested page of the dictionary; `state` is the device's state."""
        packed = self._packed
        piece = page(packed, request.offset, data_limit(m.Identity))
        return m.Identity(request.nonce, m.MINOR, state, self.hash, len(packed), request.offset, piece)

    def parameters(self, request: m.GetParameters) -> m.Parameters:
        """Return the PARAMETERS message with the requested page of the active parameter block."""
        piece = page(self._block, request.offset, data_limit(m.Parameters))
        return m.Parameters(request.nonce, len(self._block), self.crc, request.offset, piece)

    def begin(self, request: m.SetBegin) -> Status:
        """Begin the transfer of a parameter block; return the status of the ACK."""
        return self._assembler.begin(request)

    def chunk(self, request: m.SetChunk) -> Status:
        """Store a chunk of the transferred parameter block; return the status of the ACK."""
        return self._assembler.chunk(request)

    def commit(self, request: m.SetCommit, *, armed: bool = False) -> tuple[Status, int]:
        """Activate the transferred parameter block; return the status of the ACK, and a rejected parameter's id or 0.

        An armed device accepts only the parameters that may change while it is armed.
        """
        status, block = self._assembler.commit(request)
        if status is not Status.OK:
            return status, 0
        try:
            values = decode_block(block)
            self._check_ranges(values)
            # The order of these checks is the firmware's: a refusal names the first parameter that fails.
            grave = [name for name in values if name not in LIVE]
            if armed and grave:
                detail = BY_NAME[grave[0]].id
                message = f"{grave[0]} cannot change while the device is armed"
                raise ParameterError(Status.NOT_LIVE, message, detail=detail, name=grave[0])
            # Any other parameter may change which way the motor pushes, so the device asks for verification again.
            cleared = {"verified": 0} if grave else {}
            self._activate({**self.values, **cleared, **values})
        except ParameterError as error:
            return error.status, error.detail
        self.homed = self.homed or "reference_count" in values
        return Status.OK, 0

    def _check_ranges(self, values: Mapping[str, Value]) -> None:
        """Raise `ParameterError` for a value outside this device's range, which is narrower than the protocol's."""
        for info in self._dictionary.parameters:
            value = values.get(info.name, info.minimum)
            if not info.minimum <= value <= info.maximum:
                message = f"{info.name} = {value} is outside {info.minimum} … {info.maximum}"
                raise ParameterError(Status.OUT_OF_RANGE, message, detail=info.id, name=info.name)

    def _activate(self, values: dict[str, Value]) -> None:
        # All that can raise comes before the first assignment: a refused block leaves the active one untouched.
        block = encode_block(values)
        check_together(values)
        self._apply(values)
        self.values, self._block = values, block
        self.crc = block_crc(self._block)
