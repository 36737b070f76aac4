"""Simulate the same hit on the same wall under several sampling schemes, and compare the results.

`rig compare`, `rig.experiments.lab`, the reproduced papers and the plots call this module. It opens no device and
writes no recording. Source: Koul et al., Fig. 7 and section III ("depth of penetration … after the first impact").
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.messages import OLDEST_EDGE, TIME_UNIT_NS
from rig import config, devices
from rig.config import Experiment, Wall, controller
from rig.config.schemes import Scheme, describe_cutoffs
from rig.control.step import ENDS_RUN, TRIAL, ControllerState
from rig.core.errors import ConfigError
from rig.core.present import Item, Row, Table, reported
from rig.core.sample import ROW, Motion, unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments.hits._impact import Impact, ImpactNumbers, mean, measure
from rig.loop.replay import NO_SETS, replay_rows

# Distances of position zero from the edge of its encoder cell (counts), one trial each: the result of a hit at a single
# distance depends on chance.
OFFSETS = (0.1, 0.4, 0.7, 0.95)
NO_DAMPING = "none"  # name of the scheme without damping
# A simulation without the byte link has no noise, so that every repeat and seed would give the same hit.
UNUSED = ("trial.repeats", "trial.seed")
# Velocity rate of the dual-rate scheme (Hz) if the experiment's own scheme is uniform.
USUAL_VELOCITY_RATE = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """A start of a simulated hit: state of the handle at the first sample, and constant efforts during the trial.

    Attributes
    ----------
    position, velocity
        Position and velocity of the rig, as one rigid body, at the first sample (rad or m, rad/s or m/s).
    motor_effort
        Constant effort that the motor adds to the wall's effort during the trial (N·m or N).
    external_effort
        Constant effort of an external load on the link during the trial (N·m or N).
    """

    position: float
    velocity: float = 0.0
    motor_effort: float = 0.0
    external_effort: float = 0.0

    @classmethod
    def of(cls, experiment: Experiment) -> Start:
        """Return the start of an experiment's trial: at rest at `trial.start`, the motor pushes with `trial.effort`."""
        return cls(position=experiment.trial.start, motor_effort=experiment.trial.effort)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A sampling scheme to compare: its name in tables, and the wall's damping (None: the experiment's damping)."""

    name: str
    scheme: Scheme
    damping: float | None = None

    def applied(self, experiment: Experiment) -> Experiment:
        """Return the experiment with this sampling scheme and damping; raise `ConfigError` if the scheme is invalid."""
        changed = self.scheme.applied(experiment)
        if self.damping is None:
            return changed
        return replace(changed, wall=replace(changed.wall, damping=self.damping))

    def label(self, experiment: Experiment) -> str:
        """Return a label for a plot's legend: rates, estimator and cut-off; "no damping" if the damping is 0."""
        return "no damping" if self.damping == 0.0 else self.scheme.label(experiment)


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemeImpacts:
    """Result of one sampling scheme: a simulated hit for each encoder offset, and the mean of peak, rest and others."""

    entry: Entry = field(repr=False)
    experiment: Experiment = field(repr=False)  # as it was run
    label: str
    impacts: tuple[Impact, ...]
    numbers: ImpactNumbers

    @reported
    def name(self) -> str:
        """Return the sampling scheme's name in tables, like "uniform" or "dual"."""
        return self.entry.name

    @reported
    def scheme(self) -> str:
        """Return the sampling scheme as text, like "dual:20k/2k" (position rate and velocity rate, Hz)."""
        return Scheme.of(self.experiment).text

    @reported
    def damping(self) -> float:
        """Return the damping of the sampling scheme's wall (N·m·s/rad or N·s/m)."""
        return self.experiment.wall.damping

    @reported
    def complete(self) -> bool:
        """Return True if each hit ran to its end; False if the guard (limits of effort, speed, position) ended one."""
        return all(impact.complete for impact in self.impacts)

    @property
    def peaks(self) -> tuple[float, float]:
        """Return the smallest and the largest peak penetration among the hits at all encoder offsets (counts)."""
        peaks = [impact.numbers.peak for impact in self.impacts]
        return min(peaks), max(peaks)

    def cells(self) -> tuple[str, ...]:
        """Return this sampling scheme's row in the table of a full report, one text for each column."""
        n, (least, most) = self.numbers, self.peaks
        return (
            self.label + ("" if self.complete else ", ended by the guard"),
            f"{n.impact_velocity:.3g}",
            f"{n.peak:.2f}",
            f"{least:.4g}…{most:.4g}",
            "none" if n.second_peak is None else f"{n.second_peak:.2f}",
            f"{n.rest:.2f}",
            f"{n.bounces:.3g}",
            f"{n.decay:.2f}",
            "never" if n.settling_s is None else f"{n.settling_s:.3g}",
        )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SchemeComparison(Shown, Drawn):
    """Results of several sampling schemes for the same simulated hit: one rig, wall and start of the handle."""

    experiment: Experiment = field(repr=False)
    start: Start
    outcomes: tuple[SchemeImpacts, ...]

    @reported
    def rig(self) -> str:
        """Return the name of the simulated rig."""
        return self.experiment.rig.name

    @reported
    def motion(self) -> Motion:
        """Return the rig's kind of motion, rotary or linear, which determines the units."""
        return self.experiment.rig.motion

    @reported
    def wall(self) -> Wall:
        """Return the wall of the experiment; a compared scheme can have another damping than this wall."""
        return self.experiment.wall

    @reported
    def cutoffs(self) -> str | None:
        """Return a sentence if schemes that state no filter cut-off get different default cut-offs; else None."""
        damped = [outcome.entry.scheme for outcome in self.outcomes if outcome.damping > 0.0]
        return describe_cutoffs(damped, self.experiment)

    def brief(self) -> list[Item]:
        """Return a short report: the wall, then each sampling scheme's mean peak and rest penetration (counts)."""
        return [
            self._headline(),
            *(
                Row(one.label, one.numbers.peak, "counts at the peak", f"rests at {one.numbers.rest:.2f}")
                for one in self.outcomes
            ),
        ]

    def detailed(self) -> list[Item]:
        """Return the lines of a full report: wall, table with every number of each scheme, and differing cut-offs."""
        velocity = unit_of("velocity", self.motion)
        head = ("counts", f"impact ({velocity})", "peak", "of offsets", "second", "rest", "bounces", "decay")
        table = Table((*head, "settling (s)"), [one.cells() for one in self.outcomes])
        return [self._headline(), table, *([f"  {self.cutoffs}"] if self.cutoffs is not None else [])]

    def _headline(self) -> str:
        stiffness, damping = (
            f"{getattr(self.wall, name):g} {unit_of(name, self.motion)}" for name in ("stiffness", "damping")
        )
        return (
            f"{self.rig}: K = {stiffness}, B = {damping}, the same hit, "
            f"mean over {len(self.outcomes[0].impacts)} encoder offsets"
        )

    def __getitem__(self, name: str) -> SchemeImpacts:
        """Return the result of the sampling scheme with this name; raise `KeyError` if there is no such scheme."""
        for outcome in self.outcomes:
            if outcome.entry.name == name:
                return outcome
        raise KeyError(name)


