"""Simulate the readable device: a whole rig that speaks the wire protocol, without I/O and without a clock.

The owner of bytes and time (`link` in virtual time, `pty` in real time) calls `receive` and `tick` in turn. It mirrors
the device of PROTOCOL.md but has no law of its own: a command of mode SUPERVISE feeds the watchdog, without current.
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
_EMERGENCY, _HELD, _SYNC = int(Input.EMERGENCY_STOP), int(Input.HOLD_TO_RUN), int(Input.SYNC)
MODES = frozenset(int(mode) for mode in Mode)


class DeviceWord:
    """An attribute that lies in the device's words, where its ticks find it."""

    def __init__(self, place: int) -> None:
        self._place = place

    def __get__(self, device: SimulatedDevice, owner: object = None) -> int:
        return int(device.board.words[self._place])

    def __set__(self, device: SimulatedDevice, value: int) -> None:
        device.board.words[self._place] = value


class SimulatedDevice:
    """A rig behind the wire protocol; `tick` has the order of a tick.

    Parameters
    ----------
    model
        The physics. Its current quantum is the one that the dictionary declares.
    name
        What the device calls itself; the model's name unless given.
    position_rate_maximum, position_rate_default
        Ticks a second (Hz) that it can run at most, and runs until it is configured.
    seed
        Of the current sensor's noise.
    initial_position
        Where the handle rests at power-up (rad or m); unless given, the model's own, else 0.
    keep_truth
        Remember the plant's state of every tick of a session for `truth`.

    Attributes
    ----------
    board
        Its memory, as views for Python.
    connection
        The protocol's end of this device: state, session, statistics.
    hardware
        The physics behind it; `hardware.external_effort` pushes the link.
    inputs
        `Input` bits of the switches and of the sync input that are active.
    sync
        What the sync outputs showed up to the last sample: `Sync` bits, without that of the tick.
    sample_index, time
        Number and device time (1/16 µs since boot) of the last sample.
    worst_execution_time
        Longest tick since arming (1/16 µs), as the owner measured it.
    missed_ticks
        Ticks since arming that had no STATE, as the owner counted them.

    Raises
    ------
    ConfigError
        The default rate is above the maximum, or the model cannot be stepped at it.
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
                remedy="choose a rate that the device can run",
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
        self.inputs = 0 if model.operator is None else _HELD  # a person at the handle holds the switch too
        self._keep_truth = keep_truth
        self._epoch_ns = 0
        self._start()

    def _start(self) -> None:
        """Set what a microcontroller has in its memory, as its reset leaves it."""
        self.sample_index = self.time = self._received_at = 0
        self.board.words[OWN.sync_time] = 0
        self._faults.forget()
        self.hardware.reset()
        self.hardware.power_up(self.board.words)
        self._configuration = Configuration(self._dictionary, self._apply)
        self._truth = self.hardware.new_truth() if self._keep_truth else None
        self._note_protocol()
        self._begin_session()

    def _begin_session(self) -> None:
        words, rules = self.board.words, self._safety.rules
        idle(rules, self.time)
        self._safety.forget()
        rules[AT.current] = rules[AT.flags] = 0
        words[OWN.acted] = words[OWN.command_sequence] = words[OWN.command_sync] = 0
        words[OWN.command_index] = -1
        self.sync = self.worst_execution_time = self.missed_ticks = 0

    def _note_protocol(self) -> None:
        """Let ticks know where the protocol is."""
        words = self.board.words
        words[OWN.protocol_state], words[SESSION] = self.connection.state, self.connection.session

    # ------------------------------------------------------------------ time

    @property
    def time_ns(self) -> int:
        """Device time of the last sample (ns since boot)."""
        return self.time * _NS_NUMERATOR // _NS_DENOMINATOR

    @property
    def elapsed_ns(self) -> int:
        """Return the simulated time since this object was made, over all resets (ns)."""
        return self._epoch_ns + self.time_ns

    @property
    def next_tick_ns(self) -> int:
        """Return when the next sample is due, on the scale of `elapsed_ns` (ns)."""
        return self._epoch_ns + int(self.board.words[DUE]) * _NS_NUMERATOR // _NS_DENOMINATOR

    @property
    def rate(self) -> int:
        """Return the rate of the device's ticks (Hz)."""
        return int(self.board.words[OWN.rate])

    @property
    def current(self) -> int:
        """Return the active current, after all limits (quanta)."""
        return int(self._safety.rules[AT.current])

    # ------------------------------------------------------------------ the tick

    def tick(self) -> bytes:
        """Let one period pass, from sample k − 1 to sample k; return the STATE frame that is due then, or nothing."""
        # The order is that of a board: current, motion, sample, monitors, report. So a command that arrives between
        # two samples acts at once, without any delay but the plant's own.
        board, words, hardware = self.board, self.board.words, self.hardware
        current = drive(board)
        if words[OWN.found] or words[CUTS]:
            self._act_on_findings()
        hardware.advance(current)
        hardware.sense(words)
        words[COUNT], words[MEASURED] = hardware.count, hardware.measured
        # Before the first edge its age is infinite: the counter has captured nothing since boot, at time 0.
        words[EDGE_AGE] = round(min(hardware.edge_age_s * UNITS_PER_SECOND, words[DUE]))
        sample(board)
        if words[OWN.found]:
            self._act_on_findings()
        if self._truth is not None and words[SESSION]:
            hardware.log(self._truth, words[SAMPLE_INDEX])
        return self.connection.send(m.State(*board.state)) if report(board) else b""

    def run(self, until_ns: int, most: int) -> tuple[bytes, int]:
        """Let ticks pass until there is something to say; return that, and how many they were.

        `until_ns` is when the last of them may be due, on the scale of `elapsed_ns`; `most` how many they may be.
        """
        for ticks in range(most):
            if self.next_tick_ns > until_ns:
                return b"", ticks
            output = self.tick()
            if output:
                return output, ticks + 1
        return b"", most

    def miss(self) -> None:
        """Let one period pass whose STATE was not sent, and count it: the owner was late."""
        self.tick()
        self.missed_ticks += 1

    def _act_on_findings(self) -> None:
        """Do what a part of a tick, or a command, asks for: enter FAULT, or pull the amplifier's enable low."""
        if self.board.words[OWN.found]:
            self._latch(self.board.words[OWN.found])
        elif self.board.words[CUTS]:
            self.hardware.cut()

    def _cut(self) -> None:
        """Zero current, regardless of the slew limit."""
        self._safety.rules[AT.current] = 0
        self.hardware.cut()

    def _latch(self, faults: int) -> None:
        """Enter FAULT with bits ``1 << code``."""
        self._faults.latch(faults, self.time)
        self.connection.fault()
        self._note_protocol()
        self._cut()

    # ------------------------------------------------------------------ the conversation

    def receive(self, data: bytes, *, received_at: int | None = None) -> bytes:
        """Take bytes of the host and return the answers; any bytes, in any pieces.

        `received_at` is when they came (device time), for the stamps of TIME; unless given, the last sample's.
        """
        self._received_at = self.time if received_at is None else received_at
        *whole, rest = data.split(b"\0")
        answers = b"".join([self._handle_frame(frame + b"\0") for frame in whole])
        self.connection.receive_data(rest)
        self._note_protocol()
        return answers

    def _handle_frame(self, frame: bytes) -> bytes:
        """Take one frame and answer it before the next is looked at, as a board does: its counters are then right."""
        connection = self.connection
        connection.receive_data(frame)
        answers = b""
        while (event := connection.next_event()) is not None:
            if isinstance(event, Received) and isinstance(event.message, m.Command):
                self._command(event.message, event.sequence)
            else:
                answers += connection.send(self._answer(event))
        return answers

    def _command(self, command: m.Command, sequence: int) -> None:
        if command.mode not in MODES:
            self.connection.statistics.malformed += 1
            return
        # A COMMAND that waited in a buffer for longer than its lifetime must not act.
        to_come = self.connection.sequence_to_send(m.State)
        if is_too_old(self.board, command.mode, command.lifetime_us, to_come, command.state_sequence):
            self.connection.statistics.reordered += 1
            self._safety.rules[AT.flags] |= LimitFlag.COMMAND_TOO_OLD
            return
        obey(self.board, sequence, command.mode, command.flags, command.current, command.lifetime_us)
        if self.board.words[CUTS]:
            self.hardware.cut()

    def _answer(self, event: Event) -> Message:
        if self._replies.remembers(event):
            self.connection.resend(event)
        if isinstance(event, Refused):
            return self._replies.answer(event, event.ack)
        handler = self._handlers().get(type(event.message))
        if handler is None:
            return event.ack(Status.UNSUPPORTED)
        return self._replies.answer(event, lambda: handler(event.message, event))

    def _handlers(self) -> dict[type[Message], Callable[[Any, Received], Message]]:
        """Request → what executes it and makes its answer."""
        return {
            m.Identify: lambda request, _: self._configuration.identity(request, self.connection.state),
            m.GetParameters: lambda request, _: self._configuration.parameters(request),
            m.GetTime: lambda request, _: self._stamps(request),
            m.GetFaultLog: lambda request, _: self._faults.page(request),
            m.GetStatistics: lambda request, _: self._statistics(request),
            m.GetReference: lambda request, _: self._reference(request),
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
        """Return ACK that names the first tick which sees the change, and the active parameters."""
        crc = self._configuration.crc if isinstance(event.message, m.SetCommit | m.Arm) else 0
        return event.ack(status, detail=detail, sample_index=(self.sample_index + 1) & _U32, crc=crc)

    def _stamps(self, request: m.GetTime) -> m.Time:
        received = self._received_at
        return m.Time(request.nonce, request.host_sent, received, max(received, self.time))

    def _statistics(self, request: m.GetStatistics) -> m.Statistics:
        counted = self.connection.statistics
        values = {field.name: getattr(counted, field.name) & _U32 for field in fields(m.Statistics)[1:-1]}
        return m.Statistics(request.nonce, **values, stopped_at=0)

    def _reference(self, request: m.GetReference) -> m.Reference:
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
        present = self._present_fault()
        if not present and not is_in_window(self._safety.rules, self.hardware.count):
            present = Fault.POSITION_WINDOW
        if present:
            return Status.FAULT_PRESENT, present
        self._begin_session()
        self.hardware.begin_session()
        return Status.OK, 0

    def _disarm(self) -> tuple[Status, int]:
        # A device without a latched fault may always be disarmed, even with the emergency stop pressed.
        present = self._present_fault() if self.fault else Fault.NONE
        if present:
            return Status.FAULT_PRESENT, present
        self._faults.clear()
        self._cut()
        return Status.OK, 0

    def _present_fault(self) -> Fault:
        """Return the cause of a fault that is there now and will not go by itself when the effort is zero."""
        if self.inputs & _EMERGENCY:
            return Fault.EMERGENCY_STOP
        return Fault.THERMAL if is_overheated(self._safety.heat) else Fault.NONE

    def _commit(self, request: m.SetCommit) -> tuple[Status, int]:
        return self._configuration.commit(request, armed=self._armed)

    @property
    def _armed(self) -> bool:
        state = self.connection.state
        return state is State.RUNNING or state is State.ARMED

    def _apply(self, values: Mapping[str, Value]) -> None:
        """Run under new parameters from the next tick on, or raise `ParameterError` and continue as before.

        Only parameters of a law on the device may change while it is armed, and this device has no such law.
        """
        if self._armed:
            return
        rate = int(values["position_rate"])
        try:
            self.hardware.set_rate(rate)
        except ConfigError as error:
            number = BY_NAME["position_rate"].id
            raise ParameterError(Status.INCONSISTENT, error.message, detail=number) from error
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
        """Return the protocol's state, as STATE reports it."""
        return State(self.connection.state)

    @property
    def fault(self) -> Fault:
        """Return the fault that is latched, or NONE."""
        return self._faults.latched

    def press_emergency_stop(self, pressed: bool = True) -> None:
        """Press the emergency stop, or release it."""
        self.inputs = self.inputs | _EMERGENCY if pressed else self.inputs & ~_EMERGENCY

    def hold_to_run(self, held: bool) -> None:
        """Hold the hold-to-run switch, or let it go."""
        self.inputs = self.inputs | _HELD if held else self.inputs & ~_HELD

    def sync_input(self, high: bool, at: int | None = None) -> None:
        """Put a level on the sync input; the device keeps the time at which it rose.

        `at` is when (device time, 1/16 µs since boot), which the next sample must not be before; unless given, the
        last sample's time.
        """
        if high and not self.inputs & _SYNC:
            self.board.words[OWN.sync_time] = self.time if at is None else at
        self.inputs = self.inputs | _SYNC if high else self.inputs & ~_SYNC

    def inject_fault(self, fault: Fault) -> None:
        """Let the device find a fault: zero effort from here on, FAULT latched."""
        if fault is Fault.ENCODER:
            # Counts were lost: the position is unknown until it is homed again.
            self._configuration.homed = False
        self._latch(1 << fault)

    def reset(self) -> None:
        """Reboot: parameters, homing, session and time are gone; the handle moves on without effort."""
        self._epoch_ns = self.elapsed_ns
        self.connection.reset()
        self._replies.forget()
        self._cut()
        self._start()

    def truth(self) -> NDArray[np.void]:
        """Return the plant's state in every tick of a session since boot, dtype `rig.core.sample.TRUTH`."""
        return (self._truth or self.hardware.new_truth()).table()
