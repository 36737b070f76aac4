"""Define the keys of an experiment file: one dataclass for each section; annotations give range, unit and meaning.

The validator, the error messages, the listing of a plan and the schema for editors read these annotations (see
`rig.config._table`). Rules between several keys are in `rig.config._rules`. `rig.core.model` has the sections about the
physics of the rig.

Positions, efforts and stiffnesses are at the link, in SI units, which depend on ``rig.motion``
(`rig.core.sample.unit_of`). Recordings contain an experiment: a renamed key makes older recordings unreadable.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt, MinLen

from rig.core.model import Amplifier, Cogging, Encoder, Mechanics, Operator, Reference, Simulation
from rig.core.operators import GRIPS
from rig.core.present import Item, Row, Table
from rig.core.quantity import STRICT, Quantity
from rig.core.sample import Motion, unit_of
from rig.core.shown import Shown

# Defaults of the watch on violent walls (`rig.control._watch`), beside no compiled code: who reads an experiment loads
# no kernels. So many oscillations in a row end a run, each within this time of the one before (s).
OSCILLATIONS, OSCILLATION_S = 10, 0.02

Setting = bool | int | float | str


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """Section ``[rig.limits]``: limits of effort, speed, position and energy, checked in each tick."""

    nominal_effort: Annotated[
        float, Gt(0), Quantity("effort", "continuous effort of the motor, without overheating")
    ]
    effort: Annotated[
        float, Gt(0), Quantity("effort", "every command is clipped to ± this; left out: nominal_effort")
    ]
    thermal_time_constant_s: Annotated[
        float, Gt(0), Le(10_000), Quantity("s", "thermal time constant of the motor's winding")
    ]
    speed: Annotated[float, Gt(0), Quantity("velocity", "speed above which the run ends")]
    slew: Annotated[
        float,
        Gt(0),
        Quantity(
            "effort/s", "fastest change of effort in a trial; a trial in which this limit acts is invalid"
        ),
    ]
    position_minimum: Annotated[
        float, Quantity("position", "lower end of the window; leaving it ends the run")
    ]
    position_maximum: Annotated[
        float, Quantity("position", "upper end of the window; leaving it ends the run")
    ]
    energy: Annotated[
        float | None,
        Gt(0),
        Quantity(
            "J",
            "largest energy that the motor may give the handle in a trial, which ends beyond it; "
            "left out: no limit",
        ),
    ] = None
    oscillations: Annotated[
        int | None,
        Ge(0),
        Le(1000),
        Quantity(
            "",
            "number of successive oscillations of the effort, from zero to its limit with the handle "
            f"moving, that end the run; 0: never; left out: {OSCILLATIONS} in a person's trial (human "
            "= true), else never",
        ),
    ] = None
    oscillation_s: Annotated[
        float,
        Gt(0),
        Le(1),
        Quantity("s", "longest time between two successive oscillations"),
    ] = OSCILLATION_S
    human: Annotated[
        bool,
        Quantity(
            "",
            "a person holds the handle, so the effort must not exceed nominal_effort; trial.kind = "
            '"human" sets it; false beside that kind is refused on a real rig',
        ),
    ] = True
    override_stall: Annotated[
        bool, Quantity("", "let effort exceed nominal_effort although a person holds the handle")
    ] = False

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Rig:
    """Section ``[rig]``: the machine, with its physics and its limits."""

    name: Annotated[str, MinLen(1), Quantity("", "short name, written into recordings")]
    motion: Annotated[Motion, Quantity("", "decides the units: rad and N·m, or m and N")]
    mechanics: Mechanics
    amplifier: Amplifier
    encoder: Encoder
    limits: Limits
    reference: Reference = field(default_factory=Reference)
    cogging: Cogging = field(default_factory=Cogging)
    simulation: Simulation = field(default_factory=Simulation)
    description: Annotated[str, Quantity("", "description of the rig, in one sentence")] = ""
    source: Annotated[str, Quantity("", "source of its numbers")] = ""
    board: Annotated[
        Mapping[str, Setting],
        Quantity(
            "",
            "pins, scales and amplifier of the board: rig firmware build uses them, and they are "
            "compared with those of the device",
        ),
    ] = field(default_factory=dict)

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


SchemeCutoff = Literal["as-in-the-paper", "same"]


BOARD_ARITHMETICS = ("fixed", "float32")  # in which a board renders the wall itself


@dataclass(frozen=True, kw_only=True, slots=True)
class Controller:
    """Section ``[controller]``: rates of the law, velocity estimator, and where the law runs."""

    position_rate: Annotated[
        int,
        Ge(10),
        Le(200_000),
        Quantity("Hz", "ticks per second, 1/T1; an integer multiple of velocity_rate"),
    ]
    velocity_rate: Annotated[
        int,
        Ge(10),
        Le(200_000),
        Quantity("Hz", "velocity estimates per second, 1/T2; uniform sampling when equal to position_rate"),
    ]
    estimator: Annotated[str, MinLen(1), Quantity("", "name of the velocity estimator")]
    parameters: Annotated[Mapping[str, float | str], Quantity("", "settings of the estimator")] = field(
        default_factory=dict
    )
    scheme_cutoff: Annotated[
        SchemeCutoff,
        Quantity(
            "",
            "cut-off of a scheme without its own, at another velocity rate: as-in-the-paper, the "
            "same share of that rate; same, this cut-off in Hz",
        ),
    ] = "as-in-the-paper"
    prediction: Annotated[
        Literal["hold", "extrapolate"],
        Quantity("", "velocity between its samples: held, or extrapolated to first order"),
    ] = "hold"
    slow_velocity_rate: Annotated[
        int | None,
        Ge(1),
        Le(200_000),
        Quantity("Hz", "velocity rate while the handle is slower than slow_below; left out: velocity_rate"),
    ] = None
    slow_below: Annotated[
        float, Ge(0), Quantity("velocity", "speed below which slow_velocity_rate is used; 0: never")
    ] = 0.0
    loop: Annotated[
        Literal["host", "device"],
        Quantity("", "where the law runs: on this computer, or on the device, supervised by this computer"),
    ] = "host"
    arithmetic: Annotated[
        Literal["auto", "fixed", "float32", "drive"],
        Quantity(
            "",
            "arithmetic of a law on the device: integers, float32, or chosen by the estimator "
            "(integers for fdm-butterworth-fixed); drive: behind a bridge, the drive renders the "
            "wall itself, at its own rate with its own filter",
        ),
    ] = "auto"
    measured_current: Annotated[
        bool,
        Quantity("", "a device that runs the law also sends the measured current of every tick (2 bytes)"),
    ] = True
    supervise_lifetime_s: Annotated[
        float | None,
        Ge(0.01),
        Le(0.1),
        Quantity("s", "a device that runs the law stops after this time without a command; left out: 20 ms"),
    ] = None
    friction_compensation: Annotated[
        float,
        Ge(0),
        Lt(1),
        Quantity("1", "share of the rig's Coulomb friction that the motor compensates in a trial; 0: none"),
    ] = 0.0
    friction_dead_band: Annotated[
        float | None,
        Gt(0),
        Quantity(
            "velocity",
            "speed from which the whole share acts; left out: four times the estimate for one count "
            "per sample",
        ),
    ] = None
    cogging_compensation: Annotated[
        bool,
        Quantity(
            "",
            "the motor compensates its cogging in a trial, from the map in [rig.cogging] and within "
            "its range",
        ),
    ] = False
    cogging_limit: Annotated[
        float,
        Gt(0),
        Le(1),
        Quantity("1", "largest effort of this compensation, as a share of rig.limits.nominal_effort"),
    ] = 0.2
    command_lifetime_s: Annotated[
        float | None,
        Gt(0),
        Le(0.02),
        Quantity(
            "s",
            "the device drops to zero effort after this time without a command; left out: max(5 ticks, 3 ms)",
        ),
    ] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    @property
    def wall_is_elsewhere(self) -> bool:
        """Return True if a motor drive behind the board renders the wall, rather than this computer or the board."""
        return self.loop == "device" and self.arithmetic not in ("auto", *BOARD_ARITHMETICS)


@dataclass(frozen=True, kw_only=True, slots=True)
class Wall:
    """Section ``[wall]``: the virtual wall; inside it the effort is stiffness · penetration + damping · velocity."""

    stiffness: Annotated[float, Ge(0), Quantity("stiffness", "K")]
    damping: Annotated[float, Ge(0), Quantity("damping", "B")]
    position: Annotated[float, Quantity("position", "position of the wall's surface")] = 0.0
    side: Annotated[
        Literal[-1, 1], Quantity("", "1: entered with rising position; -1: with falling position")
    ] = 1
    pull: Annotated[
        Literal["clamp", "allow"],
        Quantity(
            "", "allow: the wall may pull a handle that leaves it; clamp: its effort is clamped at zero"
        ),
    ] = "clamp"
    damping_on: Annotated[
        Literal["both", "entry"], Quantity("", "damping in both directions, or on the way in only")
    ] = "both"
    law: Annotated[str, MinLen(1), Quantity("", "name of the force law")] = "spring-damper"
    position_from: Annotated[
        Literal["encoder", "estimator"],
        Quantity(
            "", "position that the law sees: the encoder's, or the estimator's (at the position rate only)"
        ),
    ] = "encoder"
    passive_damping: Annotated[
        float,
        Ge(0),
        Quantity(
            "damping",
            "largest damping that a passivity controller adds after the wall gave more energy than it took; 0: none",
        ),
    ] = 0.0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Homing:
    """Section ``[homing]``: the soft position servo that moves the handle to the start of a trial."""

    speed: Annotated[float, Gt(0), Quantity("velocity", "speed of the set point")]
    stiffness: Annotated[float, Gt(0), Quantity("stiffness", "stiffness of the servo to the set point")]
    damping: Annotated[float, Ge(0), Quantity("damping", "damping of the servo")]
    effort: Annotated[float, Gt(0), Quantity("effort", "largest effort of the servo")]
    slew: Annotated[float, Gt(0), Quantity("effort/s", "fastest change of effort while homing")]
    tolerance_counts: Annotated[
        float,
        Gt(0),
        Le(1e6),
        Quantity(
            "count",
            "homing is complete within this distance of the start, or within that at which "
            "friction can hold the handle",
        ),
    ]
    settle_s: Annotated[float, Ge(0), Le(60), Quantity("s", "time for which the handle must stay there")]
    timeout_s: Annotated[float, Gt(0), Le(600), Quantity("s", "homing fails after this time")]

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """Section ``[trial]``: one hit from the start into the wall, by a constant effort or by a person."""

    effort: Annotated[
        float,
        Quantity(
            "effort", "constant push, inside and outside the wall, signed like position; none when human"
        ),
    ]
    start: Annotated[
        float, Quantity("position", "position at which the handle is released, on the free side of the wall")
    ]
    duration_s: Annotated[
        float,
        Gt(0),
        Le(3600),
        Quantity(
            "s",
            "time from the release, or from the cue, to the end of the push; with hold_s, to the "
            "first contact at most",
        ),
    ]
    hold_s: Annotated[
        float,
        Ge(0),
        Le(3600),
        Quantity(
            "s",
            "time from a person's first contact to the end of the push, however often the handle "
            "leaves the wall; 0: duration_s",
        ),
    ] = 0.0
    release_s: Annotated[
        float, Gt(0), Le(60), Quantity("s", "time of the ramp to zero effort after the push")
    ] = 0.1
    baseline_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity(
            "s",
            "time in free space before the cue, in which a person must not move halfway to the wall; 0: none",
        ),
    ] = 0.0
    foreperiod_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity(
            "s",
            "longest random additional time in free space (foreperiod), by trial.seed, so that "
            "the cue cannot be anticipated",
        ),
    ] = 0.0
    repeats: Annotated[int, Ge(1), Le(100_000), Quantity("", "number of repeats of the trial")] = 1
    seed: Annotated[
        int, Ge(0), Le(2**63 - 1), Quantity("", "seed of all random numbers of the simulation")
    ] = 0
    minimum_rest_counts: Annotated[
        float,
        Ge(0),
        Quantity(
            "count", "smallest depth at which the push must come to rest, else it is refused; 0: never refuse"
        ),
    ] = 2.0
    kind: Annotated[
        Literal["constant-effort", "human", "excitation"],
        Quantity(
            "",
            "source of motion: the motor, with the end mass on the handle; a person; or "
            "[excitation], about the wall",
        ),
    ] = "constant-effort"

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Excitation:
    """Section ``[excitation]``: a multisine effort at the handle, in whole periods, to measure mechanical impedance.

    The frequencies are all multiples of 1/period_s from low_hz to high_hz. The wall then acts on both sides of
    wall.position.
    """

    kind: Annotated[
        Literal["schroeder", "random"],
        Quantity("", "phases: Schroeder's, for a small peak; or random, different in each realisation"),
    ] = "random"
    low_hz: Annotated[float, Gt(0), Le(100_000), Quantity("Hz", "lowest line")] = 1.0
    high_hz: Annotated[float, Gt(0), Le(100_000), Quantity("Hz", "highest line")] = 250.0
    period_s: Annotated[
        float, Gt(0), Le(1000), Quantity("s", "period; its inverse is the spacing of the lines")
    ] = 1.0
    settle_periods: Annotated[
        int,
        Ge(0),
        Le(10_000),
        Quantity(
            "", "settling periods before the analysed ones; the excitation rises in the first half of them"
        ),
    ] = 2
    periods: Annotated[int, Ge(1), Le(10_000), Quantity("", "number of analysed periods")] = 4
    realisations: Annotated[
        int,
        Ge(1),
        Le(10_000),
        Quantity(
            "", "number of runs, each with other phases, over which the distortion by friction averages"
        ),
    ] = 4
    rms: Annotated[
        float | None,
        Gt(0),
        Quantity(
            "effort",
            "rms effort; left out, with peak: 10 × Coulomb friction, at least 2 % of rig.limits.effort",
        ),
    ] = None
    peak: Annotated[float | None, Gt(0), Quantity("effort", "peak effort, in place of rms")] = None
    channel: Annotated[
        Literal["external", "motor"],
        Quantity(
            "",
            "actuator of the excitation: a second one (in simulation), or the rig's motor in "
            "addition to the wall",
        ),
    ] = "external"
    seed: Annotated[int, Ge(0), Le(2**63 - 1), Quantity("", "seed of random phases")] = 0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Host:
    """Section ``[host]``: how the loop runs on this computer in real time; simulated time uses only `pacing`."""

    realtime: Annotated[
        Literal["enforce", "try", "off"],
        Quantity("", "real-time scheduling and locked memory: enforced, used if granted, or not requested"),
    ] = "try"
    priority: Annotated[int, Ge(1), Le(98), Quantity("", "SCHED_FIFO priority of the loop's thread")] = 80
    cpu: Annotated[
        int | None, Ge(0), Le(4095), Quantity("", "processor on which the loop runs; left out: any")
    ] = None
    pacing: Annotated[
        Literal["device", "host"],
        Quantity("", "timing of the loop: by each sample that arrives, or by this computer's clock"),
    ] = "device"
    overrun: Annotated[
        Literal["skip", "stop"],
        Quantity(
            "", "when a tick is more than one period late: skip and count the missed ticks, or end the run"
        ),
    ] = "skip"
    spin_s: Annotated[
        float,
        Ge(0),
        Le(0.0005),
        Quantity(
            "s",
            "host pacing: the last part of each wait, in which the processor polls; at most 60 % of a period",
        ),
    ] = 0.0
    heartbeat_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity(
            "s", "the loop ends when the supervising program sends no heartbeat for this time; 0: never"
        ),
    ] = 2.0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class VerdictLimits:
    """Section ``[verdict]``: thresholds for the judgement of a trial, in units of the handle (m, m/s, N)."""

    tail_s: Annotated[
        float, Gt(0), Le(3600), Quantity("s", "duration of the judged last part of the push")
    ] = 0.4
    highpass_hz: Annotated[
        float,
        Gt(0),
        Le(100_000),
        Quantity("Hz", "cut-off of the two-pole high pass that removes slow pressing"),
    ] = 30.0
    lowpass_hz: Annotated[
        float, Gt(0), Le(100_000), Quantity("Hz", "upper edge of the band that a hand feels")
    ] = 500.0
    felt_velocity: Annotated[
        float, Gt(0), Quantity("m/s", "felt: rms velocity of the handle in the band above this")
    ] = 0.005
    heard_force: Annotated[
        float, Gt(0), Quantity("N", "heard: rms ripple of the commanded effort, at the handle, above this")
    ] = 1.0
    moved: Annotated[float, Gt(0), Quantity("m", "moved: peak-to-peak travel of the handle above this")] = (
        1.25e-4
    )
    growth_ratio: Annotated[
        float, Gt(1), Quantity("", "unstable: amplitude of the tail's second half over its first above this")
    ] = 1.2
    late_fraction: Annotated[
        float,
        Gt(0),
        Lt(1),
        Quantity("", "invalid: share of late ticks from the first contact on at or above this"),
    ] = 0.003
    longest_gap: Annotated[
        int,
        Ge(0),
        Le(1000),
        Quantity("sample", "invalid: more samples lost in a row, from the first contact on"),
    ] = 2
    lost_fraction: Annotated[
        float,
        Ge(0),
        Lt(1),
        Quantity("", "invalid: share of samples lost from the first contact on above this"),
    ] = 0.01
    saturated_fraction: Annotated[
        float,
        Gt(0),
        Lt(1),
        Quantity("", "unstable or invalid: share of saturated ticks in the tail above this"),
    ] = 0.01

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Experiment(Shown):
    """A complete, validated experiment; `realtime` contains changes for a run in real time, by dotted key."""

    rig: Rig
    controller: Controller
    wall: Wall
    homing: Homing
    trial: Trial
    operator: Operator = GRIPS["normal"]  # acts when trial.kind is human
    verdict: VerdictLimits = field(default_factory=VerdictLimits)
    excitation: Excitation = field(default_factory=Excitation)  # acts when trial.kind is excitation
    host: Host = field(default_factory=Host)  # acts in real time
    realtime: Annotated[
        Mapping[str, Setting], Quantity("", "changes for a loop in real time, by dotted key")
    ] = field(default_factory=dict)

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    def headline(self) -> str:
        """Return one line with the rig's name, stiffness and damping of the wall, sampling rates and estimator."""
        motion, wall, rates = self.rig.motion, self.wall, self.controller
        scheme = "uniform" if rates.position_rate == rates.velocity_rate else "dual-rate"
        return (
            f"{self.rig.name}: K = {wall.stiffness:g} {unit_of('stiffness', motion)}, "
            f"B = {wall.damping:g} {unit_of('damping', motion)}, "
            f"{scheme} {rates.position_rate / 1e3:g}/{rates.velocity_rate / 1e3:g} kHz, {rates.estimator}"
            + (", law on the device" if rates.loop == "device" else "")
        )

    def brief(self) -> list[Item]:
        """Return the experiment as lines: rig, wall, rates, law, source and duration of the push, effort limit."""
        trial, motion = self.trial, self.rig.motion
        push = f"{trial.effort:g} {unit_of('effort', motion)}"
        who = {"human": f"a hand with a {self.operator.grip} grip", "excitation": "an excitation"}
        return [
            self.headline(),
            Row("rig", self.rig.description or self.rig.name),
            Row("law", self.wall.law),
            Row("pushed by", who.get(trial.kind, push)),
            Row("for", trial.duration_s, "s"),
            Row("effort limit", self.rig.limits.effort, unit_of("effort", motion)),
        ]

    def detailed(self) -> list[Item]:
        """Return the headline and a table of all keys with their values, for printing."""
        return [self.headline(), Table(("key", "value"), list(_leaves(self, "")), words=2)]


def _leaves(section: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    for item in fields(section):
        value = getattr(section, item.name)
        if is_dataclass(value):
            yield from _leaves(value, f"{prefix}{item.name}.")
        elif isinstance(value, Mapping):
            yield from ((f"{prefix}{item.name}.{key}", one) for key, one in value.items())
        else:
            yield f"{prefix}{item.name}", value
