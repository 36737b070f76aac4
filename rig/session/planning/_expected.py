"""Estimate the stiffness limit and the number of trials of a search before any person has touched the handle.

Linear theory gives a range for the limit. Simulated observers (`rig.session.search._observer`), with limits at both
ends and in the middle of this range, give the number of trials. Plans of studies and the checks of a protocol use it.
No result of a study depends on it.
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
from rig.session.search._ascending import Ascending
from rig.session.search._grid import LevelGrid
from rig.session.search._observer import Observer, run
from rig.session.search._psi import Psi

# Largest ratio of the measured K_max of the papers' rigs to K_max of the linear loop (`rig.analysis.theory._loop`).
FRICTION_RAISES = 2.5
# Typical ratio: with the simulated hand on koul-compliant at B = 0, 620 N·m/rad instead of 519.
USUALLY_RAISES = 1.2
# Fraction of linear theory's K_max that encoder noise leaves of a damped wall: 458 of 1300 N·m/rad with uniform
# sampling at 20 kHz and B = 0.25 on koul-compliant; other schemes keep far more.
ENCODER_LEAVES = 0.35
SPREAD = 0.05  # s / K50 of an observer: verdicts turn from stable to unstable within some 20 % of stiffness
LAPSE_RATE = 0.02
# Smallest threshold of a simulated observer over the lowest level, if theory expects no stable wall.
LEAST_K50 = 1e-3
# Number of simulated searches for each expected limit.
OBSERVERS = 5
# A simulated search ends after this number of trials, more than a participant can endure.
MOST_TRIALS = 500


@dataclass(frozen=True, slots=True)
class ExpectedRange:
    """Expected range of a quantity: smallest (`least`), most likely (`likely`) and largest value (`most`)."""

    least: float
    likely: float
    most: float

    def __add__(self, other: ExpectedRange) -> ExpectedRange:
        return ExpectedRange(self.least + other.least, self.likely + other.likely, self.most + other.most)

    def __mul__(self, factor: float) -> ExpectedRange:
        return ExpectedRange(self.least * factor, self.likely * factor, self.most * factor)

    @property
    def values(self) -> tuple[float, float, float]:
        """Smallest, most likely and largest value, in ascending order."""
        return self.least, self.likely, self.most


NOTHING = ExpectedRange(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Expected stiffness limit of one condition at one damping.

    Attributes
    ----------
    by_hand
        Largest stable stiffness by linear theory for each grip of a hand (relaxed, normal, firm), and ``none``.
    limit
        Expected limit that a search finds, with friction and encoder; without theory the whole range of tested levels.
    note
        Reason for which theory gives no limit, or a simplification that theory makes for the estimator; otherwise
        empty.
    """

    by_hand: Mapping[str, float]
    limit: ExpectedRange
    note: str = ""

    @property
    def free(self) -> float | None:
        """Largest stable stiffness (N·m/rad or N/m) by linear theory without a hand; None without theory."""
        return self.by_hand.get(NO_OPERATOR)

    @property
    def in_hand(self) -> tuple[float, float] | None:
        """Smallest and largest stable stiffness (N·m/rad or N/m) by theory over all grips of a hand, or None."""
        held = [value for hand, value in self.by_hand.items() if hand != NO_OPERATOR]
        return (min(held), max(held)) if held else None


