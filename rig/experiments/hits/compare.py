"""Compare the same wall under several sampling schemes: what each does to one and the same hit.

`rig compare`, `rig.experiments.lab`, papers and pictures call it. It opens no device and writes no recording. Source:
Koul et al., Fig. 7 and section III ("depth of penetration … after the first impact").
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

# One place of the encoder's cells alone can show anything.
OFFSETS = (0.1, 0.4, 0.7, 0.95)  # where position zero lies in its encoder cell, one trial each
NO_DAMPING = "none"  # name of the entry without damping
UNUSED = ("trial.repeats", "trial.seed")  # a trial without bytes has no noise: every repeat would be the same
USUAL_VELOCITY_RATE = 2000  # Hz, of the dual-rate scheme when the experiment's own is uniform


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """How the handle gets going: where it is at the first sample, how fast, and what pushes it all along.

    Attributes
    ----------
    position, velocity
        State of the whole rig at the first sample (rad or m, rad/s or m/s).
    motor_effort
        Constant effort through the motor, as an automated trial has it (N·m or N).
    external_effort
        Constant effort of the world on the link (N·m or N).
    """

    position: float
    velocity: float = 0.0
    motor_effort: float = 0.0
    external_effort: float = 0.0

    @classmethod
    def of(cls, experiment: Experiment) -> Start:
        """Return the experiment's own: at rest at its start, pushed by its constant effort."""
        return cls(position=experiment.trial.start, motor_effort=experiment.trial.effort)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A scheme that takes part: its name in tables, and the wall's damping under it; None: the experiment's."""

    name: str
    scheme: Scheme
    damping: float | None = None

    def applied(self, experiment: Experiment) -> Experiment:
        """Return the experiment under this scheme and damping; `ConfigError` as `Scheme.applied`."""
        changed = self.scheme.applied(experiment)
        if self.damping is None:
            return changed
        return replace(changed, wall=replace(changed.wall, damping=self.damping))

    def label(self, experiment: Experiment) -> str:
        """Name for a legend: rates, estimator, cut-off; without damping none of these matters."""
        return "no damping" if self.damping == 0.0 else self.scheme.label(experiment)


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemeImpacts:
    """Result of one entry: a hit for each encoder offset, and the mean of their numbers."""

    entry: Entry = field(repr=False)
    experiment: Experiment = field(repr=False)  # as it was run
    label: str
    impacts: tuple[Impact, ...]
    numbers: ImpactNumbers

    @reported
    def name(self) -> str:
        """Return the name under which the scheme was compared."""
        return self.entry.name

    @reported
    def scheme(self) -> str:
        """Return the scheme in its text form, like dual:20k/2k."""
        return Scheme.of(self.experiment).text

    @reported
    def damping(self) -> float:
        """Return the damping of the scheme's wall (N·m·s/rad or N·s/m)."""
        return self.experiment.wall.damping

    @reported
    def complete(self) -> bool:
        """Return True if the guard ended none of the hits."""
        return all(impact.complete for impact in self.impacts)

    @property
    def peaks(self) -> tuple[float, float]:
        """Return the least and largest peak over the offsets (counts)."""
        peaks = [impact.numbers.peak for impact in self.impacts]
        return min(peaks), max(peaks)

    def cells(self) -> tuple[str, ...]:
        """Return the row of the table of a comparison."""
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
    """Every entry on one rig, wall and start."""

    experiment: Experiment = field(repr=False)
    start: Start
    outcomes: tuple[SchemeImpacts, ...]

    @reported
    def rig(self) -> str:
        """Return the name of the rig that was compared on."""
        return self.experiment.rig.name

    @reported
    def motion(self) -> Motion:
        """Return its kind of motion, which decides the units."""
        return self.experiment.rig.motion

    @reported
    def wall(self) -> Wall:
        """Return the wall, whose damping an entry may replace."""
        return self.experiment.wall

    @reported
    def cutoffs(self) -> str | None:
        """Return how the cut-offs differ between damped schemes that state none; None where they do not."""
        damped = [outcome.entry.scheme for outcome in self.outcomes if outcome.damping > 0.0]
        return describe_cutoffs(damped, self.experiment)

    def brief(self) -> list[Item]:
        """Return the wall, and of each scheme the peak, its spread over the offsets, and the rest."""
        return [
            self._headline(),
            *(
                Row(one.label, one.numbers.peak, "counts at the peak", f"rests at {one.numbers.rest:.2f}")
                for one in self.outcomes
            ),
        ]

    def detailed(self) -> list[Item]:
        """Return every number of each scheme, and how the cut-offs differ."""
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
        """Return the outcome of the entry of that name; raises `KeyError` if no entry has it."""
        for outcome in self.outcomes:
            if outcome.entry.name == name:
                return outcome
        raise KeyError(name)


