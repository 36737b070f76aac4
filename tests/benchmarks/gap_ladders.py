"""What lost samples and late ticks do to verdicts and K_max, by where in a hit they fall: limits of `[verdict]`.

    python -m tests.benchmarks.gap_ladders      # some minutes on two cores
    python -m tests.benchmarks.gap_ladders      8          # with so many ladders a cell

A *ladder* is nine walls, four rungs below to four above the stiffest that passes; a rung is a ratio of 1.06, the one of
every search. Each ladder begins within homing's tolerance of its start, and its walls are hit twice, without losses and
with the same ticks lost in each. Its K_max is the highest rung that passes (`any`) below every failure.

A second, smaller study. The rule that was committed first is that of `tests.benchmarks.gaps`, and it holds; this one
has another rule, written later but before its own first result, and is provisional beside it.

* **A ladder changes** when its K_max moves by more than one rung. One rung is what a search resolves.
* **A hit changes** when its kind is another one, `gaps` and `late` aside, and it is *hidden* when it then reads as
  stable though it was not. These are told; near the limit either may come of one count more or less.
* **The control** loses nothing: the K_max of each ladder beside that of the next ladder, begun elsewhere. What happens
  there is how far a limit is defined at all.
* **A cell** (rate, part of the hit, loss) pools the rigs of a rate. It is *harmless* when the share of changed ladders
  is at most 5 %, or at most that of the control; *harmful* when the lower end of its one-sided 95 % Clopper-Pearson
  interval is above both; else it is undecided.
* **A limit** is the greatest loss in a part up to which no cell is harmful at any rate: the longest gap from single
  gaps, the share from scattered losses. Of ticks and milliseconds that variable is the key under which the rates agree
  better (the ratio of their longest harmless gaps is nearer to 1). Where a part has no harmful cell up to the device's
  command lifetime, it has no limit: a longer gap lets the watchdog act, and a device that overrules the law makes a hit
  invalid whatever was lost. Parts with the same limit share a key.
* Late ticks come in stretches of ten samples, each two ticks late: the law then answers samples that are two ticks old.
  (One late sample alone is overtaken by the next one, and so is a gap.)

The law over a gap: no fresh STATE, no step and no command; the device holds its last command, which lives for five
ticks, at least 3 ms; the next step is told how many ticks have passed, and a recording has no row for a lost sample.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from rig import config
from rig.config import controller, presets
from rig.control import judging
from rig.control.measure import LOST_BITS
from rig.control.step import THROWN_OUT
from rig.control.verdict import Kind, Measured
from rig.core.sample import Phase, RowFlag
from rig.experiments.hit_simulator import HitSimulator
from sim_backend.operator import Script
from sim_backend.plant import DiscretePlant
from sim_backend.trial import IN_TIME, UNSEEN, run_trial
from tests.conformance.late_samples import LOST, ages

LATE_TICKS, STRETCH = 2, 10  # how late, how many samples in a row
_TIMING = int(RowFlag.GAP | RowFlag.LATE)  # what the study asks about does not decide in it

RUNG = 1.06
BESIDE = 4  # rungs of a ladder to either side of the stiffest wall that passes
LADDERS = 16
HARMLESS = 0.05
IMPACT_S = 0.01  # after contact, as long as the handle decelerates

HELD = {"trial.kind": "human", "trial.duration_s": 1.2}
SLOW = {"rig.simulation.computation_delay_ticks": 1}
WORLDS: dict[str, tuple[str, bool, dict[str, Any]]] = {  # preset, as in real time, changes
    "20 kHz compliant dual": ("koul-compliant", False, {}),
    "20 kHz compliant uniform": ("koul-compliant", False, {"controller.velocity_rate": 20_000}),
    "20 kHz compliant dual, held": ("koul-compliant", False, HELD),
    "20 kHz rigid dual": ("koul-rigid", False, {}),
    "20 kHz rigid uniform, held": ("koul-rigid", False, HELD | {"controller.velocity_rate": 20_000}),
    "4 kHz compliant dual": (
        "koul-compliant", False, {"controller.position_rate": 4000, "controller.velocity_rate": 1000},
    ),
    "4 kHz rigid uniform, held": (
        "koul-rigid", False, HELD | {"controller.position_rate": 4000, "controller.velocity_rate": 4000},
    ),
    "1 kHz compliant": ("koul-compliant", True, SLOW),
    "1 kHz compliant, held": ("koul-compliant", True, SLOW | HELD),
    "1 kHz rigid": ("koul-rigid", True, SLOW),
    "1 kHz rigid, held": ("koul-rigid", True, SLOW | HELD),
    "1 kHz linear": ("chawda-linear", True, SLOW),
}  # fmt: skip
LENGTHS = (1, 2, 3, 4, 5, 10, 20)
SHARES = (0.001, 0.003, 0.01, 0.03)
PARTS = ("approach", "impact", "settling", "tail")
SCATTERED = ("approach", "contact", "tail")  # contact: from the first one to the end of the trial
Cell = tuple[str, str, str]  # rate, part, loss

Delays = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Hit:
    """One hit: verdicts of what was recorded and of the truth in the same rows, and ticks of the trial phase."""

    recorded: Measured
    true: Measured
    first: int
    end: int


class World:
    """A rig under a scheme, whose hits may lose ticks."""

    def __init__(self, name: str, seed: int = 0) -> None:
        preset, realtime, changes = WORLDS[name]
        loaded = presets.load(preset)
        loaded = config.with_realtime(loaded) if realtime else loaded
        experiment = config.override(
            loaded, {"homing.settle_s": 0.02, "trial.release_s": 0.002, **changes, "trial.seed": seed}
        )
        self.experiment, self.tick_s = experiment, 1.0 / experiment.controller.position_rate
        simulator = HitSimulator(experiment)
        self.limits, self.start = simulator.limits, simulator.start
        model = config.rig_model(experiment)
        self._plant = DiscretePlant.build(model, self.tick_s)
        self._script = Script.of(model, self.tick_s, self.start)
        self._template = controller.for_experiment(
            experiment, current_quantum_a=experiment.rig.amplifier.current_quantum_a
        )
        trial = experiment.trial
        self.ticks = round((1.0 + trial.baseline_s + trial.duration_s) / self.tick_s)
        self._meter = judging.meter(self.limits, self.tick_s, experiment.rig.encoder.resolution)

    def hit(self, stiffness: float, delays: Delays | None = None, *, judged: bool = False) -> Hit:
        """Hit a wall of this stiffness and the damping of the preset; delays are those of `ages`.

        What is lost or late decides only where it is `judged`.
        """
        wall = asdict(replace(self.experiment.wall, stiffness=stiffness))
        law, plant = self._template.fresh(wall), self._plant
        trace = run_trial(
            law,
            plant,
            self.start,
            most_ticks=self.ticks,
            script=self._script,
            ages=IN_TIME if delays is None else ages(delays),
        )
        (part,) = np.nonzero(trace.phases == Phase.TRIAL)
        seen, c = trace.phases[trace.phases != UNSEEN], law.control[0]
        pushed = len(seen) > 1 and seen[-2] == Phase.RELEASE
        thrown_out = bool(trace.flags[-1] & THROWN_OUT) and not pushed
        position = c["resolution"] * (trace.counts[part] - c["reference_count"])
        side, states, flags = c["wall_side"], trace.states[part], trace.flags[part]
        lost = np.diff(part, prepend=part[0] - 1) - 1
        flags = flags | lost << LOST_BITS if judged else flags & ~_TIMING
        recorded = self._meter.recorded(
            position,
            trace.currents[part] * c["effort_quantum"],
            side * (position - c["wall_position"]),
            flags,
        )
        true = self._meter.true(
            states[:, plant.handle_position],
            states[:, plant.handle_position + 1],
            states[:, plant.effort],
            side * (states[:, plant.sensed_position] - c["wall_position"]),
            flags,
        )
        recorded_, true_ = (Measured(numbers, self.limits, thrown_out) for numbers in (recorded, true))
        return Hit(recorded_, true_, int(part[0]), int(part[-1]) + 1)

    def stiffest(self) -> float:
        """K_max, by a ladder from softly on."""
        stiffness = self.experiment.wall.stiffness / 6.0
        while self.hit(stiffness * RUNG).recorded.passes("any") is not False:
            stiffness *= RUNG
        return stiffness


def spans(hit: Hit, tick_s: float, tail_s: float) -> dict[str, tuple[int, int]]:
    """First tick and end of each part of a hit."""
    contact = hit.first + round(float(hit.recorded.numbers["contact_s"]) / tick_s)
    tail, impact = hit.end - round(tail_s / tick_s), contact + max(2, round(IMPACT_S / tick_s))
    return {
        "approach": (hit.first + 1, contact),
        "impact": (contact, impact),
        "settling": (impact, tail),
        "tail": (tail, hit.end),
        "contact": (contact, hit.end),
    }


def losses(
    world: World, at: dict[str, tuple[int, int]], drawn: np.random.Generator
) -> dict[tuple[str, str], Delays]:
    """What becomes of the ticks of a hit, by part and loss."""
    made = {}

    def delayed(delay: int, ticks: Any) -> Delays:
        delays = np.zeros(world.ticks, np.int64)
        delays[ticks] = delay
        return delays

    life = round(controller.command_lifetime_s(world.experiment) / world.tick_s)
    for part in PARTS:
        first, end = at[part]
        for length in LENGTHS:
            if length < min(life, end - first):
                begin = int(drawn.integers(first, end - length + 1))
                made[part, f"{length}"] = delayed(LOST, slice(begin, begin + length))
    for part in SCATTERED:
        first, end = at[part]
        for share in SHARES:
            ticks = first + np.flatnonzero(drawn.random(end - first) < share)
            made[part, f"{100 * share:g} %"] = delayed(LOST, ticks)
            begins = first + np.flatnonzero(drawn.random(end - first) < share / STRETCH)
            late = (begins[:, None] + np.arange(STRETCH)).ravel()
            made[part, f"{100 * share:g} % late"] = delayed(LATE_TICKS, late[late < end])
    return made


def highest(ladder: Sequence[Hit]) -> int:
    """Number of rungs below the first failure whose highest passes, ignoring what is invalid."""
    passes = [hit.recorded.passes("any") for hit in ladder]
    failed = passes.index(False) if False in passes else len(passes)
    return max((rung + 1 for rung in range(failed) if passes[rung]), default=0)


@dataclass
class Counted:
    """Ladders of a cell: how many, moved, and hits: how many, changed, hidden."""

    ladders: int = 0
    moved: int = 0
    hits: int = 0
    changed: int = 0
    hidden: int = 0

    def add(self, other: Counted) -> None:
        """Pool with another one."""
        for name in self.__dataclass_fields__:
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def ladder(self, before: Sequence[Hit], after: Sequence[Hit]) -> None:
        """Take one ladder and the same with losses."""
        self.ladders += 1
        self.moved += abs(highest(after) - highest(before)) > 1
        for one, other in zip(before, after, strict=True):
            was, now = one.recorded.kind, other.recorded.kind
            self.hits += 1
            self.changed += was is not now
            self.hidden += was is not Kind.STABLE and now is Kind.STABLE


def studied(name: str, ladders: int) -> dict[Cell, Counted]:
    """Every cell of a world."""
    rate, found = " ".join(name.split()[:2]), {}
    middle = World(name).stiffest()
    rungs = [middle * RUNG**rung for rung in range(-BESIDE, BESIDE + 1)]
    previous: list[Hit] = []
    for seed in range(ladders):
        world, drawn = World(name, seed), np.random.default_rng([seed, 17])
        before = [world.hit(stiffness) for stiffness in rungs]
        at = spans(before[0], world.tick_s, world.limits.tail_s)
        if previous:
            found.setdefault((rate, "", "another start"), Counted()).ladder(previous, before)
        previous = before
        for (part, loss), delays in losses(world, at, drawn).items():
            after = [world.hit(stiffness, delays) for stiffness in rungs]
            found.setdefault((rate, part, loss), Counted()).ladder(before, after)
    return found


def lower(share: int, of: int) -> float:
    """Lower end of the one-sided 95 % Clopper-Pearson interval."""
    return float(stats.beta.ppf(0.05, share, of - share + 1)) if share else 0.0


def word(cell: Counted, control: Counted) -> str:
    """What a cell is, by the module's rule."""
    bound = max(HARMLESS, control.moved / max(control.ladders, 1))
    if cell.moved / cell.ladders <= bound:
        return ""
    return "harmful" if lower(cell.moved, cell.ladders) > bound else "undecided"


