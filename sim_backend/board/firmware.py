"""Run the firmware's C code as a simulated device that controls the simulated plant.

`Core` is the firmware without a plant. `FirmwareDevice` connects it to a simulated rig and has the methods of
`device.SimulatedDevice`. Only the hardware layer (counter, amplifier, timer, switches) is simulated here; all decisions
are left to the C code. `make_device` creates it, and the files of `sim_backend.ends` run it.
"""

from __future__ import annotations

import ctypes
import struct
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input
from firmware_protocol.parameters import PARAMETERS
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.realtime.c_board import BoardSetup
from rig.realtime.kernel import prepare
from sim_backend.board import firmware_library
from sim_backend.board.configuration import describe
from sim_backend.board.firmware_library import HostStatus
from sim_backend.board.hardware import Hardware, World
from sim_backend.board.lockstep import (
    DUE,
    INDEX_COUNT,
    INDEX_EDGES,
    INPUTS,
    RATE_CHANGED,
    SWITCHED_ON,
    TIME,
    WORDS,
    Lockstep,
    run_ticks,
)
from sim_backend.board.safety import UNITS_PER_SECOND

OUTPUT_BYTES = 65536
LAWS = 2  # fixed point and float32, parameter `law`
_INDEX = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}
_CTYPES = {parameter.name: "<i" if parameter.ctype[0] == "i" else "<I" for parameter in PARAMETERS}
_NS_NUMERATOR, _NS_DENOMINATOR = 125, 2  # a unit of device time is 62.5 ns


class Core:
    """The firmware, compiled for this computer, without a plant: the caller supplies time, counts and currents."""

    def __init__(
        self,
        library: ctypes.CDLL,
        model: RigModel,
        rate: int = 1_000,
        maximum: int = 50_000,
        law_maximum: int = LAWS,
        *,
        name: str | None = None,
    ) -> None:
        self.library = library
        self._memory = ctypes.create_string_buffer(library.host_bytes())
        self.address = ctypes.addressof(self._memory)
        self._output = ctypes.create_string_buffer(OUTPUT_BYTES)
        rig = replace(model, operator=None, reach=None)  # each trial draws another movement
        self.dictionary = describe(rig, name or model.name, rate, maximum, law_maximum)
        self.hash = self.dictionary.hash
        # The struct has the address of `packed`: the dictionary must exist as long as the firmware.
        setup = BoardSetup.of(model, self.dictionary.packed, self.hash, rate)
        library.host_setup(self.address, ctypes.byref(setup))
        for narrow in (  # in the order of their ids: a refusal names the first that does not fit
            "motion",
            "position_rate",
            "current_limit",
            "continuous_current",
            "encoder_sign",
            "law",
        ):
            info = self.dictionary.parameter(narrow)
            assert info is not None
            bounds = [_bits(narrow, bound) for bound in (info.minimum, info.maximum)]
            library.host_narrow(self.address, _INDEX[narrow], *bounds)

    def start(self) -> None:
        """Start the firmware, as at power-up, at the device time that was set last by `host_set_world` (host.c)."""
        self.library.host_start(self.address)

    @property
    def status(self) -> HostStatus:
        """Return state and counters of the firmware, and its requests to the hardware (tick rate, amplifier)."""
        status = HostStatus()
        self.library.host_status(self.address, ctypes.byref(status))
        return status

    def lockstep(self, words: NDArray[np.int64]) -> Lockstep:
        """Return the firmware's functions for compiled ticks, which exchange values with the rig in `words`."""
        prepare(run_ticks)
        library = self.library
        return Lockstep(
            drive=_address(library.lockstep_drive),
            sample=_address(library.lockstep_sample),
            receive=_address(library.lockstep_receive),
            take=_address(library.host_take),
            device=self.address,
            address=words.ctypes.data,
            words=words,
        )

    def receive(self, data: bytes) -> bytes:
        """Pass bytes from the host to the firmware; return the firmware's replies."""
        self.library.host_receive(self.address, data, len(data))
        return self.take()

    def take(self) -> bytes:
        """Return the bytes that the firmware has sent since the last call."""
        count = self.library.host_take(self.address, self._output, OUTPUT_BYTES)
        return ctypes.string_at(self._output, count)  # `raw` would copy all of its 64 KiB


