"""Estimate what to expect of a search before a person has touched the handle: where its limit lies, and what it costs.

Checks and plans of a session call it. Observers whose K50 lie at both ends of the expected range and between
(`rig.session.search._observer`) show how many trials a rule takes there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from rig.analysis.theory import k_max_curve
from rig.config import Experiment
from rig.core.errors import ConfigError
from rig.core.operators import NO_OPERATOR
from rig.doctor.late_loops import LateLoops
from rig.session.planning._protocol import Protocol, Search
from rig.session.planning._schedule import Block, asking, levels_of
from rig.session.search._observer import Observer, run

# K_max of the papers' rigs over that of the linear loop, at most (`rig.analysis.theory._loop`)
FRICTION_RAISES = 2.5
USUALLY_RAISES = 1.2  # in the simulated hand on koul-compliant at B = 0: 620 over 519 N·m/rad
# of a damped wall's: there uniform 20 kHz at B = 0.25, 458 of 1300 N·m/rad; others far more
ENCODER_LEAVES = 0.35
SPREAD = 0.05  # of an observer, over K50: verdicts turn within some 20 % of stiffness
LAPSE_RATE = 0.02
OBSERVERS = 5  # simulated for each expected limit
MOST_TRIALS = 500  # of one simulated search: more than a participant can endure


@dataclass(frozen=True, slots=True)
class ExpectedRange:
    """From the least to the most that is expected, and what is likely."""

    least: float
    likely: float
    most: float

    def __add__(self, other: ExpectedRange) -> ExpectedRange:
        return ExpectedRange(self.least + other.least, self.likely + other.likely, self.most + other.most)

    def __mul__(self, factor: float) -> ExpectedRange:
        return ExpectedRange(self.least * factor, self.likely * factor, self.most * factor)

    @property
    def values(self) -> tuple[float, float, float]:
        """Return least, likely and most, in rising order."""
        return self.least, self.likely, self.most


NOTHING = ExpectedRange(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Where the limit of one condition and damping is expected.

    Attributes
    ----------
    by_hand
        Largest stable stiffness of linear theory, by hand: ``none``, and the grips of `rig.core.operators`.
    limit
        Of a search, friction and encoder allowed for; without theory the whole range of levels.
    note
        Why theory gives no limit, or what it assumes instead of the estimator; empty otherwise.
    """

    by_hand: Mapping[str, float]
    limit: ExpectedRange
    note: str = ""

    @property
    def free(self) -> float | None:
        """Return the largest stable stiffness without a hand on the handle."""
        return self.by_hand.get(NO_OPERATOR)

    @property
    def in_hand(self) -> tuple[float, float] | None:
        """Return those of the hand that bears least, and of the hand that bears most."""
        held = [value for hand, value in self.by_hand.items() if hand != NO_OPERATOR]
        return (min(held), max(held)) if held else None


def expected_limits(
    experiment: Experiment, dampings: tuple[float, ...], wanted: Search
) -> dict[float, Expected]:
    """Return where the limits of one condition lie, by damping.

    Parameters
    ----------
    experiment
        Of the condition, at any wall.
    dampings
        B of its searches.
    wanted
        Whose levels stand in where theory gives no limit.
    """
    levels = levels_of(wanted)
    unknown = ExpectedRange(levels[0], math.sqrt(levels[0] * levels[-1]), levels[-1])
    try:
        loops = LateLoops.of(experiment, experiment.rig.simulation.computation_delay_ticks)
        curves = {
            hand: [k_max_curve(loop, None, dampings) for loop in of_hand]
            for hand, of_hand in loops.by_hand.items()
        }
    # No theory for this experiment: the expected limit is then anywhere in the range, and the note says why.
    except ConfigError as error:
        return {damping: Expected(by_hand={}, limit=unknown, note=error.message) for damping in dampings}
    found = {}
    for place, damping in enumerate(dampings):
        by_hand = {hand: min(curve[place].stiffness for curve in of) for hand, of in curves.items()}
        meant = by_hand if experiment.trial.kind != "human" else _held(by_hand)
        own = meant.get(NO_OPERATOR, meant.get(experiment.operator.grip, max(meant.values())))
        damped = damping > 0.0
        # Linear theory has no Coulomb friction, which stabilises stiffer walls, and no encoder, whose noise under
        # damping takes most of a limit: so the range about theory's limit is wide.
        limit = ExpectedRange(
            min(meant.values()) * (ENCODER_LEAVES if damped else 1.0),
            own * (1.0 if damped else USUALLY_RAISES),
            max(meant.values()) * FRICTION_RAISES,
        )
        found[damping] = Expected(by_hand=by_hand, limit=limit, note=loops.stand_in)
    return found


