"""Measure how lost and late samples change a verdict; the limits for them in `[verdict]` follow from this study.

    flock -s LOCK python -m tests.benchmarks.gaps          # the tables; some minutes on two cores
    python -m tests.benchmarks.gaps --series 8             # fewer of each case

What counts as changed, and how limits follow, was written before the first result.

**A series** is one case (rig, scheme, damping, held or not), one encoder offset and one seed: its limit K_max is the
highest stiffness that passes (criterion *any*, by the recorded signals) below every failure, on a ladder of rungs of
ratio 1.06, from six rungs below the case's K_max to six above. A ladder has the same rungs with and without losses.

**Changed** is a series whose limit lies more than one rung (6 %) away from its limit without losses, up or down. Near
the limit a hit is sensitive to anything, so what counts is the excess over the **control**: the same series with
another seed, which puts the start elsewhere within the tolerance of homing (and gives a hand another tremor), as anyone
gets who hits the same wall twice.

**Harmless** is a pattern of losses when the share of changed series exceeds that of the control by less than 5
percentage points, at 95 % confidence (one-sided, normal approximation of the difference of two shares), over all cases
together; and when in no case of at least 20 series the difference itself is above 25 points, lest one rig pays for the
others.

**Hidden** is a hit that passes as recorded while the whole truth, every tick of it, fails under *any* of heard and
instability, which the same wall does not do without losses. Harmless patterns may not hide more, by 1 percentage point
of all hits, than the control, which is a clean hit that passes as recorded though its truth fails.

**Patterns**: one gap of n samples, in the approach (ending at most 50 ms before contact), at the impact (it begins less
than n samples before first contact or up to 10 ms after it), while settling (from then to the tail) and at rest (in the
tail); samples lost at random at a rate in each of these parts or everywhere; and the same with late samples: of a
stretch of ten samples each one comes n ticks late, so that the command before holds and those after are n ticks old.
A law that gets no sample computes no command, and the device holds the last one. After a command's lifetime (five
periods, 3 ms at least) it ramps to zero, which is a device that overruled the law, and invalid already: no longer gap
is in question. A release is not judged, so nothing is lost there.

**The variable** of a limit (samples, velocity periods or time) is the one in which the shares of one rig at several
rates, by length, differ least.

**Limits**: of each part, the longest gap and the largest rate of losses or late ticks that are harmless, and all those
tried below them; a rate is rounded down to the next of 1, 2, 5 · 10ⁿ. A part in which everything that was tried is
harmless has no limit: what is lost there is counted and printed.
"""

import argparse
import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.messages import OLDEST_EDGE
from rig import config
from rig.config import controller, presets
from rig.config.controller import command_lifetime_s
from rig.config.schemes import Scheme
from rig.control import judging
from rig.control._measure import LOST_BITS
from rig.control.step import DONE, THROWN_OUT, TRIAL
from rig.control.verdict import Measured
from rig.core.sample import Phase
from rig.experiments.mapping._searches import StiffnessSearch, drive, limit_of
from sim_backend.bare.trial import Trace, run_arguments, run_ticks
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import DiscretePlant
from tests.conformance.late_samples import LOST, ages

Ints = NDArray[np.int64]

RUNG, BELOW, ABOVE = 1.06, 6, 6
SERIES, OFFSETS = 24, 8
GAPS = (1, 2, 3, 4, 5, 10, 20, 40, 58)
RATES = (0.001, 0.003, 0.01, 0.03, 0.1)
LATE_TICKS = (1, 2, 3, 4)
LATE_RATES = (0.003, 0.01, 0.03, 0.1)
STRETCH, LATE_BY = 10, 2
PLACES = ("approach", "impact", "settling", "rest")
PARTS = ("approach", "contact", "rest", "everywhere")
APPROACH_S, IMPACT_S = 0.050, 0.010
FEWEST, WORSE, WORST, HIDDEN = 20, 0.05, 0.25, 0.01  # series; shares of series and of hits
SURE = 1.645  # one-sided 95 %
CRITERION = "any"
LADDERS = {"koul": (10.0, 6000.0), "chawda": (1000.0, 3e6)}  # where the K_max of a case is looked for
NO_DELAYS = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Case:
    """A rig under a scheme at one damping; the handle is free or held by a hand."""

    preset: str
    scheme: str
    damping: float
    held: bool = False
    delay: int = 0  # ticks by which every command comes later, as over a port

    @property
    def text(self) -> str:
        return f"{self.preset} {self.scheme} B={self.damping:g}{' held' if self.held else ''}"

    @property
    def rate(self) -> int:
        return Scheme.parse(self.scheme).position_rate


