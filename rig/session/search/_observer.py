"""Simulate observers and measure each search rule: bias, scatter, number of hits, and coverage of the intervals.

Plans of studies, simulated persons and tests use it. No result of a person depends on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rig.session.search._psychometric import share_stable
from rig.session.search._rule import JudgedProbe, Rule

# makes a rule from `seed=`, like `functools.partial(rig.session.search.make, "psi", levels=…)`
Making = Callable[..., Rule]


@dataclass(frozen=True, slots=True, kw_only=True)
class Observer:
    """A simulated person, whose verdicts follow the psychometric function (`rig.session.search._psychometric`).

    `threshold` is K50, the stiffness at which half of the verdicts are stable, and `spread` is s, how gradually
    verdicts change with stiffness (unit of stiffness). `lapse_rate` is the fraction of verdicts that are inverted by
    mistake.
    """

    threshold: float
    spread: float
    lapse_rate: float = 0.0

    def judge(self, stiffness: float, drawn: np.random.Generator) -> bool:
        """Return a random verdict of the simulated person on a wall: True for stable."""
        return bool(drawn.random() < share_stable(stiffness, self.threshold, self.spread, self.lapse_rate))

    def level_of(self, share: float) -> float:
        """Return the stiffness of which the simulated person calls the fraction `share` stable, without lapses."""
        return float(self.threshold + self.spread * np.log((1.0 - share) / share))


def run(rule: Rule, observer: Observer, seed: int, most: int = 100_000) -> list[JudgedProbe]:
    """Return the verdicts of a simulated person on the walls that a rule chooses, until it ends, at most `most`."""
    drawn = np.random.default_rng(seed)
    answers: list[JudgedProbe] = []
    while len(answers) < most and (probe := rule.next(answers)) is not None:
        answers.append(JudgedProbe(probe, observer.judge(probe.level, drawn)))
    return answers


@dataclass(frozen=True, slots=True, kw_only=True)
class Performance:
    """How well a search rule finds a simulated person's threshold of stiffness, over many sessions.

    Attributes
    ----------
    bias, scatter
        Mean and standard deviation of the estimate minus the true stiffness (unit of stiffness); NaN if no session gave
        an estimate. The true stiffness is that at which the observer has the rule's target share of stable verdicts
        (ascending rule: a half).
    hits
        Mean number of answers in a session.
    covered
        Fraction of the 95 % intervals that contain the true stiffness.
    width
        Median width of the intervals (unit of stiffness).
    above, below
        Fraction of sessions with a limit above the levels, and below the levels.
    """

    rule: str
    observer: Observer
    sessions: int
    bias: float
    scatter: float
    hits: float
    covered: float
    width: float
    above: float
    below: float

    @property
    def censored(self) -> float:
        """Fraction of simulated sessions with a limit above or below the tested levels of stiffness."""
        return self.above + self.below


def performance(
    name: str, make: Making, observer: Observer, sessions: int, *, seed: int = 0, off_lattice: float = 0.0
) -> Performance:
    """Simulate sessions of one observer with one search rule; return bias, scatter and coverage of the estimates.

    Parameters
    ----------
    name
        Name of the rule, for the result.
    make
        Function that creates the rule of one session from the argument `seed`.
    seed
        Seed of the whole simulation, from which each session's seed is derived.
    off_lattice
        Largest random shift of K50 in a session (±, unit of stiffness). Half a step of the levels makes the result
        independent of the position of K50 between two levels.
    """
    errors, found = [], []
    for one in np.random.SeedSequence(seed).generate_state(sessions, np.uint64).tolist():
        drawn = np.random.default_rng([one, 1]).uniform(-off_lattice, off_lattice)
        person = replace(observer, threshold=observer.threshold + drawn)
        rule = make(seed=one)
        estimate = rule.estimate(run(rule, person, one))
        truth = person.level_of(estimate.share if math.isfinite(estimate.share) else 0.5)
        found.append(estimate)
        errors.append((estimate.value - truth, estimate.low <= truth <= estimate.high))
    off = np.array([error for error, _ in errors if math.isfinite(error)])
    return Performance(
        rule=name,
        observer=observer,
        sessions=sessions,
        bias=float(off.mean()) if len(off) else math.nan,
        scatter=float(off.std()) if len(off) else math.nan,
        hits=float(np.mean([one.hits for one in found])),
        covered=float(np.mean([inside for _, inside in errors])),
        width=float(np.median([one.high - one.low for one in found])),
        above=float(np.mean([one.censored == "above" for one in found])),
        below=float(np.mean([one.censored == "below" for one in found])),
    )
