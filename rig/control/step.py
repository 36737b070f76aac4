"""Run the whole controller for one tick. All code that renders a wall calls `step` and no other function.

The order of one tick is normative:

1. the count is converted to a position, and the watch (`rig.control._watch`) checks the energy and the motion that
   the effort of the previous tick caused;
2. penetration = side · (position − wall), the handle is inside the wall if it is above zero; no half-count correction;
3. when the sample index enters a new velocity period, the estimator runs, inside and outside the wall, with
   the mean effort since its last run;
4. the law gives the wall's reaction from this tick's penetration and the velocity held since the last velocity sample;
5. the constant effort or the homing servo is added;
6. the guard (`rig.control._guard`) limits the sum once;
7. the result is rounded to whole current quanta of the wire protocol;
8. the caller sends the current to the device.

`rig.config.controller` fills the arguments of `step`; the loop, simulated devices and replays call it. Compiled code
here must not allocate, wait or read a clock, and the order must not change: a device runs the same law in firmware/law,
and an old recording has to replay to the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.control import _guard as guard
from rig.control import _passivity as passivity
from rig.control import _sources as sources
from rig.control import _watch as watch
from rig.control import laws
from rig.control._watch import TRAVEL, TRAVEL_COUNTS, UNMOVED_COUNTS, UNMOVED_SPEED
from rig.control.estimators._family import get as get_estimator
from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import WINDOW, Prepared
from rig.control.law import Law, PreparedLaw
from rig.core.errors import RecordingError
from rig.core.sample import HOLD, Phase, RowFlag
from rig.realtime.groups import Floats, Ints, group, type_of
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_CLAMPED, EstimatorPlug, LawPlug

__all__ = [
    "CLAMPED",
    "CONTROL",
    "CONTROLLER_TYPE",
    "CONTROL_TYPE",
    "DONE",
    "ENDS_RUN",
    "ENERGY",
    "FREE",
    "HOMING",
    "HOMING_FAILED",
    "INSIDE",
    "MEMORY",
    "MEMORY_TYPE",
    "NONFINITE",
    "OUT_OF_WINDOW",
    "RELEASE",
    "SATURATED",
    "SETTLE",
    "SLEW_BOUND",
    "THROWN_OUT",
    "TRAVEL",
    "TRAVEL_COUNTS",
    "TRIAL",
    "UNMOVED",
    "UNMOVED_COUNTS",
    "UNMOVED_SPEED",
    "VELOCITY_UPDATED",
    "VIOLENT",
    "WAIT",
    "ControllerArguments",
    "ControllerState",
    "Record",
    "advance_phase",
    "count_difference",
    "new_memory",
    "shown_phase",
    "step",
]

# Length-1 structured arrays and not dataclasses: fields have the same names in compiled code and in plain Python.
CONTROL = np.dtype(
    [
        # Travel for one count (rad or m), negative if counts fall with rising position.
        ("resolution", "<f8"),
        ("reference_count", "<i8"),  # count at position zero
        ("tick_s", "<f8"),  # T1, time of one tick
        ("velocity_divider", "<i8"),  # N = T2/T1, ticks of a velocity period
        ("extrapolate", "<i8"),  # 1: first-order prediction between velocity samples, 0: hold
        ("slow_multiple", "<i8"),  # velocity periods between samples of a slow handle; 1: always every period
        ("slow_speed", "<f8"),  # speed below which a handle is slow (rad/s or m/s)
        ("wall_position", "<f8"),
        ("wall_side", "<f8"),  # +1: the wall is entered with rising position
        # 1 + index of the estimated position in the estimator's floats; 0: use the position of the encoder
        ("position_state", "<i8"),
        ("passive_damping", "<f8"),  # largest damping of the passivity controller; 0: none
        ("effort_limit", "<f8"),  # of all efforts together (N·m or N)
        ("effort_quantum", "<f8"),  # effort of one current quantum
        ("trial_slew", "<f8"),  # effort per tick in trial and release: binding spoils the trial
        ("homing_slew", "<f8"),  # effort per tick while homing
        ("window_minimum", "<f8"),  # a position outside of this window, or a higher speed, ends the run
        ("window_maximum", "<f8"),
        ("speed_limit", "<f8"),
        ("home_target", "<f8"),  # position at which a trial starts (rad or m)
        ("home_step", "<f8"),  # set-point travel per tick
        ("home_stiffness", "<f8"),
        ("home_damping", "<f8"),
        ("home_effort", "<f8"),  # largest effort of the homing servo (N·m or N)
        ("home_tolerance", "<f8"),  # distance from the target within which homing is complete (rad or m)
        ("settle_ticks", "<i8"),  # that the handle must rest there
        ("home_timeout_ticks", "<i8"),
        ("free_ticks", "<i8"),  # of free space before the trial; 0: none
        # Leaving this range before the trial is a false start: the run ends without a trial.
        ("free_minimum", "<f8"),
        ("free_maximum", "<f8"),
        ("constant_effort", "<f8"),
        ("trial_ticks", "<i8"),  # length of a trial; with hold_ticks, only of a trial without a contact
        ("hold_ticks", "<i8"),  # from the first contact to the end; 0: contact or not, trial_ticks
        ("release_ticks", "<i8"),
        ("energy_limit", "<f8"),  # that the motor may give in a trial (J); 0: any
        ("oscillation_limit", "<i8"),  # oscillations of effort in a row that end the run; 0: any
        ("oscillation_ticks", "<i8"),  # within which the next one is in a row
        # Travel of the handle below which an oscillation is ignored (rad or m).
        ("oscillation_travel", "<f8"),
        ("held_effort", "<f8"),  # largest effort that friction and weight hold without motion
        # Impulse of larger efforts that, without motion, ends the run (N·m·s or N·s); 0: any.
        ("impulse_limit", "<f8"),
    ],
    align=True,
)

MEMORY = np.dtype(
    [
        ("index", "<i8"),  # law's own sample index, from 0
        ("velocity_period", "<i8"),  # index // N at the last run of the estimator
        ("phase", "<i8"),  # rig.core.sample.Phase
        ("phase_ticks", "<i8"),  # ticks in this phase
        ("rest_ticks", "<i8"),  # ticks within the homing tolerance
        ("contact_ticks", "<i8"),  # ticks of the trial before the first contact; 0: none yet
        ("setpoint", "<f8"),  # of the homing servo
        # input of the law: held since the last velocity sample, or extrapolated from it
        ("velocity", "<f8"),
        ("velocity_sampled", "<f8"),  # the estimate itself
        ("velocity_slope", "<f8"),  # its change per tick between the last two samples
        ("velocity_ticks", "<i8"),  # ticks since the last velocity sample
        ("active_sum", "<i8"),  # current active in each of these ticks, added up (quanta)
        ("window", "<i8"),  # velocity periods that the estimate spans
        ("limited_effort", "<f8"),  # last effort before rounding, from which the slew limit starts
        ("energy", "<f8"),  # that the motor has given in the trial (J)
        ("wall_energy", "<f8"),  # of it what the wall gave (J)
        ("oscillations", "<i8"),  # of the effort, in a row
        ("oscillation_age", "<i8"),  # ticks since the last one
        ("oscillation_armed", "<i8"),  # 1: the effort has been next to zero since then
        ("oscillation_lowest", "<f8"),  # extreme positions since then
        ("oscillation_highest", "<f8"),
        ("unmoved_low", "<i8"),  # the lower of the two counts on which the handle stands
        ("impulse", "<f8"),  # momentum that a free handle would have by now (N·m·s or N·s)
        # values of this tick for the recorded row
        ("position", "<f8"),
        ("penetration", "<f8"),
        ("effort_wall", "<f8"),
        ("effort_wanted", "<f8"),
        ("effort_sent", "<f8"),
        ("current_sent", "<i8"),
        ("flags", "<i8"),
    ],
    align=True,
)

CONTROL_TYPE = types.Array(numba.from_dtype(CONTROL), 1, "C")
MEMORY_TYPE = types.Array(numba.from_dtype(MEMORY), 1, "C")


@group
class ControllerArguments(NamedTuple):
    """Settings and memory of a controller as one argument of compiled code (`step`).

    Attributes
    ----------
    estimator, law
        Compiled functions of the velocity estimator and the force law (`rig.realtime.plugs`).
    control, memory
        Settings (dtype `CONTROL`) and memory (dtype `MEMORY`), arrays of length 1. `step` changes `memory`, from which
        the recorded values of the tick are taken too.
    estimator_f, estimator_i, estimator_parameters
        Memory (floats, integers) and parameters of the estimator.
    law_state, law_parameters
        Memory and parameters of the law.
    """

    estimator: EstimatorPlug
    law: LawPlug
    control: Annotated[NDArray[np.void], CONTROL_TYPE]
    memory: Annotated[NDArray[np.void], MEMORY_TYPE]
    estimator_f: Floats
    estimator_i: Ints
    estimator_parameters: Floats
    law_state: Floats
    law_parameters: Floats


CONTROLLER_TYPE = type_of(ControllerArguments)

# Plain integers: numba reads an enum member of another module as a global constant only when it is one.
WAIT, HOMING, SETTLE = int(Phase.WAIT), int(Phase.HOMING), int(Phase.SETTLE)
FREE, TRIAL, RELEASE, DONE = int(Phase.FREE), int(Phase.TRIAL), int(Phase.RELEASE), int(Phase.DONE)
INSIDE, VELOCITY_UPDATED = int(RowFlag.INSIDE), int(RowFlag.VELOCITY_UPDATED)
SATURATED, SLEW_BOUND, CLAMPED = int(RowFlag.SATURATED), int(RowFlag.SLEW_BOUND), int(RowFlag.CLAMPED)
NONFINITE, OUT_OF_WINDOW = int(RowFlag.NONFINITE), int(RowFlag.OUT_OF_WINDOW)
HOMING_FAILED, UNMOVED = int(RowFlag.HOMING_FAILED), int(RowFlag.UNMOVED)
ENERGY, VIOLENT = int(RowFlag.ENERGY), int(RowFlag.VIOLENT)
THROWN_OUT = OUT_OF_WINDOW | ENERGY | VIOLENT  # after contact that is what the wall did
ENDS_RUN = NONFINITE | HOMING_FAILED | UNMOVED | THROWN_OUT

Record = NDArray[np.void]


def new_memory() -> Record:
    """Return a controller's memory before its first sample; the first sample will have the index 0."""
    memory = np.zeros(1, dtype=MEMORY)
    memory["index"] = -1
    memory["velocity_period"] = -1
    return memory


