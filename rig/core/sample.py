"""Columns of a recorded row (sample), which is one tick of the loop.

The table `COLUMNS` defines the dtype of the loop's ring buffer, the schema of the files, and the documentation.
Measured, estimated, wanted, sent and applied quantities are different columns.

If the law runs on the device, a row comes from one sample of a BATCH message (samples of several ticks) and from the
newest STATE message (state of the device) at or before it, at most about 5 ms old. Columns that only a STATE carries
(commands, limits, fault, state, inputs, sync time, missed ticks, execution time) are as old as this STATE.

Units that depend on the motion of the rig are written by quantity (``position``, ``effort``, …) and resolved by
`unit_of`; counts and times are 64-bit integers.

The loop, recordings, verdicts, experiments, sessions, the console and pictures read it. A change of names, order or
types of columns is a new format version: the layout of the ring buffer and of every recording depends on them.
"""

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Literal

import numpy as np

Motion = Literal["rotary", "linear"]

UNITS: dict[str, dict[str, str]] = {
    "position": {"rotary": "rad", "linear": "m"},
    "velocity": {"rotary": "rad/s", "linear": "m/s"},
    "acceleration": {"rotary": "rad/s²", "linear": "m/s²"},
    "effort": {"rotary": "N·m", "linear": "N"},
    "effort/s": {"rotary": "N·m/s", "linear": "N/s"},
    "effort/A": {"rotary": "N·m/A", "linear": "N/A"},
    "stiffness": {"rotary": "N·m/rad", "linear": "N/m"},
    "damping": {"rotary": "N·m·s/rad", "linear": "N·s/m"},
    "inertia": {"rotary": "kg·m²", "linear": "kg"},
}


def unit_of(quantity: str, motion: Motion) -> str:
    """Return the SI unit of a quantity such as "effort" for this motion; return a unit such as "ns" unchanged."""
    return UNITS[quantity][motion] if quantity in UNITS else quantity


@dataclass(frozen=True, slots=True)
class Column:
    """Column of a recorded row: name, numpy dtype, unit (or quantity, see `unit_of`) and meaning."""

    name: str
    dtype: str
    unit: str
    description: str


class Phase(IntEnum):
    """Phase of a run in a tick. The first tick of TRIAL is the person's cue to begin."""

    WAIT = 0
    HOMING = 1
    SETTLE = 2
    TRIAL = 3
    RELEASE = 4
    DONE = 5
    FREE = 6  # between SETTLE and TRIAL: no effort, and the person must not begin yet


HOLD = 7  # reported to observers of a loop instead of TRIAL, from the contact on from which a hold counts
_PHASE_NAMES = {int(phase): phase.name.lower() for phase in Phase} | {HOLD: "hold"}


def phase_name(phase: int) -> str:
    """Return the name of a phase (`Phase` or `HOLD`) in small letters; "unknown" for another number."""
    return _PHASE_NAMES.get(phase, "unknown")


class RowFlag(IntFlag):
    """Bits of the recorded column ``flags``: events in a tick, such as a clipped effort or a lost sample."""

    INSIDE = 1  # penetration > 0
    VELOCITY_UPDATED = 2  # the estimator ran in this tick
    SATURATED = 4  # the guard clipped the effort to its limit
    SLEW_BOUND = 8  # the slew limit bound
    CLAMPED = 16  # the wall would have pulled and was clamped to zero
    LATE = 32  # the tick was late by more than one period
    GAP = 64  # one or more samples before this one never arrived
    NONFINITE = 128  # the law gave a value that is not finite: effort zero, run ended
    OUT_OF_WINDOW = 256  # position left the window or speed exceeded its limit: effort zero, run ended
    HOMING_FAILED = 512  # the start was not reached in time: effort zero, run ended
    ENERGY = 1024  # the motor gave more energy than allowed: effort zero, run ended
    VIOLENT = 2048  # the effort oscillated between zero and its limit: effort zero, run ended
    CURRENT_FOLLOWS = 4096  # a window ended in which the measured current followed the active one
    CURRENT_DIFFERS = 8192  # a window ended in which it did not: effort zero, run ended
    OTHER_CURRENT = 16384  # the active current was not the commanded one, though no limit acted
    UNMOVED = 32768  # an effort that must have moved the rig has moved nothing: effort zero, run ended