def default_entries(experiment: Experiment) -> tuple[Entry, Entry, Entry]:
    """Return three sampling schemes at the experiment's position rate: uniform without damping, uniform, and dual-rate.

    The dual-rate scheme has the experiment's velocity rate, or a divisor of the rate if the experiment is uniform.
    """
    own = Scheme.of(experiment)
    fast, slow = own.position_rate, own.velocity_rate
    if fast == slow:
        # The experiment is uniform: the highest divisor of its rate up to 2000 Hz and up to half of the rate.
        slow = next(rate for rate in range(min(USUAL_VELOCITY_RATE, fast // 2), 0, -1) if fast % rate == 0)
    uniform = Scheme(position_rate=fast, velocity_rate=fast)
    return (
        Entry(name=NO_DAMPING, scheme=uniform, damping=0.0),
        Entry(name="uniform", scheme=uniform),
        Entry(name="dual", scheme=Scheme(position_rate=fast, velocity_rate=slow)),
    )


def entries_of(experiment: Experiment, schemes: Sequence[str | Scheme]) -> tuple[Entry, ...]:
    """Return the schemes as entries of a comparison; "none" is a wall without damping, no schemes are three usual ones.

    Raise `ConfigError` if two schemes have the same name.
    """
    usual = default_entries(experiment)
    if not schemes:
        return usual
    names = [one if isinstance(one, str) else one.text for one in schemes]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"scheme {name} is given twice", remedy="give each scheme only once")
    return tuple(
        usual[0]
        if one == NO_DAMPING
        else Entry(name=name, scheme=Scheme.parse(one) if isinstance(one, str) else one)
        for name, one in zip(names, schemes, strict=True)
    )


def refuse_unused(changes: Mapping[str, Any]) -> None:
    """Raise `ConfigError` if `changes` contains a key that a comparison ignores (`trial.repeats`, `trial.seed`)."""
    for key in UNUSED:
        if key in changes:
            raise ConfigError(
                f"{key} = {changes[key]!r} cannot be set for a comparison: each hit is simulated without noise, once "
                "for each encoder offset",
                remedy=f"leave {key} out",
            )


def compare(
    experiment: Experiment,
    entries: Sequence[Entry] | None = None,
    *,
    start: Start | None = None,
    offsets: Sequence[float] = OFFSETS,
) -> SchemeComparison:
    """Simulate one hit for each sampling scheme and each encoder offset, and return the compared results.

    Parameters
    ----------
    experiment
        Rig, wall, estimator, and length of the trial.
    entries
        Schemes to compare; None: uniform without damping, uniform, and dual-rate at the experiment's rates.
    start
        Initial state of the handle and constant efforts; None: start and effort of the experiment's trial.
    offsets
        Distances of position zero from the lower edge of its encoder cell (counts, 0 to below 1). One hit is simulated
        for each offset.

    Raises
    ------
    ConfigError
        A sampling scheme is invalid, no scheme or no offset is given, an offset is out of range, the trial's kind is
        not constant effort, or the handle never reaches the wall.
    DeviceNotFoundError
        The package of the simulation, `sim_backend`, is not installed.
    """
    chosen = default_entries(experiment) if entries is None else tuple(entries)
    if not chosen or not offsets or not all(0.0 <= offset < 1.0 for offset in offsets):
        raise ConfigError(
            f"{len(chosen)} schemes and the encoder offsets {list(offsets)} are given: at least one of each is needed",
            remedy="give at least one scheme, and at least one encoder offset from 0 to below 1 count",
        )
    if experiment.trial.kind != "constant-effort":
        raise ConfigError(
            f"trial.kind = {experiment.trial.kind}, but schemes are compared without a hand or an excitation",
            remedy="set trial.kind = constant-effort",
        )
    given = start or Start.of(experiment)
    outcomes: list[SchemeImpacts] = []
    for entry in chosen:
        applied = entry.applied(experiment)
        impacts = tuple(hit(applied, given, offset) for offset in offsets)
        outcomes.append(
            SchemeImpacts(
                entry=entry,
                experiment=applied,
                label=entry.label(experiment),
                impacts=impacts,
                numbers=mean(impact.numbers for impact in impacts),
            )
        )
    return SchemeComparison(experiment=experiment, start=given, outcomes=tuple(outcomes))


def hit(experiment: Experiment, start: Start, offset: float) -> Impact:
    """Simulate one trial and return its traces and numbers from the first contact with the wall on.

    `offset` is the distance of position zero from the lower edge of its encoder cell (counts, 0 to below 1). Raise
    `ConfigError` if the handle never reaches the wall.
    """
    law, plant, trace = simulate(experiment, start, offset)
    side, wall = experiment.wall.side, experiment.wall.position
    rows = _rows(law, plant, trace)
    inside = np.flatnonzero(rows["penetration"] > 0.0)
    if not len(inside):
        raise ConfigError(
            f"the handle never reached the wall within {len(rows) / experiment.controller.position_rate:.3g} s",
            remedy="start closer to the wall (trial.start), raise trial.effort above the friction, or raise "
            "trial.duration_s",
        )
    first = int(inside[0])
    after, states = rows[first:], trace.states[first:]
    time_s = np.arange(len(after)) / experiment.controller.position_rate
    counts = after["penetration"] / experiment.rig.encoder.resolution
    velocity_true = side * states[:, plant.sensed_position + 1]
    return Impact(
        offset=offset,
        time_s=time_s,
        counts=counts,
        penetration=after["penetration"].copy(),
        penetration_true=side * (states[:, plant.handle_position] - wall),
        velocity=side * after["velocity"],
        velocity_true=velocity_true,
        complete=not rows["flags"][-1] & ENDS_RUN,
        numbers=measure(time_s, counts, float(velocity_true[0])),
    )


def simulate(experiment: Experiment, start: Start, offset: float) -> tuple[ControllerState, Any, Any]:
    """Simulate one trial without a serial protocol between controller and device, and without homing.

    Returns
    -------
    tuple
        First a new controller with the settings of the simulated one, in its initial state; then the plant
        (`sim_backend.mechanics.plant.DiscretePlant`); last the trace of all ticks (`sim_backend.bare.trial.Trace`).
    """
    rig = replace(experiment.rig, encoder=replace(experiment.rig.encoder, offset=offset))
    placed = replace(experiment, rig=rig)
    model, rates, trial = config.rig_model(placed), placed.controller, placed.trial
    tick_s = 1.0 / rates.position_rate
    build, run_trial = devices.simulated_trial()
    plant = build(model, tick_s)
    position, velocity = _one_tick_before(placed, start, tick_s)
    trace = run_trial(
        _controller(placed, start),
        plant,
        position,
        most_ticks=max(2, round(trial.duration_s * rates.position_rate) - 1),
        initial_velocity=velocity,
        external_effort=start.external_effort,
    )
    return _controller(placed, start), plant, trace


def _controller(experiment: Experiment, start: Start) -> ControllerState:
    """Return a controller that begins with the trial, without homing."""
    made = controller.for_experiment(experiment, current_quantum_a=experiment.rig.amplifier.current_quantum_a)
    made.control["constant_effort"] = start.motor_effort
    # No homing, whose servo uses the estimate: with the same position rate the motion before the first contact is then
    # the same to the last bit, whatever the velocity rate and the estimator.
    made.memory["phase"] = TRIAL
    return made


def _one_tick_before(experiment: Experiment, start: Start, tick_s: float) -> tuple[float, float]:
    """Return position and velocity (rad or m, rad/s or m/s) of the rigid rig one tick before it reaches the start."""
    if start.velocity == 0.0:
        return start.position, 0.0
    m = experiment.rig.mechanics
    # A trial without bytes begins one tick before its first sample, as the device does.
    friction = math.copysign(m.motor_coulomb + m.link_coulomb, start.velocity)
    drag = config.rig_model(experiment).damping * start.velocity
    effort = start.external_effort + m.gravity_effort - friction - drag
    acceleration = effort / m.inertia
    return (
        start.position - (start.velocity - 0.5 * acceleration * tick_s) * tick_s,
        start.velocity - acceleration * tick_s,
    )


def _rows(law: ControllerState, plant: Any, trace: Any) -> NDArray[np.void]:
    """Compute a simulated trial's samples, one `rig.core.sample.ROW` per tick, from the counts of `trace`."""
    rows = np.zeros(len(trace.counts), ROW)
    rows["elapsed_ticks"] = 1
    rows["count"] = trace.counts
    units = np.rint(np.minimum(trace.states[:, plant.edge_age] * (1e9 / TIME_UNIT_NS), OLDEST_EDGE))
    rows["edge_age"] = units.astype(np.int64) * round(1000 * TIME_UNIT_NS) // 1000
    again = rows.copy()
    replay_rows(law.arguments(), rows, again, NO_SETS)
    return again