CASES = (
    *(Case("koul-compliant", f"uniform:{rate}", 0.2) for rate in ("500", "1k", "2k", "20k")),
    Case("koul-compliant", "uniform:5k,cutoff_hz=200", 0.2),
    Case("koul-compliant", "dual:20k/2k", 0.5),
    *(Case("koul-rigid", f"uniform:{rate}", 0.1) for rate in ("500", "1k", "2k", "5k", "20k")),
    *(Case("koul-rigid", f"uniform:{rate}", 0.0) for rate in ("1k", "5k")),
    Case("koul-rigid", "dual:5k/1k", 0.2),
    Case("koul-compliant", "uniform:1k", 0.2, held=True),
    Case("koul-rigid", "uniform:2k", 0.1, held=True),
    Case("koul-compliant", "dual:20k/2k", 0.5, held=True),
    Case("chawda-linear", "uniform:1k", 0.0),
    *(
        Case("chawda-linear", f"uniform:1k,estimator={name}", 60.0)
        for name in ("fdm-butterworth", "kalman", "foaw-best", "levant")
    ),
    Case("chawda-linear", "uniform:5k", 60.0),
)


@dataclass(frozen=True, order=True)
class Pattern:
    """What is lost or late: `kind` in a part of the hit, and how much of it.

    `gap`: one of `amount` samples. `lost`: each sample of the part with this probability. `late`: one stretch of
    `STRETCH` samples, each `amount` ticks late. `often late`: such stretches, `LATE_BY` ticks late, that share of the
    part in all. `control`: nothing, with another seed.
    """

    kind: str
    part: str
    amount: float


CONTROL = Pattern("control", "", 0.0)


def patterns(longest: int) -> Iterator[Pattern]:
    """Yield all patterns that a device permits whose commands live `longest` ticks."""
    yield CONTROL
    for place in PLACES:
        yield from (Pattern("gap", place, n) for n in GAPS if n + 1 <= longest)
        yield from (Pattern("late", place, n) for n in LATE_TICKS if n + 1 <= longest)
    for part in PARTS:
        yield from (Pattern("lost", part, rate) for rate in RATES)
        yield from (Pattern("often late", part, rate) for rate in LATE_RATES)


@dataclass(frozen=True)
class Span:
    """The ticks, counted from the law's first sample, at which the parts of a hit begin; `end` ends the push."""

    begin: int
    contact: int
    tail: int
    end: int
    tick_s: float

    def ticks(self, seconds: float) -> int:
        return round(seconds / self.tick_s)

    def delays(self, pattern: Pattern, drawn: np.random.Generator) -> Ints:
        """Draw the delay that a pattern gives to each sample."""
        delays = np.zeros(self.end, np.int64)
        if pattern.kind in ("gap", "late"):
            amount = int(pattern.amount)
            length = amount if pattern.kind == "gap" else STRETCH
            settling = self.contact + self.ticks(IMPACT_S)
            first, last = {
                "approach": (max(self.begin, self.contact - self.ticks(APPROACH_S)), self.contact - length),
                "impact": (self.contact - length + 1, settling),
                "settling": (settling, self.tail - length),
                "rest": (self.tail, self.end - 2 * length),
            }[pattern.part]
            first = max(first, self.begin)
            start = int(drawn.integers(first, max(first + 1, last)))
            delays[start : start + length] = LOST if pattern.kind == "gap" else amount
            return delays
        first, last = {
            "approach": (self.begin, self.contact),
            "contact": (self.contact, self.tail),
            "rest": (self.tail, self.end),
            "everywhere": (self.begin, self.end),
        }[pattern.part]
        if pattern.kind == "lost":
            delays[first:last][drawn.random(last - first) < pattern.amount] = LOST
        else:
            for start in np.flatnonzero(drawn.random(last - first) < pattern.amount / STRETCH):
                delays[first + start : min(first + start + STRETCH, last)] = LATE_BY
        return delays