def default_entries(experiment: Experiment) -> tuple[Entry, Entry, Entry]:
    """Return no damping, uniform, and dual-rate, at the experiment's position rate, with its estimator.

    The dual-rate velocity rate is the experiment's own, or else the fastest one up to `USUAL_VELOCITY_RATE` that
    divides the position rate.
    """
    own = Scheme.of(experiment)
    fast, slow = own.position_rate, own.velocity_rate
    if fast == slow:
        slow = next(rate for rate in range(min(USUAL_VELOCITY_RATE, fast // 2), 0, -1) if fast % rate == 0)
    uniform = Scheme(position_rate=fast, velocity_rate=fast)
    return (
        Entry(name=NO_DAMPING, scheme=uniform, damping=0.0),
        Entry(name="uniform", scheme=uniform),
        Entry(name="dual", scheme=Scheme(position_rate=fast, velocity_rate=slow)),
    )


def entries_of(experiment: Experiment, schemes: Sequence[str | Scheme]) -> tuple[Entry, ...]:
    """Return an entry for each scheme, ``"none"`` for no damping; `default_entries` if `schemes` is empty."""
    usual = default_entries(experiment)
    if not schemes:
        return usual
    names = [one if isinstance(one, str) else one.text for one in schemes]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"scheme {name} is named twice", remedy="name each scheme once")
    return tuple(
        usual[0]
        if one == NO_DAMPING
        else Entry(name=name, scheme=Scheme.parse(one) if isinstance(one, str) else one)
        for name, one in zip(names, schemes, strict=True)
    )


def refuse_unused(changes: Mapping[str, Any]) -> None:
    """Raise `ConfigError` for a change that no comparison can use."""
    for key in UNUSED:
        if key in changes:
            raise ConfigError(
                f"{key} = {changes[key]!r}: a compared hit has no noise and is simulated once at each encoder offset",
                remedy=f"leave {key} out",
            )


def compare(
    experiment: Experiment,
    entries: Sequence[Entry] | None = None,
    *,
    start: Start | None = None,
    offsets: Sequence[float] = OFFSETS,
) -> SchemeComparison:
    """Simulate one hit for each entry and encoder offset.

    Parameters
    ----------
    experiment
        Rig, wall, estimator, length of the trial.
    entries
        Schemes to compare; `default_entries` if None.
    start
        The experiment's own if None.
    offsets
        Where position zero lies in its encoder cell (count, 0 to below 1), one trial each.

    Raises
    ------
    ConfigError
        An invalid scheme, a hand on the rig, no offset, or a handle that never reaches the wall.
    DeviceNotFoundError
        The simulation is not installed.
    """
    chosen = default_entries(experiment) if entries is None else tuple(entries)
    if not chosen or not offsets or not all(0.0 <= offset < 1.0 for offset in offsets):
        raise ConfigError(
            "no scheme or no encoder offset is given",
            remedy="give at least one scheme, and encoder offsets from 0 to below 1 count",
        )
    if experiment.trial.kind != "constant-effort":
        raise ConfigError(
            f"trial.kind = {experiment.trial.kind}: schemes are compared in automated trials, without a hand",
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
    """Simulate one trial and cut it at its first contact; errors as `compare`."""
    law, plant, trace = simulate(experiment, start, offset)
    side, wall = experiment.wall.side, experiment.wall.position
    rows = _rows(law, plant, trace)
    inside = np.flatnonzero(rows["penetration"] > 0.0)
    if not len(inside):
        raise ConfigError(
            f"the handle never reached the wall within {len(rows) / experiment.controller.position_rate:.3g} s",
            remedy="start closer, push harder than the friction, or give the trial more time",
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
    """Run one trial without bytes, the law in its trial from the first tick on.

    Returns
    -------
    tuple
        A fresh controller like the one that ran, the plant (`sim_backend.mechanics.plant.DiscretePlant`), and what
        happened in each tick (`sim_backend.bare.trial.Trace`).
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
    """Return a controller that is past its homing."""
    made = controller.for_experiment(experiment, current_quantum_a=experiment.rig.amplifier.current_quantum_a)
    made.control["constant_effort"] = start.motor_effort
    # No homing, whose servo uses the estimate: with the same position rate the motion before the first contact is then
    # the same to the last bit, whatever the velocity rate and the estimator.
    made.memory["phase"] = TRIAL
    return made


def _one_tick_before(experiment: Experiment, start: Start, tick_s: float) -> tuple[float, float]:
    """Return the position and velocity from which the rig, as one body, coasts to the start within one tick."""
    if start.velocity == 0.0:
        return start.position, 0.0
    m = experiment.rig.mechanics
    # A trial without bytes begins one tick before its first sample, as the device does.
    friction = math.copysign(m.motor_coulomb + m.link_coulomb, start.velocity)
    drag = config.rig_model(experiment).damping * start.velocity
    effort = start.external_effort + m.gravity_effort - friction - drag
    acceleration = effort / (m.motor_inertia + m.loaded_link_inertia)
    return (
        start.position - (start.velocity - 0.5 * acceleration * tick_s) * tick_s,
        start.velocity - acceleration * tick_s,
    )


def _rows(law: ControllerState, plant: Any, trace: Any) -> NDArray[np.void]:
    """Rows of `rig.core.sample.ROW` as the law filled them: `step` again over the counts, which gives the same bits."""
    rows = np.zeros(len(trace.counts), ROW)
    rows["elapsed_ticks"] = 1
    rows["count"] = trace.counts
    units = np.rint(np.minimum(trace.states[:, plant.edge_age] * (1e9 / TIME_UNIT_NS), OLDEST_EDGE))
    rows["edge_age"] = units.astype(np.int64) * round(1000 * TIME_UNIT_NS) // 1000
    again = rows.copy()
    replay_rows(law.arguments(), rows, again, NO_SETS)
    return again
