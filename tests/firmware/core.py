"""The firmware's core as a device in virtual time: the plant of the simulation, the software of a board.

`CoreDevice` offers what `sim_backend.link.MemoryLink` wants of a `SimulatedDevice`, so that every suite that speaks to
one can speak to the other.
"""

from __future__ import annotations

import ctypes
import struct
from pathlib import Path
from typing import Any

from firmware_protocol import dictionary as dictionaries
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input
from firmware_protocol.parameters import PARAMETERS
from rig.model import RigModel
from sim_backend.configuration import describe
from sim_backend.hardware import Hardware
from sim_backend.safety import OVER_CURRENT_MARGIN, STALL_COUNTS, UNITS_PER_SECOND

OUTPUT_BYTES = 65536
_INDEX = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}
_CTYPES = {parameter.name: "<i" if parameter.ctype[0] == "i" else "<I" for parameter in PARAMETERS}


class Mechanics(ctypes.Structure):
    """struct mechanics of board.h."""

    _fields_ = [
        (name, ctypes.c_double)
        for name in ("effort_quantum", "effort_limit", "friction", "travel", "inertia", "damping", "lag_s")
    ]


class Setup(ctypes.Structure):
    """struct host_setup of host.h."""

    _fields_ = [
        ("dictionary", ctypes.c_char_p),
        ("dictionary_hash", ctypes.c_uint64),
        ("dictionary_bytes", ctypes.c_uint32),
        ("rate_initial", ctypes.c_uint32),
        ("encoder_sign", ctypes.c_int32),
        ("over_current", ctypes.c_uint32),
        ("mechanics", Mechanics),
    ]


class Counters(ctypes.Structure):
    """struct counters of counters.h."""

    _fields_ = [
        (name, ctypes.c_uint32)
        for name in (
            "frames", "framing_errors", "crc_errors", "malformed", "unknown_type", "wrong_direction",
            "foreign_major", "stale_session", "out_of_state", "lost", "duplicated", "reordered",
        )
    ]  # fmt: skip


class Status(ctypes.Structure):
    """struct host_status of host.h."""

    _fields_ = [
        ("time", ctypes.c_uint64),
        ("due", ctypes.c_uint64),
        *((name, ctypes.c_uint32) for name in ("sample_index", "rate", "cuts", "feeds", "dropped")),
        ("current", ctypes.c_int32),
        *((name, ctypes.c_uint8) for name in ("state", "session", "fault", "enabled")),
        ("counters", Counters),
        ("sync", ctypes.c_uint8),
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
    "host_set_room": (None, [_P, _N]),
    "host_drive": (ctypes.c_int16, [_P]),
    "host_sample": (None, [_P]),
    "host_tell": (None, [_P]),
    "host_tick": (None, [_P]),
    "host_missed": (None, [_P, _U32]),
    "host_fault": (None, [_P, _U8]),
    "host_receive": (None, [_P, ctypes.c_char_p, _N]),
    "host_poll": (_N, [_P, ctypes.c_char_p, _N]),
    "host_take": (_N, [_P, _P, _N]),
    "host_law": (ctypes.c_bool, [_P, _P]),
    "host_status": (None, [_P, ctypes.POINTER(Status)]),
}


def load(path: Path) -> ctypes.CDLL:
    """The library with its signatures."""
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


class Core:
    """The firmware behind its host port: bytes and a world, no plant."""

    def __init__(
        self,
        library: ctypes.CDLL,
        model: RigModel,
        rate: int = 1_000,
        maximum: int = 50_000,
        law_maximum: int = 0,
    ) -> None:
        self.library = library
        self._memory = ctypes.create_string_buffer(library.host_bytes())
        self.address = ctypes.addressof(self._memory)
        self._output = ctypes.create_string_buffer(OUTPUT_BYTES)
        self.dictionary = describe(model, model.name, rate, maximum, law_maximum)
        self._packed = dictionaries.encode(self.dictionary)
        self.hash = dictionaries.dictionary_hash(self._packed)
        setup = Setup(
            self._packed,
            self.hash,
            len(self._packed),
            rate,
            model.encoder.sign,
            _over_current(model),
            _mechanics(model),
        )
        library.host_setup(self.address, ctypes.byref(setup))
        for name in ("motion", "position_rate", "current_limit", "continuous_current", "law"):
            info = self.dictionary.parameter(name)
            assert info is not None
            bounds = [_bits(name, bound) for bound in (info.minimum, info.maximum)]
            library.host_narrow(self.address, _INDEX[name], *bounds)

    def start(self) -> None:
        self.library.host_start(self.address)

    @property
    def status(self) -> Status:
        status = Status()
        self.library.host_status(self.address, ctypes.byref(status))
        return status

    def receive(self, data: bytes) -> bytes:
        """Hand bytes in and return the answers."""
        self.library.host_receive(self.address, data, len(data))
        return self.take()

    def take(self) -> bytes:
        """What the device has sent."""
        count = self.library.host_take(self.address, self._output, OUTPUT_BYTES)
        return self._output.raw[:count]