@dataclass(frozen=True, slots=True)
class ControllerState:
    """Settings and memory of a controller, with its estimator and its law: all that `step` needs except the sample."""

    control: Record
    memory: Record
    estimator: Prepared
    law: PreparedLaw

    def arguments(self) -> ControllerArguments:
        """Return the controller as an argument of `step`, which changes the arrays of this object."""
        e, w = self.estimator, self.law
        return ControllerArguments(
            estimator=e.estimator.update,
            law=w.law.function,
            control=self.control,
            memory=self.memory,
            estimator_f=e.state_f,
            estimator_i=e.state_i,
            estimator_parameters=e.parameters,
            law_state=w.state,
            law_parameters=w.parameters,
        )

    def copy(self) -> ControllerState:
        """Return an independent copy of the controller: a run with the copy does not change this object."""
        e, w = self.estimator, self.law
        return ControllerState(
            control=self.control.copy(),
            memory=self.memory.copy(),
            estimator=Prepared(e.estimator, e.parameters.copy(), e.state_f.copy(), e.state_i.copy()),
            law=PreparedLaw(w.law, w.parameters.copy(), w.state.copy()),
        )

    def fresh(self, wall: Mapping[str, Any]) -> ControllerState:
        """Return a copy of the controller for another wall (settings by name); only the force law starts anew."""
        settings = {**wall, "tick_s": float(self.control[0]["tick_s"])}
        return replace(self.copy(), law=self.law.law.prepare(settings))

    def as_mapping(self) -> dict[str, Any]:
        """Return the controller as numbers and names for JSON; `from_mapping` restores every bit of it."""
        return {
            "control": dict(zip(CONTROL.names or (), self.control[0].tolist(), strict=True)),
            "memory": dict(zip(MEMORY.names or (), self.memory[0].tolist(), strict=True)),
            "estimator": {
                "name": self.estimator.estimator.name,
                "parameters": self.estimator.parameters.tolist(),
                "state_f": self.estimator.state_f.tolist(),
                "state_i": self.estimator.state_i.tolist(),
            },
            "law": {
                "name": self.law.law.name,
                "parameters": self.law.parameters.tolist(),
                "state": self.law.state.tolist(),
            },
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], *, law: Law | None = None) -> ControllerState:
        """Return the controller from a dictionary that `as_mapping` made; `law` replaces the force law that it names.

        Raises `rig.core.errors.ConfigError` if the estimator or the law is unknown, and `RecordingError` if a setting
        or a number of the memory is missing or unknown, or an array has a wrong size.
        """
        try:
            estimator, wall = mapping["estimator"], mapping["law"]
            made = cls(
                control=_record(CONTROL, mapping["control"]),
                memory=_record(MEMORY, mapping["memory"]),
                estimator=Prepared(
                    get_estimator(estimator["name"]),
                    np.array(estimator["parameters"], dtype=np.float64),
                    np.array(estimator["state_f"], dtype=np.float64),
                    np.array(estimator["state_i"], dtype=np.int64),
                ),
                law=PreparedLaw(
                    law or laws.get(wall["name"]),
                    np.array(wall["parameters"], dtype=np.float64),
                    np.array(wall["state"], dtype=np.float64),
                ),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise _version_error(f"reading the fields of the state fails with {error!r}") from error
        # Compiled code checks no sizes.
        if not made.estimator.fits() or not made.law.fits():
            raise _version_error(
                "parameters or memory of the estimator or the force law have a different size"
            )
        return made


def _version_error(how: str) -> RecordingError:
    return RecordingError(
        f"the saved state of the controller was written by another version of haptic-rig: {how}",
        remedy="replay the recording with the version that its header names",
    )


def _record(dtype: np.dtype[Any], values: Mapping[str, Any]) -> Record:
    differing = set(dtype.names or ()) ^ set(values)
    # A field left at zero would change the controller.
    if differing:
        raise _version_error(f"only one of the versions has the fields {', '.join(sorted(differing))}")
    record = np.zeros(1, dtype=dtype)
    for name, value in values.items():
        record[name] = value
    return record


@kernel(types.void(MEMORY_TYPE, types.int64), inline=True)
def _enter(memory: Any, phase: int) -> None:
    memory[0]["phase"] = phase
    memory[0]["phase_ticks"] = 0


@kernel(types.int64(CONTROL_TYPE, MEMORY_TYPE), inline=True)
def _trial_end(control: Any, memory: Any) -> int:
    c, m = control[0], memory[0]
    # The hold begins at the contact, not at the cue: a person comes into contact when it pleases.
    if c["hold_ticks"] > 0 and m["contact_ticks"] == 0 and m["penetration"] > 0.0:
        m["contact_ticks"] = m["phase_ticks"]
    return int(m["contact_ticks"] + c["hold_ticks"] if m["contact_ticks"] > 0 else c["trial_ticks"])


@kernel(types.int64(MEMORY_TYPE), inline=True)
def shown_phase(memory: Any) -> int:
    """Return the phase of the run for display: HOLD after the first contact of a trial, else the actual phase."""
    m = memory[0]
    return int(HOLD if m["phase"] == TRIAL and m["contact_ticks"] > 0 else m["phase"])


@kernel(types.void(CONTROL_TYPE, MEMORY_TYPE, types.int64), inline=True)
def advance_phase(control: Any, memory: Any, elapsed_ticks: int) -> None:
    """Count the elapsed ticks, and start the next phase of the run when the present one is over.

    The phases are homing, settling at the start, waiting in free space, trial, release, done.
    """
    c, m = control[0], memory[0]
    phase = m["phase"]
    m["phase_ticks"] += elapsed_ticks
    if phase == WAIT:
        m["setpoint"] = m["position"]
        _enter(memory, HOMING)
    elif phase in (HOMING, SETTLE):
        off_target = abs(m["position"] - c["home_target"]) > c["home_tolerance"]
        if off_target or m["setpoint"] != c["home_target"]:
            m["rest_ticks"] = 0
            m["phase"] = HOMING
        else:
            m["rest_ticks"] += elapsed_ticks
            m["phase"] = SETTLE
        if m["phase"] == SETTLE and m["rest_ticks"] >= c["settle_ticks"]:
            _enter(memory, FREE if c["free_ticks"] > 0 else TRIAL)
        elif m["phase_ticks"] > c["home_timeout_ticks"]:
            m["flags"] |= HOMING_FAILED
            _enter(memory, DONE)
    elif phase == FREE:
        if not c["free_minimum"] <= m["position"] <= c["free_maximum"]:
            _enter(memory, DONE)
        elif m["phase_ticks"] >= c["free_ticks"]:
            _enter(memory, TRIAL)
    elif phase == TRIAL and m["phase_ticks"] >= _trial_end(control, memory):
        _enter(memory, RELEASE)
    elif phase == RELEASE and m["phase_ticks"] >= c["release_ticks"]:
        _enter(memory, DONE)


@kernel(types.float64(CONTROL_TYPE, MEMORY_TYPE, types.int64), inline=True)
def _sources(control: Any, memory: Any, elapsed_ticks: int) -> float:
    """Return the sum of all efforts of this tick (N·m or N), including the wall's, before any limit."""
    c, m = control[0], memory[0]
    phase = m["phase"]
    if phase in (HOMING, SETTLE):
        m["setpoint"] = sources.approach(m["setpoint"], c["home_target"], c["home_step"] * elapsed_ticks)
        return sources.servo(
            m["setpoint"] - m["position"],
            m["velocity"],
            c["home_stiffness"],
            c["home_damping"],
            c["home_effort"],
        )
    total = c["constant_effort"] - c["wall_side"] * m["effort_wall"]
    if phase == TRIAL:
        return float(total)
    if phase == RELEASE and m["phase_ticks"] < c["release_ticks"]:
        return float(total * (1.0 - m["phase_ticks"] / c["release_ticks"]))
    return 0.0


@kernel(
    types.void(CONTROL_TYPE, MEMORY_TYPE, types.float64, types.float64, types.int64, types.int64), inline=True
)
def _watch_effort(
    control: Any,
    memory: Any,
    position: float,
    penetration: float,
    elapsed_ticks: int,
    current_active: int,
) -> None:
    """Set the flag ENERGY if the motor has given too much energy, and VIOLENT if its effort oscillates violently.

    `memory` must still contain effort and position of the previous tick.
    """
    c, m = control[0], memory[0]
    if m["phase"] not in (TRIAL, RELEASE):
        return
    m["energy"] = watch.add_energy(
        m["energy"], m["effort_sent"], position - m["position"], penetration <= 0.0
    )
    if c["passive_damping"] > 0.0:
        # The push of an automated trial is a source of its own, and no fault of the wall.
        m["wall_energy"] = watch.add_energy(
            m["wall_energy"],
            c["effort_quantum"] * current_active - c["constant_effort"],
            position - m["position"],
            penetration <= 0.0,
        )
    if c["energy_limit"] > 0.0 and m["energy"] > c["energy_limit"]:
        m["flags"] |= ENERGY
    if c["oscillation_limit"] == 0:
        return
    if m["phase"] == TRIAL and m["phase_ticks"] == 0:
        m["oscillation_lowest"] = m["oscillation_highest"] = m["position"]
    m["oscillation_lowest"] = min(m["oscillation_lowest"], position)
    m["oscillation_highest"] = max(m["oscillation_highest"], position)
    m["oscillation_age"] += elapsed_ticks
    extreme = watch.extreme(
        -c["wall_side"] * m["effort_sent"],
        c["effort_limit"],
        m["oscillation_lowest"],
        m["oscillation_highest"],
        c["oscillation_travel"],
    )
    if extreme < 0:
        m["oscillation_armed"] = 1
    elif extreme > 0 and m["oscillation_armed"] == 1:
        m["oscillations"] = 1 + (m["oscillations"] if m["oscillation_age"] <= c["oscillation_ticks"] else 0)
        m["oscillation_age"] = m["oscillation_armed"] = 0
        m["oscillation_lowest"] = m["oscillation_highest"] = position
        if m["oscillations"] >= c["oscillation_limit"]:
            m["flags"] |= VIOLENT


@kernel(types.void(CONTROL_TYPE, MEMORY_TYPE, types.int64, types.int64), inline=True)
def _watch_standstill(control: Any, memory: Any, count: int, slewed: int) -> None:
    """Set the flag UNMOVED if the effort must have moved the handle, but its count toggles by one at most."""
    c, m = control[0], memory[0]
    # One tick of impulse for each sample, however many were lost before: there the command may not have arrived.
    if c["impulse_limit"] == 0.0:
        return
    away = count_difference(count, m["unmoved_low"])
    # Two neighbouring counts: a dead channel of a quadrature encoder toggles between them however far the handle moves.
    if not 0 <= away <= 1:
        m["unmoved_low"] = count if away < 0 else count - 1
        m["impulse"] = 0.0
        return
    if m["phase"] in (HOMING, SETTLE):
        effort = m["effort_sent"]
    elif m["phase"] == TRIAL and m["penetration"] <= 0.0 and slewed == 0:
        # In the wall the reaction cancels the push and a handle may rest; while the slew limit acts, less is applied.
        effort = c["constant_effort"]
    else:
        return
    m["impulse"] = watch.free_impulse(m["impulse"], effort, c["held_effort"], c["tick_s"])
    if abs(m["impulse"]) > c["impulse_limit"]:
        m["flags"] |= UNMOVED


@kernel(types.int64(CONTROL_TYPE, MEMORY_TYPE, types.float64, types.int64), inline=True)
def _guard_effort(control: Any, memory: Any, wanted: float, elapsed_ticks: int) -> int:
    """Limit the effort `wanted` and its slew rate; return it as a current (quanta, rounded; 0 if the run ends).

    Where they apply, set the flags NONFINITE, OUT_OF_WINDOW, SATURATED (effort limit) and SLEW_BOUND (slew limit).
    """
    c, m = control[0], memory[0]
    if not math.isfinite(wanted) or not math.isfinite(m["velocity"]):
        m["flags"] |= NONFINITE
    if (
        not c["window_minimum"] <= m["position"] <= c["window_maximum"]
        or abs(m["velocity"]) > c["speed_limit"]
    ):
        m["flags"] |= OUT_OF_WINDOW
    # Zero at once and not down the slew limit: after a wrong position or velocity any effort may be the wrong one.
    if m["flags"] & ENDS_RUN:
        _enter(memory, DONE)
        m["limited_effort"] = 0.0
        m["effort_sent"] = 0.0
        m["current_sent"] = 0
        return 0
    effort = wanted
    # Branches and not min/max: they predict well, while the next step would wait for a clip that seldom acts.
    if abs(effort) > c["effort_limit"]:
        effort = guard.clip_effort(effort, c["effort_limit"])
        m["flags"] |= SATURATED
    slew = elapsed_ticks * (c["homing_slew"] if m["phase"] in (HOMING, SETTLE) else c["trial_slew"])
    if not m["limited_effort"] - slew <= effort <= m["limited_effort"] + slew:
        effort = guard.limit_slew(effort, m["limited_effort"], slew)
        m["flags"] |= SLEW_BOUND
    # The slew limit starts from the value before rounding, or small steps would be lost to the quantum for ever.
    m["limited_effort"] = effort
    quanta = guard.current_quanta(effort, c["effort_quantum"])
    m["effort_sent"] = quanta * c["effort_quantum"]
    m["current_sent"] = int(quanta)
    return int(quanta)


@kernel(types.int64(CONTROLLER_TYPE, types.int64, types.float64, types.int64, types.int64), inline=True)
def step(
    controller: ControllerArguments, count: int, edge_age_s: float, elapsed_ticks: int, current_active: int
) -> int:
    """Run the controller for one new sample and return the current to command (quanta).

    Parameters
    ----------
    controller
        Settings and memory of the controller, its estimator and its law.
    count
        Encoder count of this sample.
    edge_age_s
        Age of the last encoder edge at the sample (s).
    elapsed_ticks
        Samples since the previous call, 1 when none was lost.
    current_active
        Current that was active on the device when the sample was taken (quanta). It is used for all elapsed ticks.

    Returns
    -------
    int
        The current to command, in quanta of the wire protocol.

    Source: Koul et al., section II and Fig. 2, for the two rates; the order (module docstring) is defined by this
    project.
    """
    control, memory = controller.control, controller.memory
    c, m = control[0], memory[0]
    slewed = m["flags"] & SLEW_BOUND
    m["flags"] = 0
    m["index"] += elapsed_ticks
    position = c["resolution"] * count_difference(count, c["reference_count"])
    m["penetration"] = c["wall_side"] * (position - c["wall_position"])
    _watch_effort(control, memory, position, m["penetration"], elapsed_ticks, current_active)
    _watch_standstill(control, memory, count, slewed)
    m["position"] = position
    if m["penetration"] > 0.0:
        m["flags"] |= INSIDE

    m["velocity_ticks"] += elapsed_ticks
    m["active_sum"] += current_active * elapsed_ticks
    slow = abs(m["velocity_sampled"]) < c["slow_speed"] and m["velocity_period"] >= 0
    # The estimator runs outside the wall too: resetting it there changes the first peak by a fifth.
    due_period = m["velocity_period"] + (c["slow_multiple"] if slow else 1)
    if m["index"] >= due_period * c["velocity_divider"]:
        # From the index and not from a counter of calls: after lost samples the period's grid stays where it was.
        elapsed_periods = m["index"] // c["velocity_divider"] - m["velocity_period"]
        m["velocity_period"] += elapsed_periods
        sampled = controller.estimator(
            count,
            edge_age_s,
            elapsed_periods,
            c["effort_quantum"] * (m["active_sum"] / m["velocity_ticks"]),
            controller.estimator_f,
            controller.estimator_i,
            controller.estimator_parameters,
        )
        m["velocity_slope"] = (sampled - m["velocity_sampled"]) / m["velocity_ticks"]
        m["velocity_sampled"] = sampled
        m["velocity_ticks"] = 0
        m["active_sum"] = 0
        m["window"] = controller.estimator_i[WINDOW]
        m["flags"] |= VELOCITY_UPDATED
    m["velocity"] = m["velocity_sampled"]
    if c["extrapolate"] != 0:
        m["velocity"] += m["velocity_slope"] * m["velocity_ticks"]

    advance_phase(control, memory, elapsed_ticks)
    m["effort_wall"] = 0.0
    if m["phase"] in (TRIAL, RELEASE):
        depth, inwards = m["penetration"], c["wall_side"] * m["velocity"]
        if c["position_state"] > 0:
            depth += c["wall_side"] * c["resolution"] * controller.estimator_f[c["position_state"] - 1]
        m["effort_wall"] = controller.law(
            depth,
            inwards,
            elapsed_ticks,
            controller.law_state,
            controller.law_parameters,
        )
        if controller.law_state[LAW_CLAMPED] != 0.0:
            m["flags"] |= CLAMPED
        if c["passive_damping"] > 0.0 and m["phase"] == TRIAL and depth > 0.0:
            m["effort_wall"] = passivity.add_damping(
                m["effort_wall"], m["wall_energy"], inwards, c["passive_damping"], c["tick_s"]
            )
    m["effort_wanted"] = _sources(control, memory, elapsed_ticks)
    return _guard_effort(control, memory, m["effort_wanted"], elapsed_ticks)