def _held(by_hand: Mapping[str, float]) -> dict[str, float]:
    return {hand: value for hand, value in by_hand.items() if hand != NO_OPERATOR}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedTrials:
    """What one search takes: trials, and how many of them are of unstable walls.

    `ended_by_most` counts the simulated searches, of `simulated`, that ended by `most` before they had their turns.
    """

    count: ExpectedRange
    failures: ExpectedRange
    ended_by_most: int = 0
    simulated: int = 0

    def __add__(self, other: ExpectedTrials) -> ExpectedTrials:
        return ExpectedTrials(count=self.count + other.count, failures=self.failures + other.failures)

    def __mul__(self, factor: float) -> ExpectedTrials:
        return ExpectedTrials(count=self.count * factor, failures=self.failures * factor)


NO_TRIALS = ExpectedTrials(count=NOTHING, failures=NOTHING)


def expected_trials(wanted: Search, limit: ExpectedRange) -> ExpectedTrials:
    """Simulate a search with observers whose K50 lie around the expected limit; return its numbers of trials.

    Invalid and repeated trials come on top.
    """
    levels, settings = levels_of(wanted), wanted.settings
    if wanted.rule == "psi" and not settings.get("enough"):  # same for all observers, half of it above K50
        hits = float(settings.get("hits", 25))
        return ExpectedTrials(
            count=ExpectedRange(hits, hits, hits), failures=ExpectedRange(hits / 4, hits / 2, 3 * hits / 4)
        )
    if wanted.rule == "grid":
        repeats = float(settings.get("repeats", 5))
        above = sorted(repeats * sum(level > k50 for level in levels) for k50 in limit.values)
        hits = repeats * len(levels)
        return ExpectedTrials(count=ExpectedRange(hits, hits, hits), failures=ExpectedRange(*above))
    if wanted.rule == "ascending" and settings.get("repeats", 5) != 1:  # series are all alike
        series = replace(wanted, settings={**settings, "repeats": 1})
        return expected_trials(series, limit) * float(settings.get("repeats", 5))
    taken = {k50: _simulate_searches(wanted, max(k50, 1e-3 * levels[0])) for k50 in set(limit.values)}
    count, failures, ended_by_most = zip(*(taken[k50] for k50 in limit.values), strict=True)
    return ExpectedTrials(
        count=ExpectedRange(min(count), count[1], max(count)),
        failures=ExpectedRange(min(failures), failures[1], max(failures)),
        ended_by_most=sum(ended_by_most),
        simulated=OBSERVERS * len(limit.values),
    )


def likely_trials(protocol: Protocol, blocks: Iterable[Block]) -> dict[str, float]:
    """About how many trials of each condition a session takes, whatever the limits are; practice with its own."""
    found = dict.fromkeys((condition.name for condition in protocol.condition), 0.0)
    searches = {one.name: protocol.search_of(one) for one in protocol.condition}
    likely: dict[str, float] = {}  # by search: most conditions have the same one
    for one in (one for block in blocks for one in block.runs):
        if one.practice:
            found[one.condition] += len(protocol.practice.stiffness)
            continue
        wanted = searches[one.condition]
        key = repr(wanted)
        if key not in likely:
            levels = levels_of(wanted)
            middle = math.sqrt(levels[0] * levels[-1])
            likely[key] = expected_trials(wanted, ExpectedRange(middle, middle, middle)).count.likely
        found[one.condition] += likely[key]
    return found


def _simulate_searches(wanted: Search, k50: float) -> tuple[float, float, int]:
    """Mean trials of some observers, those among them that were not stable, and searches that ended by `most`."""
    observer = Observer(threshold=k50, spread=SPREAD * k50, lapse_rate=LAPSE_RATE)
    rules = [asking(wanted, seed) for seed in range(OBSERVERS)]
    answers = [run(rule, observer, seed, MOST_TRIALS) for seed, rule in enumerate(rules)]
    failures = sum(answer.stable is False for given in answers for answer in given)
    short = sum(rule.estimate(given).ended_by_most for rule, given in zip(rules, answers, strict=True))
    return sum(map(len, answers)) / OBSERVERS, failures / OBSERVERS, short