class FirmwareDevice:
    """A simulated device that consists of the firmware, compiled for this computer, and a simulated rig.

    Raise `ConfigError` if the default rate is outside 1 Hz to the maximum, the model cannot be simulated at that rate,
    or the firmware cannot be compiled.

    Parameters
    ----------
    model, name, position_rate_maximum, position_rate_default, seed, initial_position, keep_truth
        Rig, name of the device, highest and first tick rate (Hz), seed of the sensor noise, position of the handle at
        power-up (rad or m), and True to record the plant's state.
    law_maximum
        Largest value of the parameter `law` that the device accepts; 0 for a device without a law.
    library
        Compiled firmware; by default that of the package, compiled on first use.

    Attributes
    ----------
    core
        The firmware.
    hardware
        Simulated hardware and plant; set `hardware.external_effort` to push the link.
    inputs
        Active `Input` bits.
    time
        Device time of the last sample (1/16 µs since boot).
    """

    def __init__(
        self,
        model: RigModel,
        *,
        name: str | None = None,
        position_rate_maximum: int = 50_000,
        position_rate_default: int = 1_000,
        seed: int = 0,
        initial_position: float | None = None,
        keep_truth: bool = True,
        law_maximum: int = LAWS,
        library: ctypes.CDLL | None = None,
    ) -> None:
        if not 1 <= position_rate_default <= position_rate_maximum:
            raise ConfigError(
                f"the default rate of {position_rate_default} Hz is outside 1 … {position_rate_maximum} Hz",
                remedy="give a position_rate_default in this range, or raise position_rate_maximum",
            )
        library = library or firmware_library.library()
        self.core = Core(library, model, position_rate_default, position_rate_maximum, law_maximum, name=name)
        self.hardware = Hardware(model, position_rate_default, seed=seed, initial_position=initial_position)
        self.inputs = 0 if model.operator is None else int(Input.HOLD_TO_RUN)  # a person holds the switch too
        self.time = 0
        self._keep_truth = keep_truth
        self._epoch_ns = 0
        self._words = np.zeros(WORDS, np.int64)
        self._lockstep = self.core.lockstep(self._words)
        self._read_power_up_inputs()
        self._pass_measurements()
        self.core.start()
        self._start()

    def _start(self) -> None:
        self._truth = self.hardware.new_truth() if self._keep_truth else None
        self._seen = self.core.status

    @property
    def time_ns(self) -> int:
        """Return the device time of the last sample (ns since boot)."""
        return self.time * _NS_NUMERATOR // _NS_DENOMINATOR

    @property
    def elapsed_ns(self) -> int:
        """Return the simulated time since this object was created, over all resets (ns)."""
        return self._epoch_ns + self.time_ns

    @property
    def next_tick_ns(self) -> int:
        """Return the simulated time at which the next sample is due (ns since the device was created, not reset)."""
        return self._epoch_ns + int(self._seen.due) * _NS_NUMERATOR // _NS_DENOMINATOR

    @property
    def rate(self) -> int:
        """Return the tick rate of the device (Hz)."""
        return int(self._seen.rate)

    @property
    def current(self) -> int:
        """Return the active motor current, after all limits (quanta)."""
        return int(self._seen.current)

    @property
    def sample_index(self) -> int:
        """Return the number of the last sample, modulo 2³²."""
        return int(self._seen.sample_index)

    @property
    def state(self) -> State:
        """Return the device's state, as STATE frames report it."""
        return State(self._seen.state)

    @property
    def session(self) -> int:
        """Return the number of the device's session, 0 without a session."""
        return int(self._seen.session)

    @property
    def fault(self) -> Fault:
        """Return the fault that the device has latched, or NONE."""
        return Fault(self._seen.fault)

    @property
    def status(self) -> HostStatus:
        """Return state and counters of the firmware, also values that the protocol does not report."""
        return self._seen

    # ------------------------------------------------------------------ the tick

    def run(self, until_ns: int, most: int, *, enough: int = 1) -> tuple[bytes, int]:
        """Simulate ticks until the device has sent something; return the sent bytes and the number of ticks.

        Parameters
        ----------
        until_ns
            No tick is simulated that is due later (ns since the device was created, like `elapsed_ns`).
        most
            Largest number of ticks.
        enough
            Number of sent bytes after which to return.
        """
        until = (_NS_DENOMINATOR * (until_ns - self._epoch_ns) + 1) // _NS_NUMERATOR  # rounded down to a unit
        ticks, output = 0, b""
        if most > 0 and self._seen.due <= until:
            # One call of a compiled run takes as long as three single ticks.
            ticks, output = 1, self.tick()
        self._words[INPUTS] = self.inputs
        self._words[DUE] = self._seen.due
        while ticks < most and len(output) < enough:
            ran = self.hardware.run(self._lockstep, until, most - ticks, enough - len(output), self._truth)
            if ran == 0:
                break
            ticks += ran
            output += self.core.take()
        if ticks:
            self._seen = self.core.status
            self.time = int(self._seen.time)
            self.inputs = self._words.item(INPUTS)
        return output, ticks

    def compiled(self) -> tuple[Lockstep, World]:
        """Return firmware and rig in their present state as arguments of the compiled function `lockstep.run_ticks`."""
        world = self.hardware.world(self._truth)
        self._words[INPUTS], self._words[DUE], self._words[TIME] = self.inputs, self._seen.due, self.time
        return self._lockstep, world

    def passed(self, world: World) -> None:
        """Take over time, inputs, tick rate and session after compiled ticks have changed `world` (from `compiled`)."""
        self.hardware.passed(self._lockstep, world, self._truth)
        self.time, self.inputs = self._words.item(TIME), self._words.item(INPUTS)
        self._seen = self.core.status
        if self._words[RATE_CHANGED]:
            self.hardware.set_rate(self._seen.rate)
        if self._words[SWITCHED_ON]:
            self.hardware.begin_session()
        self._words[RATE_CHANGED] = self._words[SWITCHED_ON] = 0

    def tick(self) -> bytes:
        """Simulate one period in single calls of the firmware; return the bytes that the device sends in it."""
        library, address = self.core.library, self.core.address
        # A port's `device_tick` takes the sample and drives the current that follows from it at once. Here the halves
        # stand apart and the plant moves in between, so a current acts from its sample on.
        library.host_set_inputs(address, self.inputs)
        current = library.host_drive(address)
        self._apply_requests()
        self.hardware.advance(current)
        self.time = int(self._seen.due)
        self.hardware.sense(self._words)
        self.inputs = self._words.item(INPUTS)
        self._pass_measurements()
        library.host_sample(address)
        library.host_report(address)
        self._apply_requests()
        if self._truth is not None and self._seen.session:
            self.hardware.log(self._truth, self.sample_index)
        return self.core.take()

    # ------------------------------------------------------------------ messages

    def receive(self, data: bytes, *, received_at: int | None = None) -> bytes:
        """Process bytes from the host and return the device's replies.

        `received_at` is the device time of their arrival (1/16 µs); by default that of the last sample.
        """
        self._pass_measurements()
        self.core.library.host_set_clock(
            self.core.address, self.time if received_at is None else received_at, 0
        )
        answers = self.core.receive(data)
        self._apply_requests()
        return answers

    # ------------------------------------------------------------------ inputs, faults and resets

    def press_emergency_stop(self, pressed: bool = True) -> None:
        """Press the emergency stop of the simulated board, or release it."""
        self._input(Input.EMERGENCY_STOP, pressed)

    def hold_to_run(self, held: bool) -> None:
        """Hold the hold-to-run switch of the simulated board, or release it."""
        self._input(Input.HOLD_TO_RUN, held)

    def sync_input(self, high: bool, at: int | None = None) -> None:
        """Set the level of the sync input at device time `at` (1/16 µs); by default at that of the last sample."""
        if high and not self.inputs & Input.SYNC:
            self.core.library.host_set_sync_time(self.core.address, self.time if at is None else at)
        self._input(Input.SYNC, high)

    def fail_encoder(self) -> None:
        """Make the encoder's counter report an illegal transition before the next sample."""
        self.core.library.host_fail_encoder(self.core.address)

    def inject_fault(self, fault: Fault) -> None:
        """Make the hardware layer report a fault: the firmware sets the effort to zero and latches FAULT."""
        self.core.library.host_fault(self.core.address, int(fault))
        self._apply_requests()

    def reset(self) -> None:
        """Reboot the device: it loses parameters, homing, session and time. The handle moves on without effort."""
        self._epoch_ns = self.elapsed_ns
        self.time = 0
        self.hardware.cut()
        self.hardware.reset()
        self._read_power_up_inputs()
        self._pass_measurements()
        self.core.library.host_set_sync_time(self.core.address, 0)
        self.core.library.host_restart(self.core.address)
        self._apply_requests()
        self._start()

    def brown_out(self) -> None:
        """Reset device and encoder counter, as a voltage dip or the hardware watchdog does; the count restarts at zero.

        The hardware layer reports the fault `WATCHDOG_RESET` to the firmware.
        """
        # The handle stays where it is while the counter restarts: the difference becomes slip.
        self.hardware.slip -= self.hardware.count
        self.hardware.count = 0
        self.reset()
        self.inject_fault(Fault.WATCHDOG_RESET)

    def truth(self) -> NDArray[np.void]:
        """Return the plant's state in every tick of a session since boot, dtype `rig.core.sample.TRUTH`."""
        return (self._truth or self.hardware.new_truth()).table()

    def _input(self, bit: Input, active: bool) -> None:
        self.inputs = self.inputs | int(bit) if active else self.inputs & ~int(bit)
        self._words[INPUTS] = self.inputs
        self.core.library.host_set_inputs(self.core.address, self.inputs)

    def _read_power_up_inputs(self) -> None:
        self._words[INPUTS] = self.inputs
        self.hardware.power_up(self._words)
        self.inputs = self._words.item(INPUTS)

    def _pass_measurements(self) -> None:
        hardware, words, library = self.hardware, self._words, self.core.library
        # Before the first edge its age is infinite; the C code has unsigned time since boot.
        edge_age = round(min(hardware.edge_age_s * UNITS_PER_SECOND, self.time))
        library.host_set_world(
            self.core.address, self.time, hardware.count, self.time - edge_age, hardware.measured, self.inputs
        )
        library.host_set_index(self.core.address, words.item(INDEX_EDGES), words.item(INDEX_COUNT))

    def _apply_requests(self) -> None:
        """Apply the firmware's changes of tick rate and amplifier (disabled, enabled) to the simulated hardware."""
        before, self._seen = self._seen, self.core.status
        if self._seen.rate != before.rate:
            self.hardware.set_rate(self._seen.rate)
        if self._seen.cuts != before.cuts:
            self.hardware.cut()
        if self._seen.enabled and not before.enabled:
            self.hardware.begin_session()


def _address(function: Any) -> int:
    address = ctypes.cast(function, ctypes.c_void_p).value
    assert address is not None
    return address


def _bits(name: str, value: float) -> int:
    return int.from_bytes(struct.pack(_CTYPES[name], int(value)), "little")