COLUMNS: tuple[Column, ...] = (
    Column("tick", "<i8", "1", "number of this step of the law, from 0"),
    Column("sample_index", "<i8", "1", "device's sample index, extended to 64 bits"),
    Column("elapsed_ticks", "<i8", "1", "samples since the previous row; above 1 the ones between were lost"),
    Column("phase", "<i8", "1", "phase of the run (rig.core.sample.Phase)"),
    Column("device_time", "<i8", "ns", "device clock when the sample was taken, extended to 64 bits"),
    Column(
        "lateness",
        "<i8",
        "ns",
        "receipt after the grid of the sample index, against the earliest receipt so far; "
        "host-paced: waking after the host's grid; law on the device: receipt of its batch, for "
        "which the host does not wait",
    ),
    Column("count", "<i8", "count", "encoder count as the device sent it"),
    Column(
        "edge_age",
        "<i8",
        "ns",
        "age of the last encoder edge at the sample; law on the device: 0, not transmitted",
    ),
    Column("position", "<f8", "position", "measured position: count times resolution, from the reference"),
    Column("velocity", "<f8", "velocity", "estimated velocity, held between velocity samples"),
    Column(
        "estimator_window", "<i8", "1", "velocity periods that the last estimate spans: its effective window"
    ),
    Column("penetration", "<f8", "position", "depth inside the wall; negative outside"),
    Column("effort_wall", "<f8", "effort", "reaction of the wall alone"),
    Column("effort_wanted", "<f8", "effort", "sum of all sources before the guard"),
    Column(
        "effort_sent",
        "<f8",
        "effort",
        "effort of the command sent: guarded and rounded to the current quantum; law on the device: what the same law "
        "gives here for the same count; effort_applied of the next row is what the device computed",
    ),
    Column(
        "effort_applied",
        "<f8",
        "effort",
        "active effort on the device when the sample was taken; where a drive renders the wall, the "
        "effort that the drive reports",
    ),
    Column("current_sent", "<i8", "quantum", "current of effort_sent, in current quanta"),
    Column("current_applied", "<i8", "quantum", "active current on the device, in current quanta"),
    Column("current_measured", "<f8", "A", "measured motor current"),
    Column("command_age", "<i8", "1", "age of the active command, in device ticks"),
    Column(
        "command_sequence",
        "<i8",
        "1",
        "sequence number of the command sent in this tick, modulo 65536; law on the device: of the last one sent",
    ),
    Column("command_active", "<i8", "1", "sequence number of the active command at the sample, modulo 65536"),
    Column(
        "parameter_set",
        "<i8",
        "1",
        "active parameters: 0 as the header has them, later sets stand in the trailer",
    ),
    Column(
        "limits",
        "<i8",
        "1",
        "limit flags of the device since the STATE before (firmware_protocol.faults.LimitFlag)",
    ),
    Column("fault", "<i8", "1", "fault code of the device (firmware_protocol.faults.Fault)"),
    Column("device_state", "<i8", "1", "state of the device (firmware_protocol.connection.State)"),
    Column(
        "inputs",
        "<i8",
        "1",
        "pins of the device (firmware_protocol.faults.Input): emergency stop, hold-to-run, sync input, and what the "
        "sync outputs showed in the device's tick that ended with the sample",
    ),
    Column(
        "sync_time",
        "<i8",
        "ns",
        "device clock at the newest reported rising edge of the sync input, on the scale of device_time; 0: none",
    ),
    Column("missed_ticks", "<i8", "1", "device ticks missed since arming"),
    Column("execution_time", "<i8", "ns", "worst execution time of a device tick since arming"),
    Column("flags", "<i8", "1", "events in this tick (rig.core.sample.RowFlag)"),
    Column(
        "sampled_at",
        "<i8",
        "ns",
        "latency ledger: sample taken (host clock, by the clock fit); 0 until fitted",
    ),
    Column(
        "received_at",
        "<i8",
        "ns",
        "latency ledger: sample received (host clock); law on the device: its batch",
    ),
    Column("computed_at", "<i8", "ns", "latency ledger: effort computed (host clock); law on the device: 0"),
    Column(
        "sent_at",
        "<i8",
        "ns",
        "latency ledger: command handed to the link (host clock); law on the device: 0, no command answers a sample",
    ),
    Column(
        "applied_at",
        "<i8",
        "ns",
        "latency ledger: command became active (host clock, by the clock fit); 0 if never seen, and with "
        "the law on the device",
    ),
)

TRUTH_COLUMNS: tuple[Column, ...] = (
    Column("position_true", "<f8", "position", "true position of the sensed side (simulation)"),
    Column("velocity_true", "<f8", "velocity", "true velocity of the sensed side (simulation)"),
    Column("effort_true", "<f8", "effort", "true motor effort after electrical lag (simulation)"),
    Column("handle_position_true", "<f8", "position", "true position of the handle side (simulation)"),
    Column("handle_velocity_true", "<f8", "velocity", "true velocity of the handle side (simulation)"),
)

ROW = np.dtype([(c.name, c.dtype) for c in COLUMNS], align=True)
TRUTH = np.dtype([("sample_index", "<i8"), *((c.name, c.dtype) for c in TRUTH_COLUMNS)], align=True)