class SeriesRig:
    """One rig at one encoder offset with one seed, hit with and without losses; measured as recorded and as true."""

    def __init__(self, case: Case, offset: float, seed: int) -> None:
        changes: dict[str, Any] = {
            "wall.damping": case.damping, "rig.encoder.offset": offset, "trial.seed": seed,
            "rig.simulation.computation_delay_ticks": case.delay, "verdict.lowpass_hz": min(400.0, 0.4 * case.rate),
        }  # fmt: skip
        if case.held:
            changes |= {"trial.kind": "human", "trial.duration_s": 1.5}
        experiment = Scheme.parse(case.scheme).applied(presets.load(case.preset))
        experiment = config.override(experiment, changes, "the study")
        self.tick_s = 1.0 / case.rate
        self.longest = math.floor(command_lifetime_s(experiment) / self.tick_s + 1e-9)
        experiment = replace(experiment, trial=replace(experiment.trial, release_s=self.tick_s))
        trial, homing = experiment.trial, experiment.homing
        model = config.rig_model(experiment)
        quantum = experiment.rig.amplifier.current_quantum_a
        self.wall, self.limits = experiment.wall, config.verdict_thresholds(experiment)
        self.unlimited = replace(self.limits, longest_gap=1 << 62, lost_fraction=1.0, late_fraction=2.0)
        self.template = controller.for_experiment(experiment, current_quantum_a=quantum)
        self.plant = _plant(model, self.tick_s)
        self.meter = judging.meter(self.limits, self.tick_s, experiment.rig.encoder.resolution)
        spread = homing.tolerance_counts * experiment.rig.encoder.resolution / 2.0
        self.start = trial.start + spread * float(np.random.default_rng(trial.seed).uniform(-1.0, 1.0))
        self.script = OperatorScript.of(model, self.tick_s, self.start)
        longest_s = homing.settle_s + 0.5 + trial.baseline_s + trial.duration_s
        self.trace = Trace.empty(round(longest_s / self.tick_s) + 2, self.plant)

    def hit(self, stiffness: float, delays: Ints, *, judged: bool = False) -> tuple[Measured, Measured]:
        """Hit a wall; return what is recorded and the truth. Losses invalidate neither unless `judged`."""
        wall = asdict(replace(self.wall, stiffness=stiffness))
        law, plant, trace = self.template.fresh(wall), self.plant, self.trace
        late = ages(delays) if len(delays) else NO_DELAYS
        state = plant.at_rest(self.start)
        ticks = run_ticks(*run_arguments(law, plant, state, 0.0, OLDEST_EDGE, self.script, late), trace)
        c = law.control[0]
        phases = trace.phases[:ticks]
        seen = np.flatnonzero(phases == TRIAL)
        if phases[-1] != DONE:
            seen = seen[:0]
        whole = slice(seen[0], seen[-1] + 1) if len(seen) else slice(0, 0)
        position = c["resolution"] * (trace.counts[seen] - c["reference_count"])
        lost = np.diff(seen, prepend=seen[:1] - 1) - 1
        recorded = self.meter.recorded(
            position,
            trace.currents[seen] * c["effort_quantum"],
            c["wall_side"] * (position - c["wall_position"]),
            trace.flags[seen] | lost << LOST_BITS,
        )
        states = trace.states[whole]
        true = self.meter.true(
            states[:, plant.handle_position],
            states[:, plant.handle_position + 1],
            states[:, plant.effort],
            c["wall_side"] * (states[:, plant.sensed_position] - c["wall_position"]),
            trace.flags[whole],
        )
        thrown_out = bool(trace.flags[ticks - 1] & THROWN_OUT) and not (phases == Phase.RELEASE).any()
        limits = self.limits if judged else self.unlimited
        return Measured(recorded, limits, thrown_out), Measured(true, limits, thrown_out)

    def span(self, stiffness: float) -> Span | None:
        """Return where the parts of a hit begin; None if the wall is never reached or the run ends early."""
        recorded, _ = self.hit(stiffness, NO_DELAYS)
        phases = self.trace.phases
        trial = np.flatnonzero(phases == TRIAL)
        n = recorded.numbers
        if not n["contact_s"] >= 0.0:
            return None
        begin = int(trial[0])
        contact = begin + round(n["contact_s"] / self.tick_s)
        end = begin + round(self.template.control[0]["trial_ticks"])
        return Span(begin, contact, end - round(self.limits.tail_s / self.tick_s), end, self.tick_s)