def expected_limits(
    experiment: Experiment, dampings: tuple[float, ...], wanted: Search
) -> dict[float, Expected]:
    """Return the expected stiffness limit of one condition for each of its dampings B (N·m·s/rad or N·s/m).

    `experiment` has the settings of the condition with any wall. If theory gives no limit, the range of the levels of
    the search `wanted` is returned.
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
        # A motor's push meets the free handle too; a person's hand is always on it.
        possible = by_hand if experiment.trial.kind != "human" else _held(by_hand)
        own = possible.get(NO_OPERATOR, possible.get(experiment.operator.grip, max(possible.values())))
        damped = damping > 0.0
        # Linear theory has no Coulomb friction, which stabilises stiffer walls, and no encoder, whose noise under
        # damping takes most of a limit: so the range about theory's limit is wide.
        limit = ExpectedRange(
            min(possible.values()) * (ENCODER_LEAVES if damped else 1.0),
            own * (1.0 if damped else USUALLY_RAISES),
            max(possible.values()) * FRICTION_RAISES,
        )
        found[damping] = Expected(by_hand=by_hand, limit=limit, note=loops.stand_in)
    return found


def _held(by_hand: Mapping[str, float]) -> dict[str, float]:
    return {hand: value for hand, value in by_hand.items() if hand != NO_OPERATOR}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedTrials:
    """Expected numbers of trials (`count`), and of trials with unstable walls (`failures`), in one search.

    Of `simulated` staircases, `ended_by_most` reached their largest number of verdicts before enough reversals.
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
    """Return the expected numbers of valid trials in a search; simulated persons with limits near `limit` give them."""
    levels, settings = levels_of(wanted), wanted.settings
    # Without `enough`, Psi always uses all hits, about half of them above K50.
    if wanted.rule == "psi" and not settings.get("enough"):
        hits = float(settings.get("hits", Psi.hits))
        return ExpectedTrials(
            count=ExpectedRange(hits, hits, hits), failures=ExpectedRange(hits / 4, hits / 2, 3 * hits / 4)
        )
    if wanted.rule == "grid":
        repeats = float(settings.get("repeats", LevelGrid.repeats))
        above = sorted(repeats * sum(level > k50 for level in levels) for k50 in limit.values)
        hits = repeats * len(levels)
        return ExpectedTrials(count=ExpectedRange(hits, hits, hits), failures=ExpectedRange(*above))
    # All series are alike on average: one is simulated, and the result multiplied.
    if wanted.rule == "ascending" and (repeats := settings.get("repeats", Ascending.repeats)) != 1:
        series = replace(wanted, settings={**settings, "repeats": 1})
        return expected_trials(series, limit) * float(repeats)
    taken = {k50: _simulate_searches(wanted, max(k50, LEAST_K50 * levels[0])) for k50 in set(limit.values)}
    count, failures, ended_by_most = zip(*(taken[k50] for k50 in limit.values), strict=True)
    return ExpectedTrials(
        count=ExpectedRange(min(count), count[1], max(count)),
        failures=ExpectedRange(min(failures), failures[1], max(failures)),
        ended_by_most=sum(ended_by_most),
        simulated=OBSERVERS * len(limit.values),
    )


def likely_trials(protocol: Protocol, blocks: Iterable[Block]) -> dict[str, float]:
    """Return the approximate number of trials of each condition in a session's blocks, practice included."""
    found = dict.fromkeys((condition.name for condition in protocol.condition), 0.0)
    searches = {one.name: protocol.search_of(one) for one in protocol.condition}
    for one in (one for block in blocks for one in block.runs):
        if one.practice:
            found[one.condition] += len(protocol.practice.stiffness)
            continue
        wanted = searches[one.condition]
        levels = levels_of(wanted)
        middle = math.sqrt(levels[0] * levels[-1])
        found[one.condition] += expected_trials(wanted, ExpectedRange(middle, middle, middle)).count.likely
    return found


# By the settings of a search, which most conditions share, and K50.
_simulated: dict[tuple[str, float], tuple[float, float, int]] = {}


def _simulate_searches(wanted: Search, k50: float) -> tuple[float, float, int]:
    key = repr(wanted), k50
    if key not in _simulated:
        observer = Observer(threshold=k50, spread=SPREAD * k50, lapse_rate=LAPSE_RATE)
        rules = [asking(wanted, seed) for seed in range(OBSERVERS)]
        answers = [run(rule, observer, seed, MOST_TRIALS) for seed, rule in enumerate(rules)]
        failures = sum(answer.stable is False for given in answers for answer in given)
        short = sum(rule.estimate(given).ended_by_most for rule, given in zip(rules, answers, strict=True))
        _simulated[key] = sum(map(len, answers)) / OBSERVERS, failures / OBSERVERS, short
    return _simulated[key]
