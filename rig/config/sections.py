"""What an experiment file may say: one dataclass a section, every range, unit and meaning in its annotation.

The annotations are the only place of a range or a unit; the validator, the error messages, the listing of a
plan and the schema for editors all read them from here (see `rig.config.table`). Rules that tie two keys
together are in `rig.config.rules`. The physics of the rig is typed by `rig.core.model`.

Positions, efforts and stiffnesses are at the link, in SI units, which depend on ``rig.motion``
(`rig.core.sample.unit_of`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt, MinLen

from rig.core.model import Amplifier, Cogging, Encoder, Mechanics, Operator, Reference, Simulation
from rig.core.operators import GRIPS
from rig.core.oscillation import OSCILLATION_S, OSCILLATIONS
from rig.core.present import Item, Row, Table
from rig.core.quantity import STRICT, Quantity
from rig.core.sample import Motion, unit_of
from rig.core.shown import Shown

Setting = bool | int | float | str


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """What the guard allows on this rig, whatever the law asks for."""

    nominal_effort: Annotated[
        float, Gt(0), Quantity("effort", "what the motor gives for hours without overheating")
    ]
    effort: Annotated[
        float, Gt(0), Quantity("effort", "every command is clipped to ± this; left out: nominal_effort")
    ]
    thermal_time_constant_s: Annotated[
        float, Gt(0), Le(10_000), Quantity("s", "thermal time constant of the motor's winding")
    ]
    speed: Annotated[float, Gt(0), Quantity("velocity", "a faster handle ends the run")]
    slew: Annotated[
        float,
        Gt(0),
        Quantity("effort/s", "fastest change of effort in a trial; a tick where it binds makes it invalid"),
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
            "J", "a motor that has given the handle more than this in a trial ends it; left out: no limit"
        ),
    ] = None
    oscillations: Annotated[
        int | None,
        Ge(0),
        Le(1000),
        Quantity(
            "",
            "number of oscillations of the effort in a row, from zero to its limit with the handle moving, "
            f"that end the run; 0: never; left out: {OSCILLATIONS} in a person's trial (human = true), else never",
        ),
    ] = None
    oscillation_s: Annotated[
        float,
        Gt(0),
        Le(1),
        Quantity("s", "longest time between two oscillations in a row"),
    ] = OSCILLATION_S
    human: Annotated[
        bool,
        Quantity(
            "",
            'a person holds the handle, so effort may not exceed nominal_effort; trial.kind = "human" sets it; false '
            "beside that kind is refused on a real rig",
        ),
    ] = True
    override_stall: Annotated[
        bool, Quantity("", "let effort exceed nominal_effort although a person holds the handle")
    ] = False

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Rig:
    """The machine: its physics as far as it is known, and its limits."""

    name: Annotated[str, MinLen(1), Quantity("", "short name, written into recordings")]
    motion: Annotated[Motion, Quantity("", "decides the units: rad and N·m, or m and N")]
    mechanics: Mechanics
    amplifier: Amplifier
    encoder: Encoder
    limits: Limits
    reference: Reference = field(default_factory=Reference)
    cogging: Cogging = field(default_factory=Cogging)
    simulation: Simulation = field(default_factory=Simulation)
    description: Annotated[str, Quantity("", "what the rig is, in a sentence")] = ""
    source: Annotated[str, Quantity("", "where its numbers come from")] = ""
    board: Annotated[
        Mapping[str, Setting],
        Quantity(
            "",
            "pins, scales and amplifier of the board: rig firmware build takes them, and a device must have them",
        ),
    ] = field(default_factory=dict)

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


SchemeCutoff = Literal["as-in-the-paper", "same"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Controller:
    """Rates of the law and the velocity estimator; where the law runs."""

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
        Quantity("Hz", "velocity estimates per second, 1/T2; uniform when equal to position_rate"),
    ]
    estimator: Annotated[str, MinLen(1), Quantity("", "name of the velocity estimator")]
    parameters: Annotated[Mapping[str, float | str], Quantity("", "settings of the estimator")] = field(
        default_factory=dict
    )
    scheme_cutoff: Annotated[
        SchemeCutoff,
        Quantity(
            "",
            "cut-off of a scheme that states none, at another velocity rate: as-in-the-paper, the same share of that "
            "rate; same, this cut-off in Hz",
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
        float, Ge(0), Quantity("velocity", "speed below which slow_velocity_rate holds; 0: never")
    ] = 0.0
    loop: Annotated[
        Literal["host", "device"],
        Quantity(
            "", "where the law runs: on this computer, or on the device itself, which a computer supervises"
        ),
    ] = "host"
    arithmetic: Annotated[
        Literal["auto", "fixed", "float32", "drive"],
        Quantity(
            "",
            "of a law on the device: integers, float32, or by the estimator: integers for fdm-butterworth-fixed; "
            "drive: behind a bridge, the drive renders the wall itself, at its own rate with its own filter",
        ),
    ] = "auto"
    measured_current: Annotated[
        bool,
        Quantity("", "a device that runs the law sends the measured current of every tick, 2 bytes more"),
    ] = True
    supervise_lifetime_s: Annotated[
        float | None,
        Ge(0.01),
        Le(0.1),
        Quantity("s", "a device that runs the law stops after this silence; left out: 20 ms"),
    ] = None
    friction_compensation: Annotated[
        float,
        Ge(0),
        Lt(1),
        Quantity("1", "share of the rig's Coulomb friction that the motor takes over in a trial; 0: none"),
    ] = 0.0
    friction_dead_band: Annotated[
        float | None,
        Gt(0),
        Quantity(
            "velocity",
            "speed from which the whole share acts; left out: four times what one count makes of the estimate",
        ),
    ] = None
    cogging_compensation: Annotated[
        bool,
        Quantity("", "the motor takes its own cogging away in a trial, as [rig.cogging] has it in its range"),
    ] = False
    cogging_limit: Annotated[
        float,
        Gt(0),
        Le(1),
        Quantity("1", "most effort of that, as a share of rig.limits.nominal_effort"),
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Wall:
    """The virtual wall: stiffness · penetration + damping · velocity inside, nothing outside."""

    stiffness: Annotated[float, Ge(0), Quantity("stiffness", "K")]
    damping: Annotated[float, Ge(0), Quantity("damping", "B")]
    position: Annotated[float, Quantity("position", "where the wall begins")] = 0.0
    side: Annotated[Literal[-1, 1], Quantity("", "1: entered with rising position; -1: with falling")] = 1
    pull: Annotated[
        Literal["clamp", "allow"],
        Quantity("", "may the wall pull a handle that leaves it, or is it clamped at zero"),
    ] = "clamp"
    damping_on: Annotated[
        Literal["both", "entry"], Quantity("", "damping both ways, or on the way in only")
    ] = "both"
    law: Annotated[str, MinLen(1), Quantity("", "name of the force law")] = "spring-damper"

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Homing:
    """The soft servo that takes the handle to the start of a trial."""

    speed: Annotated[float, Gt(0), Quantity("velocity", "speed of the set point")]
    stiffness: Annotated[float, Gt(0), Quantity("stiffness", "spring to the set point")]
    damping: Annotated[float, Ge(0), Quantity("damping", "damping to rest")]
    effort: Annotated[float, Gt(0), Quantity("effort", "most effort of the servo")]
    slew: Annotated[float, Gt(0), Quantity("effort/s", "fastest change of effort while homing")]
    tolerance_counts: Annotated[
        float,
        Gt(0),
        Le(1e6),
        Quantity(
            "count", "home when no farther than this from the start, or than friction can hold the handle"
        ),
    ]
    settle_s: Annotated[float, Ge(0), Le(60), Quantity("s", "how long the handle must stay there")]
    timeout_s: Annotated[float, Gt(0), Le(600), Quantity("s", "give up after this time")]

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One hit: from the start into the wall, pushed by a constant effort, or by a person who holds the handle."""

    effort: Annotated[
        float,
        Quantity(
            "effort", "constant push, inside and outside the wall, signed like position; none when human"
        ),
    ]
    start: Annotated[
        float, Quantity("position", "where the handle is released, on the free side of the wall")
    ]
    duration_s: Annotated[
        float,
        Gt(0),
        Le(3600),
        Quantity(
            "s", "from release, or the cue, to the end of the push; with hold_s, to the first contact at most"
        ),
    ]
    hold_s: Annotated[
        float,
        Ge(0),
        Le(3600),
        Quantity(
            "s",
            "from a person's first contact to the end of the push, however often the wall is left; 0: duration_s",
        ),
    ] = 0.0
    release_s: Annotated[float, Gt(0), Le(60), Quantity("s", "ramp to zero effort afterwards")] = 0.1
    baseline_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity(
            "s", "free space before the cue, in which a person must not move halfway to the wall; 0: none"
        ),
    ] = 0.0
    foreperiod_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity(
            "s", "most of a random time of free space after that, by trial.seed, so that nobody anticipates"
        ),
    ] = 0.0
    repeats: Annotated[int, Ge(1), Le(100_000), Quantity("", "how often the trial runs")] = 1
    seed: Annotated[
        int, Ge(0), Le(2**63 - 1), Quantity("", "seed of everything random in the simulation")
    ] = 0
    minimum_rest_counts: Annotated[
        float, Ge(0), Quantity("count", "refuse a push that would rest less deep than this; 0: never refuse")
    ] = 2.0
    kind: Annotated[
        Literal["constant-effort", "human", "excitation"],
        Quantity(
            "",
            "what drives the handle: the motor, with the end mass on it; a person; or [excitation], about the wall",
        ),
    ] = "constant-effort"

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Excitation:
    """What excites the handle when an impedance is measured: a multisine, whole periods of it.

    Its lines are all multiples of 1/period_s in the band. The wall is bilateral meanwhile, about wall.position.
    """

    kind: Annotated[
        Literal["schroeder", "random"],
        Quantity("", "phases: Schroeder's, for a small peak; or random ones, others in each realisation"),
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
        Quantity("", "periods before those that are analysed; it rises in the first half of them"),
    ] = 2
    periods: Annotated[int, Ge(1), Le(10_000), Quantity("", "periods that are analysed")] = 4
    realisations: Annotated[
        int,
        Ge(1),
        Le(10_000),
        Quantity("", "runs, each with other phases: friction's distortion averages over them only"),
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
            "", "what excites the rig: a second actuator (in simulation), or its own motor on top of the wall"
        ),
    ] = "external"
    seed: Annotated[int, Ge(0), Le(2**63 - 1), Quantity("", "seed of random phases")] = 0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Host:
    """How the loop runs on this computer, in real time; virtual time knows nothing of it but `pacing`."""

    realtime: Annotated[
        Literal["enforce", "try", "off"],
        Quantity("", "real-time scheduling and locked memory: demanded, taken if granted, or not asked for"),
    ] = "try"
    priority: Annotated[int, Ge(1), Le(98), Quantity("", "SCHED_FIFO priority of the loop's thread")] = 80
    cpu: Annotated[
        int | None, Ge(0), Le(4095), Quantity("", "processor that the loop is kept on; left out: any")
    ] = None
    pacing: Annotated[
        Literal["device", "host"],
        Quantity("", "who gives the beat: each sample that arrives, or this computer's clock"),
    ] = "device"
    overrun: Annotated[
        Literal["skip", "stop"],
        Quantity("", "a tick more than one period late: skip what passed and count it, or end the run"),
    ] = "skip"
    spin_s: Annotated[
        float,
        Ge(0),
        Le(0.0005),
        Quantity("s", "host pacing: the last part of each wait, spent awake; at most 60 % of a period"),
    ] = 0.0
    heartbeat_s: Annotated[
        float,
        Ge(0),
        Le(60),
        Quantity("s", "the loop ends when the program around it is silent for this long; 0: never"),
    ] = 2.0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class VerdictLimits:
    """Thresholds of the verdict, at the handle; `Mechanics.handle_radius` turns them for a rotary rig."""

    tail_s: Annotated[float, Gt(0), Le(3600), Quantity("s", "the last part of the push, which is judged")] = (
        0.4
    )
    highpass_hz: Annotated[
        float, Gt(0), Le(100_000), Quantity("Hz", "two-pole high pass that removes slow pressing")
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
        float, Gt(0), Lt(1), Quantity("", "invalid: share of late ticks from the first contact on from this")
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
    """A whole experiment, validated. `realtime` holds what `with_realtime` changes, by dotted key."""

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
        """Rig, wall and scheme in one line."""
        motion, wall, rates = self.rig.motion, self.wall, self.controller
        scheme = "uniform" if rates.position_rate == rates.velocity_rate else "dual-rate"
        return (
            f"{self.rig.name}: K = {wall.stiffness:g} {unit_of('stiffness', motion)}, "
            f"B = {wall.damping:g} {unit_of('damping', motion)}, "
            f"{scheme} {rates.position_rate / 1e3:g}/{rates.velocity_rate / 1e3:g} kHz, {rates.estimator}"
            + (", law on the device" if rates.loop == "device" else "")
        )

    def brief(self) -> list[Item]:
        """Wall, scheme, law, what pushes, for how long."""
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
        """Every key of the file, with its value."""
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