_plant = lru_cache(maxsize=64)(DiscretePlant.build)


@dataclass(frozen=True)
class Changes:
    """The effect of one pattern on one series: shift of the limit in rungs, hits, and hits that hid an instability."""

    case: Case
    pattern: Pattern
    shift: int
    hits: int
    hidden: int


def series(case: Case, number: int, middle: float) -> list[Changes]:
    """Run one series under every pattern; return nothing for a case without a stable wall."""
    if middle == 0.0:
        return []
    offset = (number % OFFSETS + 0.5) / OFFSETS
    rig = SeriesRig(case, offset, number)
    rungs = [middle * RUNG**step for step in range(-BELOW, ABOVE + 1)]
    span = rig.span(rungs[0])
    if span is None:
        return []
    clean, hits, hidden = _ladder(rig, rungs, NO_DELAYS)
    found = []
    for place, pattern in enumerate(patterns(rig.longest)):
        if pattern == CONTROL:
            other, _, _ = _ladder(SeriesRig(case, offset, 1000 + number), rungs, NO_DELAYS)
            found.append(Changes(case, pattern, other - clean, hits, hidden))
            continue
        drawn = np.random.default_rng([number, place])
        limit, struck, missed = _ladder(rig, rungs, span.delays(pattern, drawn))
        found.append(Changes(case, pattern, limit - clean, struck, missed))
    return found


def _ladder(rig: SeriesRig, rungs: Sequence[float], delays: Ints) -> tuple[int, int, int]:
    """Return the rung of the limit (−1: none passes), the number of hits, and how many of them hid an instability."""
    tried: dict[float, bool | None] = {}
    hidden = 0
    for stiffness in rungs:
        recorded, true = rig.hit(stiffness, delays)
        tried[stiffness] = recorded.passes(CRITERION)
        hidden += bool(recorded.passes(CRITERION)) and true.passes("heard") is False
        if tried[stiffness] is False:
            break
    limit = limit_of(tried).stiffness
    return (rungs.index(limit) if limit > 0.0 else -1), len(tried), hidden


def middle(case: Case) -> float:
    """Return K_max of a case: the median over a few series of a wide search."""
    lowest, highest = LADDERS[case.preset.split("-")[0]]
    search = StiffnessSearch(way="bisection", lowest=lowest, highest=highest, ratio=RUNG)
    limits = []
    for number in range(5):
        rig = SeriesRig(case, (number % OFFSETS + 0.5) / OFFSETS, number)
        tried: dict[float, bool | None] = {}

        def hit(stiffness: float, rig: SeriesRig = rig, tried: dict[float, bool | None] = tried) -> Any:
            tried[stiffness] = rig.hit(stiffness, NO_DELAYS)[0].passes(CRITERION)
            return {CRITERION: tried[stiffness]}

        drive(search.walk([CRITERION]), hit)
        limits.append(limit_of(tried).stiffness)
    return float(np.median(limits))


Group = dict[tuple[Case, Pattern], list[Changes]]


def changed(found: Sequence[Changes]) -> tuple[int, int]:
    """Return how many series moved by more than one rung, and how many there are."""
    return sum(abs(one.shift) > 1 for one in found), len(found)