def tell(found: dict[Cell, Counted], say: Callable[[str], None]) -> None:
    """Print the table: a row for each part and loss, a column for each rate."""
    rates = sorted({rate for rate, _, _ in found}, key=lambda text: -int(text.split()[0]))
    say("| part | lost | " + " | ".join(rates) + " |")
    say("|---" * (len(rates) + 2) + "|")
    for part, loss in dict.fromkeys((part, loss) for _, part, loss in found):
        texts = []
        for rate in rates:
            cell = found.get((rate, part, loss))
            if cell is None:
                texts.append("")
                continue
            shown = f"{100 * cell.moved / cell.ladders:.0f} % {word(cell, found[rate, '', 'another start'])}".strip()
            hits = f"{100 * cell.changed / cell.hits:.1f}, {100 * cell.hidden / cell.hits:.1f}"
            texts.append(f"{shown} ({hits})")
        say(f"| {part} | {loss} | " + " | ".join(texts) + " |")


def main(arguments: Sequence[str]) -> None:
    """Study every world and print the table: share of ladders changed (of hits changed, hidden; in per cent)."""
    ladders = int(arguments[0]) if arguments else LADDERS
    found: dict[Cell, Counted] = {}
    began = time.monotonic()
    with ProcessPoolExecutor(2) as pool:
        running = {pool.submit(studied, name, ladders): name for name in WORLDS}
        for done, future in enumerate(as_completed(running), 1):
            for cell, counted in future.result().items():
                found.setdefault(cell, Counted()).add(counted)
            spent = time.monotonic() - began
            print(f"{done}/{len(running)} {running[future]}, {spent:.0f} s", file=sys.stderr, flush=True)
    tell(found, print)


if __name__ == "__main__":
    main(sys.argv[1:])