class CoreDevice:
    """The core with a simulated rig behind it; see `SimulatedDevice` for what the names mean."""

    def __init__(
        self,
        library: ctypes.CDLL,
        model: RigModel,
        *,
        position_rate_default: int = 1_000,
        position_rate_maximum: int = 50_000,
        seed: int = 0,
        initial_position: float | None = None,
        law_maximum: int = 0,
    ) -> None:
        self.core = Core(library, model, position_rate_default, position_rate_maximum, law_maximum)
        self.hardware = Hardware(model, position_rate_default, seed=seed, initial_position=initial_position)
        self.inputs = 0 if model.operator is None else int(Input.HOLD_TO_RUN)
        self.time = 0
        self._epoch_ns = 0
        self._show_world()
        self.core.start()
        self._seen = self.core.status

    @property
    def time_ns(self) -> int:
        return self.time * 125 // 2

    @property
    def elapsed_ns(self) -> int:
        return self._epoch_ns + self.time_ns

    @property
    def next_tick_ns(self) -> int:
        return self._epoch_ns + int(self._seen.due) * 125 // 2

    @property
    def rate(self) -> int:
        return int(self._seen.rate)

    @property
    def sample_index(self) -> int:
        return int(self._seen.sample_index)

    @property
    def state(self) -> State:
        return State(self._seen.state)

    @property
    def session(self) -> int:
        return int(self._seen.session)

    @property
    def fault(self) -> Fault:
        return Fault(self._seen.fault)

    def tick(self) -> bytes:
        library, address = self.core.library, self.core.address
        library.host_set_inputs(address, self.inputs)
        current = library.host_drive(address)
        self._act()
        self.hardware.advance(current)
        self.time = int(self._seen.due)
        self._show_world()
        library.host_sample(address)
        library.host_tell(address)
        self._act()
        return self.core.take()

    def receive(self, data: bytes, *, received_at: int | None = None) -> bytes:
        self._show_world()
        self.core.library.host_set_clock(
            self.core.address, self.time if received_at is None else received_at, 0
        )
        answers = self.core.receive(data)
        self._act()
        return answers

    def press_emergency_stop(self, pressed: bool = True) -> None:
        self._input(Input.EMERGENCY_STOP, pressed)

    def hold_to_run(self, held: bool) -> None:
        self._input(Input.HOLD_TO_RUN, held)

    def sync_input(self, high: bool) -> None:
        if high and not self.inputs & Input.SYNC:
            self.core.library.host_set_sync_time(self.core.address, self.time)
        self._input(Input.SYNC, high)

    def inject_fault(self, fault: Fault) -> None:
        self.core.library.host_fault(self.core.address, int(fault))
        self._act()

    def reset(self) -> None:
        self._epoch_ns = self.elapsed_ns
        self.time = 0
        self.hardware.cut()
        self.hardware.reset()
        self._show_world()
        self.core.library.host_set_sync_time(self.core.address, 0)
        self.core.library.host_restart(self.core.address)
        self._act()

    def _input(self, bit: Input, active: bool) -> None:
        self.inputs = self.inputs | int(bit) if active else self.inputs & ~int(bit)
        self.core.library.host_set_inputs(self.core.address, self.inputs)

    def _show_world(self) -> None:
        hardware = self.hardware
        edge_age = round(min(hardware.edge_age_s * UNITS_PER_SECOND, self.time))
        self.core.library.host_set_world(
            self.core.address, self.time, hardware.count, self.time - edge_age, hardware.measured, self.inputs
        )

    def _act(self) -> None:
        """Do to the plant what the device has done to its amplifier and its timer."""
        before, self._seen = self._seen, self.core.status
        if self._seen.rate != before.rate:
            self.hardware.set_rate(self._seen.rate)
        if self._seen.cuts != before.cuts:
            self.hardware.cut()
        if self._seen.enabled and not before.enabled:
            self.hardware.begin_session()


def _bits(name: str, value: float) -> int:
    return int.from_bytes(struct.pack(_CTYPES[name], int(value)), "little")


def _over_current(model: RigModel) -> int:
    return int(OVER_CURRENT_MARGIN * model.amplifier.effort_limit / model.amplifier.effort_quantum)


def _mechanics(model: RigModel) -> Mechanics:
    mechanics, amplifier = model.mechanics, model.amplifier
    return Mechanics(
        amplifier.effort_quantum,
        amplifier.effort_limit,
        mechanics.motor_coulomb + mechanics.link_coulomb + abs(mechanics.gravity_effort),
        STALL_COUNTS * model.encoder.resolution,
        mechanics.motor_inertia + mechanics.loaded_link_inertia,
        mechanics.motor_damping + mechanics.link_damping + amplifier.back_emf_damping,
        amplifier.lag_s,
    )
