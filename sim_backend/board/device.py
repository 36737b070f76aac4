"""Simulate a device in readable Python: a whole rig behind the wire protocol, without I/O and without a clock.

The caller provides bytes and time: `link` in virtual time, `pty` in real time. It calls `receive` and `tick` in turn.
The device follows PROTOCOL.md but runs no control law: a SUPERVISE command feeds the watchdog and drives no current. It
must stay readable: it is the reference for the C code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.connection import Connection, Event, Received, Refused, State
from firmware_protocol.faults import Fault, Input, LimitFlag, Status
from firmware_protocol.messages import Message, Mode, Role
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME, ParameterError
from firmware_protocol.replies import Replies
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.realtime.codec import STATE
from sim_backend.board.configuration import Configuration, describe
from sim_backend.board.hardware import Hardware
from sim_backend.board.lockstep import (
    COUNT,
    CUTS,
    DUE,
    EDGE_AGE,
    INDEX_COUNT,
    INDEX_EDGES,
    INPUTS,
    MEASURED,
    SAMPLE_INDEX,
    SESSION,
    TIME,
)
from sim_backend.board.safety import (
    AT,
    UNITS_PER_SECOND,
    UNITS_PER_US,
    FaultMemory,
    Safety,
    flat,
    idle,
    is_in_window,
    is_overheated,
)
from sim_backend.board.ticks import (
    BOARD_WORDS,
    OWN,
    DeviceMemory,
    drive,
    is_too_old,
    obey,
    report,
    sample,
    time_of,
)

_U32 = 0xFFFFFFFF
_NS_NUMERATOR, _NS_DENOMINATOR = 125, 2  # a unit of device time is 62.5 ns
_EMERGENCY_STOP, _HOLD_TO_RUN, _SYNC_INPUT = map(int, (Input.EMERGENCY_STOP, Input.HOLD_TO_RUN, Input.SYNC))
MODES = frozenset(int(mode) for mode in Mode)


class DeviceWord:
    """Attribute of `SimulatedDevice` whose value is stored in `board.words`, the memory that its ticks use."""

    def __init__(self, index: int) -> None:
        self._index = index

    def __get__(self, device: SimulatedDevice, owner: object = None) -> int:
        return int(device.board.words[self._index])

    def __set__(self, device: SimulatedDevice, value: int) -> None:
        device.board.words[self._index] = value


class SimulatedDevice:
    """A simulated device in Python with its rig, behind the wire protocol.

    Raise `ConfigError` if the default rate is above the maximum, or the model cannot be simulated at this rate.

    Parameters
    ----------
    model
        Rig to simulate. The dictionary declares its current quantum.
    name
        Name of the device; by default the name of the model.
    position_rate_maximum, position_rate_default
        Highest tick rate, and tick rate until the host configures one (Hz).
    seed
        Seed of the current sensor's noise.
    initial_position
        Position of the handle at power-up (rad or m); by default that of the model, else 0.
    keep_truth
        True to record the plant's state in every tick of a session, for `truth`.

    Attributes
    ----------
    board
        Memory of the device, as views for Python.
    connection
        Device side of the protocol: state, session, statistics.
    hardware
        Simulated hardware and plant; set `hardware.external_effort` to push the link.
    inputs
        Active `Input` bits of the switches and of the sync input.
    sync
        `Sync` bits of the sync outputs in the last tick, without the bit that marks each tick.
    sample_index, time
        Number and device time (1/16 µs since boot) of the last sample.
    worst_execution_time
        Longest tick since arming (1/16 µs); the caller measures it.
    missed_ticks
        Number of ticks since arming without a STATE message; the caller counts them.
    """

    sample_index, time, inputs, sync = (
        DeviceWord(SAMPLE_INDEX),
        DeviceWord(TIME),
        DeviceWord(INPUTS),
        DeviceWord(OWN.sync),
    )
    worst_execution_time, missed_ticks = DeviceWord(OWN.worst_execution_time), DeviceWord(OWN.missed_ticks)

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
    ) -> None:
        if not 1 <= position_rate_default <= position_rate_maximum:
            raise ConfigError(
                f"the default rate of {position_rate_default} Hz is outside 1 … {position_rate_maximum} Hz",
                remedy="give a position_rate_default in this range, or raise position_rate_maximum",
            )
        self._dictionary = describe(model, name or model.name, position_rate_default, position_rate_maximum)
        self.connection = Connection(Role.DEVICE)
        self.hardware = Hardware(model, position_rate_default, seed=seed, initial_position=initial_position)
        self.hardware.prepare()  # nothing compiles once it is armed
        self._replies = Replies()
        self._safety = Safety(model)
        self._faults = FaultMemory(self._safety.rules)
        self.board = DeviceMemory(
            words=flat(np.int64, BOARD_WORDS),
            rules=self._safety.rules,
            heat=self._safety.heat,
            counts=self._safety.counts,
            currents=self._safety.currents,
            ring=self._faults.ring,
            state=flat(np.int64, len(STATE)),
        )
        # A person at the handle holds the switch too.
        self.inputs = 0 if model.operator is None else _HOLD_TO_RUN
        self._keep_truth = keep_truth
        self._epoch_ns = 0
        self._start()

    def _start(self) -> None:
        """Set the memory of the device to its contents after a reset of the microcontroller."""
        self.sample_index = self.time = self._received_at = 0
        self.board.words[OWN.sync_time] = 0
        self._faults.forget()
        self.hardware.reset()
        self.hardware.power_up(self.board.words)
        self._configuration = Configuration(self._dictionary, self._apply)
        self._truth = self.hardware.new_truth() if self._keep_truth else None
        self._copy_protocol_state()
        self._begin_session()

    def _begin_session(self) -> None:
        words, rules = self.board.words, self._safety.rules
        idle(rules, self.time)
        self._safety.forget()
        rules[AT.current] = rules[AT.flags] = 0
        words[OWN.acted] = words[OWN.command_sequence] = words[OWN.command_sync] = 0
        words[OWN.command_index] = -1
        self.sync = self.worst_execution_time = self.missed_ticks = 0

    def _copy_protocol_state(self) -> None:
        """Copy state and session of the protocol to `board.words`, where the ticks read them."""
        words = self.board.words
        words[OWN.protocol_state], words[SESSION] = self.connection.state, self.connection.session

    # ------------------------------------------------------------------ time

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
        return self._epoch_ns + int(self.board.words[DUE]) * _NS_NUMERATOR // _NS_DENOMINATOR

    @property
    def rate(self) -> int:
        """Return the tick rate of the device (Hz)."""
        return int(self.board.words[OWN.rate])

    @property
    def current(self) -> int:
        """Return the active motor current, after all limits (quanta)."""
        return int(self._safety.rules[AT.current])

    # ------------------------------------------------------------------ the tick

    def tick(self) -> bytes:
        """Simulate one period, up to the next sample; return the STATE frame of that sample, or b"" if none is due."""
        # The order is that of a board: current, motion, sample, monitors, report. So a command that arrives between
        # two samples acts at once, without any delay but the plant's own.
        board, words, hardware = self.board, self.board.words, self.hardware
        current = drive(board)
        if words[OWN.found] or words[CUTS]:
            self._act_on_faults_and_cuts()
        hardware.advance(current)
        hardware.sense(words)
        words[COUNT], words[MEASURED] = hardware.count, hardware.measured
        # Before the first edge its age is infinite: the counter has captured nothing since boot, at time 0.
        words[EDGE_AGE] = round(min(hardware.edge_age_s * UNITS_PER_SECOND, words[DUE]))
        sample(board)
        if words[OWN.found]:
            self._act_on_faults_and_cuts()
        if self._truth is not None and words[SESSION]:
            hardware.log(self._truth, words[SAMPLE_INDEX])
        return self.connection.send(m.State(*board.state)) if report(board) else b""

    def run(self, until_ns: int, most: int) -> tuple[bytes, int]:
        """Simulate ticks until the device sends a frame; return the frame (or b"") and the number of ticks.

        No tick is simulated that is due after `until_ns` (ns since the device was created), and at most `most` ticks.
        """
        for ticks in range(most):
            if self.next_tick_ns > until_ns:
                return b"", ticks
            output = self.tick()
            if output:
                return output, ticks + 1
        return b"", most

    def miss(self) -> None:
        """Simulate one period without sending its STATE message, because the caller is late, and count it as missed."""
        self.tick()
        self.missed_ticks += 1

    def _act_on_faults_and_cuts(self) -> None:
        """Enter FAULT if the last part of the tick found a fault, or cut the current if this part requested it."""
        if self.board.words[OWN.found]:
            self._latch(self.board.words[OWN.found])
        elif self.board.words[CUTS]:
            self.hardware.cut()

    def _cut_current(self) -> None:
        self._safety.rules[AT.current] = 0
        self.hardware.cut()

    def _latch(self, faults: int) -> None:
        """Enter the state FAULT; `faults` has a bit ``1 << code`` for each fault."""
        self._faults.latch(faults, self.time)
        self.connection.fault()
        self._copy_protocol_state()
        self._cut_current()

    # ------------------------------------------------------------------ the conversation

    def receive(self, data: bytes, *, received_at: int | None = None) -> bytes:
        """Process bytes from the host, in pieces of any size, and return the device's replies.

        `received_at` is the device time of their arrival (1/16 µs), which a TIME reply contains; by default that of the
        last sample.
        """
        self._received_at = self.time if received_at is None else received_at
        *whole, rest = data.split(b"\0")
        answers = b"".join([self._handle_frame(frame + b"\0") for frame in whole])
        self.connection.receive_data(rest)
        self._copy_protocol_state()
        return answers

    def _handle_frame(self, frame: bytes) -> bytes:
        # One frame at a time, as on a board: the counters in a reply must not include the frames behind the request.
        connection = self.connection
        connection.receive_data(frame)
        answers = b""
        while (event := connection.next_event()) is not None:
            if isinstance(event, Received) and isinstance(event.message, m.Command):
                self._execute_command(event.message, event.sequence)
            else:
                answers += connection.send(self._answer_event(event))
        return answers

    def _execute_command(self, command: m.Command, sequence: int) -> None:
        if command.mode not in MODES:
            self.connection.statistics.malformed += 1
            return
        # A COMMAND that waited in a buffer for longer than its lifetime must not act.
        next_sequence = self.connection.sequence_to_send(m.State)
        if is_too_old(self.board, command.mode, command.lifetime_us, next_sequence, command.state_sequence):
            self.connection.statistics.reordered += 1
            self._safety.rules[AT.flags] |= LimitFlag.COMMAND_TOO_OLD
            return
        obey(self.board, sequence, command.mode, command.flags, command.current, command.lifetime_us)
        if self.board.words[CUTS]:
            self.hardware.cut()

    def _answer_event(self, event: Event) -> Message:
        if self._replies.remembers(event):
            self.connection.resend(event)
        if isinstance(event, Refused):
            return self._replies.answer(event, event.ack)
        handler = self._handlers().get(type(event.message))
        if handler is None:
            return event.ack(Status.UNSUPPORTED)
        return self._replies.answer(event, lambda: handler(event.message, event))

    def _handlers(self) -> dict[type[Message], Callable[[Any, Received], Message]]:
        """Return for each type of request the function that executes the request and returns the reply."""
        return {
            m.Identify: lambda request, _: self._configuration.identity(request, self.connection.state),
            m.GetParameters: lambda request, _: self._configuration.parameters(request),
            m.GetTime: lambda request, _: self._time_reply(request),
            m.GetFaultLog: lambda request, _: self._faults.page(request),
            m.GetStatistics: lambda request, _: self._statistics_reply(request),
            m.GetReference: lambda request, _: self._reference_reply(request),
            m.SetBegin: lambda request, event: self._ack(event, self._configuration.begin(request)),
            m.SetChunk: lambda request, event: self._ack(
                event, self._configuration.chunk(request), request.offset
            ),
            m.SetCommit: lambda request, event: self._ack(event, *self._commit(request)),
            m.Arm: lambda request, event: self._ack(event, *self._arm(request)),
            m.Disarm: lambda _, event: self._ack(event, *self._disarm()),
            m.EnterBootloader: lambda _, event: self._ack(event, Status.UNSUPPORTED),
        }

    def _ack(self, event: Received, status: Status, detail: int = 0) -> m.Ack:
        """Return the ACK of a request: the next sample index and, for SET_COMMIT and ARM, the CRC of the parameters."""
        crc = self._configuration.crc if isinstance(event.message, m.SetCommit | m.Arm) else 0
        return event.ack(status, detail=detail, sample_index=(self.sample_index + 1) & _U32, crc=crc)

    def _time_reply(self, request: m.GetTime) -> m.Time:
        received = self._received_at
        return m.Time(request.nonce, request.host_sent, received, max(received, self.time))

    def _statistics_reply(self, request: m.GetStatistics) -> m.Statistics:
        statistics = self.connection.statistics
        values = {field.name: getattr(statistics, field.name) & _U32 for field in fields(m.Statistics)[1:-1]}
        return m.Statistics(request.nonce, **values, stopped_at=0)

    def _reference_reply(self, request: m.GetReference) -> m.Reference:
        words, configuration = self.board.words, self._configuration
        zero = int(configuration.values["reference"]) + 1 if configuration.homed else 0
        count = int(configuration.values["reference_count"])
        return m.Reference(request.nonce, zero, count, int(words[INDEX_EDGES]), int(words[INDEX_COUNT]))

    def _arm(self, request: m.Arm) -> tuple[Status, int]:
        configuration = self._configuration
        # The order of these refusals is the firmware's: hosts and tests compare the first one.
        if (request.dictionary_hash, request.parameters_crc) != (configuration.hash, configuration.crc):
            return Status.HASH_MISMATCH, 0
        if not configuration.homed:
            return Status.NOT_HOMED, 0
        if not configuration.values["verified"]:
            return Status.NOT_VERIFIED, 0
        fault = self._present_fault()
        if not fault and not is_in_window(self._safety.rules, self.hardware.count):
            fault = Fault.POSITION_WINDOW
        if fault:
            return Status.FAULT_PRESENT, fault
        self._begin_session()
        self.hardware.begin_session()
        return Status.OK, 0

    def _disarm(self) -> tuple[Status, int]:
        # A device without a latched fault may always be disarmed, even with the emergency stop pressed.
        present = self._present_fault() if self.fault else Fault.NONE
        if present:
            return Status.FAULT_PRESENT, present
        self._faults.clear()
        self._cut_current()
        return Status.OK, 0

    def _present_fault(self) -> Fault:
        """Return the fault whose cause is still present (emergency stop, overheating), or NONE."""
        if self.inputs & _EMERGENCY_STOP:
            return Fault.EMERGENCY_STOP
        return Fault.THERMAL if is_overheated(self._safety.heat) else Fault.NONE

    def _commit(self, request: m.SetCommit) -> tuple[Status, int]:
        return self._configuration.commit(request, armed=self._armed)

    @property
    def _armed(self) -> bool:
        state = self.connection.state
        return state is State.RUNNING or state is State.ARMED

    def _apply(self, values: Mapping[str, Value]) -> None:
        """Use new parameters from the next tick on, or raise `ParameterError` and keep the old ones.

        Change nothing while armed: only parameters of a law on the device may change then, and this device has no law.
        """
        if self._armed:
            return
        rate = int(values["position_rate"])
        try:
            self.hardware.set_rate(rate)
        except ConfigError as error:
            parameter_id = BY_NAME["position_rate"].id
            raise ParameterError(Status.INCONSISTENT, error.message, detail=parameter_id) from error
        words = self.board.words
        words[OWN.rate], words[OWN.grid_index], words[OWN.grid_time] = rate, self.sample_index, self.time
        words[DUE] = time_of(words, self.sample_index + 1)
        self._safety.configure(values, self.hardware.count)
        words[OWN.needs_hold] = int(values["hold_to_run"])
        words[OWN.ramp] = int(values["ramp_us"]) * UNITS_PER_US
        words[OWN.command_lifetime] = int(values["command_lifetime_us"]) * UNITS_PER_US
        words[OWN.supervise_lifetime] = int(values["supervise_lifetime_us"]) * UNITS_PER_US

    # ------------------------------------------------------------------ the world

    @property
    def state(self) -> State:
        """Return the device's state, as STATE frames report it."""
        return State(self.connection.state)

    @property
    def fault(self) -> Fault:
        """Return the fault that the device has latched, or NONE."""
        return self._faults.latched

    def press_emergency_stop(self, pressed: bool = True) -> None:
        """Press the emergency stop of the simulated board, or release it."""
        self.inputs = self.inputs | _EMERGENCY_STOP if pressed else self.inputs & ~_EMERGENCY_STOP

    def hold_to_run(self, held: bool) -> None:
        """Hold the hold-to-run switch of the simulated board, or release it."""
        self.inputs = self.inputs | _HOLD_TO_RUN if held else self.inputs & ~_HOLD_TO_RUN

    def sync_input(self, high: bool, at: int | None = None) -> None:
        """Set the level of the sync input; the device stores the time of the last rising edge.

        `at` is the time of the change (1/16 µs since boot), not after the next sample; by default that of the last
        sample.
        """
        if high and not self.inputs & _SYNC_INPUT:
            self.board.words[OWN.sync_time] = self.time if at is None else at
        self.inputs = self.inputs | _SYNC_INPUT if high else self.inputs & ~_SYNC_INPUT

    def inject_fault(self, fault: Fault) -> None:
        """Make the device detect a fault: it sets the effort to zero and latches FAULT."""
        if fault is Fault.ENCODER:
            # Counts were lost: the position is unknown until it is homed again.
            self._configuration.homed = False
        self._latch(1 << fault)

    def reset(self) -> None:
        """Reboot the device: it loses parameters, homing, session and time. The handle moves on without effort."""
        self._epoch_ns = self.elapsed_ns
        self.connection.reset()
        self._replies.forget()
        self._cut_current()
        self._start()

    def truth(self) -> NDArray[np.void]:
        """Return the plant's state in every tick of a session since boot, dtype `rig.core.sample.TRUTH`."""
        return (self._truth or self.hardware.new_truth()).table()