def excess(found: Group, pattern: Pattern) -> tuple[float, float, float, str, int]:
    """Return the share above the control's, its upper bound, the worst case's share and name, and the series."""
    cases = [case for case, one in found if one == pattern]
    if not cases:
        return math.nan, math.nan, math.nan, "", 0
    struck = [changed(found[case, pattern]) for case in cases]
    control = [changed(found[case, CONTROL]) for case in cases]
    (x, n), (c, m) = np.sum(struck, axis=0), np.sum(control, axis=0)
    p, q = x / n, c / m
    upper = p - q + SURE * math.sqrt(p * (1.0 - p) / n + q * (1.0 - q) / m)
    apart = [
        (s[0] / s[1] - k[0] / k[1], case.text)
        for case, s, k in zip(cases, struck, control, strict=True)
        if s[1] >= FEWEST
    ]
    worst, where = max(apart, default=(math.nan, ""))
    return p - q, upper, worst, where, n


def hides(found: Group, pattern: Pattern) -> float:
    """Return the share of hits that hide an instability, above the control's share over the same cases."""
    cases = [case for case, one in found if one == pattern]

    def share(of: Pattern) -> float:
        rows = [one for case in cases for one in found[case, of]]
        return sum(one.hidden for one in rows) / sum(one.hits for one in rows)

    return share(pattern) - share(CONTROL)


def table(found: Group) -> None:
    """Print a row for each pattern: its changes beyond the control's, at each rate and over all cases."""
    rates = sorted({case.rate for case, _ in found})

    def of(keep: Callable[[Case], bool]) -> Group:
        return {key: value for key, value in found.items() if keep(key[0])}

    groups = [of(lambda case, rate=rate: case.rate == rate) for rate in rates]  # type: ignore[misc]
    named = [*(f"{rate:g} Hz" for rate in rates), "held"]
    groups.append(of(lambda case: case.held))
    print("| | | |", " | ".join(named), "| all | at most | worst case | hidden | harmless |")
    print("|---|---|--:" + "|--:" * (len(named) + 4) + "|---|")
    shares = (
        sum((np.array(changed(v)) for (_, one), v in group.items() if one == CONTROL), start=np.zeros(2))
        for group in (*groups, found)
    )
    print("| control | | |", " | ".join(f"{x:g} of {n:g}" for x, n in shares), "| | | | |")
    for pattern in sorted({one for _, one in found} - {CONTROL}):
        more, upper, worst, _, series_of_all = excess(found, pattern)
        if not series_of_all:
            continue
        cells = []
        for group in groups:
            here = excess(group, pattern)
            cells.append(f"{100 * here[0]:+.0f} %" if here[4] else "")
        hidden = hides(found, pattern)
        harmless = upper < WORSE and not worst > WORST and hidden < HIDDEN
        amount = f"{pattern.amount:g}" if pattern.amount >= 1.0 else f"{100 * pattern.amount:g} %"
        print(
            f"| {pattern.kind} | {pattern.part} | {amount} |",
            " | ".join(cells),
            f"| {100 * more:+.1f} % | {100 * upper:.1f} % | {100 * worst:+.0f} % | {100 * hidden:+.2f} % "
            f"| {'yes' if harmless else '**no**'} |",
        )


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--series", type=int, default=SERIES, help="series of each case")
    parser.add_argument("--delay", type=int, default=0, help="ticks by which every command comes later")
    parser.add_argument("--rate", type=int, help="only cases of this position rate (Hz)")
    given = parser.parse_args(arguments)
    cases = [replace(case, delay=given.delay) for case in CASES if given.rate in (None, case.rate)]
    began, found = time.monotonic(), defaultdict[tuple[Case, Pattern], list[Changes]](list)
    with ProcessPoolExecutor(2) as pool:
        middles = list(pool.map(middle, cases))
        for case, stiffness in zip(cases, middles, strict=True):
            print(f"K_max {stiffness:9.4g}  {case.text}", file=sys.stderr)
        runs = [
            pool.submit(series, case, number, stiffness)
            for number in range(given.series)
            for case, stiffness in zip(cases, middles, strict=True)
        ]
        for done, run in enumerate(as_completed(runs), 1):
            for one in run.result():
                found[one.case, one.pattern].append(one)
            print(f"\r{done} of {len(runs)}, {time.monotonic() - began:.0f} s", end="", file=sys.stderr)
    print(file=sys.stderr)
    table(found)


if __name__ == "__main__":
    main(sys.argv[1:])
