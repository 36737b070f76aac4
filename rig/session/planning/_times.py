"""How long a session takes, and how warm the motor gets: from the experiment's own times and what people take.

The winding's heat is counted as a share of its budget, which is what it holds after hours at the nominal effort: a push
of `load` times that effort drives it towards load², with the winding's time constant; it cools with the same one. Above
the share that ``rest.heat`` names, the motor waits until it is at `COOL_TO` of it. It cools all the time that passes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rig.config import Experiment, push_at_rest

QUESTION_S = 10.0  # chosen: a question that is read out and answered
BETWEEN_RUNS_S = 5.0  # chosen: to sit down and to look at the next one
COOL_TO = 0.5  # of the share of heat above which a motor rests
REHEARSED_TICK_S = 1e-4  # of computing for a tick in virtual time: 85 to 130 µs were measured; roughly
LONG = 10_000  # trials after which the heat has settled, or never will


def cooling_s(heat: float, share: float, time_constant_s: float) -> float:
    """Return how long a motor rests above this share of its budget until it is at `COOL_TO` of it (s)."""
    return time_constant_s * math.log(heat / (COOL_TO * share))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialTimes:
    """Parts of one trial (s), in their order."""

    ready: float
    homing: float
    baseline: float
    hit: float
    release: float
    verdict: float

    @property
    def recorded(self) -> float:
        """Return the recorded part of a trial: all but the waiting times of people."""
        return self.homing + self.baseline + self.hit + self.release

    @property
    def total(self) -> float:
        """Return the duration of a whole trial (s)."""
        return self.ready + self.homing + self.baseline + self.hit + self.release + self.verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """Medians of finished sessions (s), practice aside.

    Attributes
    ----------
    sessions, trials
        How many are behind them.
    trial
        From the line before a trial in the log to its own.
    verdict
        From there to the verdict; 0 where no person is asked.
    question
        From the line before an answer to its own.
    """

    sessions: int
    trials: int
    trial: float
    verdict: float
    question: float

    def of_people(self, planned: TrialTimes) -> TrialTimes:
        """Return planned times of a trial with these for what people take."""
        return replace(planned, ready=max(0.0, self.trial - planned.recorded), verdict=self.verdict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Heat:
    """The winding over a session.

    Attributes
    ----------
    load
        Push over nominal effort.
    after_one
        Share of the budget after one hit of a cold motor.
    peak
        Largest share, with the pauses.
    first_pause
        Trial before which the first pause comes; 0 when none does.
    pause_s
        Length of the last one (s).
    pauses
        How many of them.
    """

    load: float
    after_one: float
    peak: float
    first_pause: int
    pause_s: float
    pauses: int

    @property
    def cooling_s(self) -> float:
        """Return the total duration of the cooling pauses (s)."""
        return self.pauses * self.pause_s


def trial_times(experiment: Experiment, *, ready_s: float = 0.0, verdict_s: float = 0.0) -> TrialTimes:
    """Return times of one trial.

    Parameters
    ----------
    experiment
        Of a wall.
    ready_s, verdict_s
        What people take before it and after it (s).
    """
    trial, homing = experiment.trial, experiment.homing
    way = abs(experiment.wall.position - trial.start)
    return TrialTimes(
        ready=ready_s,
        homing=way / homing.speed + homing.settle_s,
        baseline=trial.baseline_s + 0.5 * trial.foreperiod_s,
        hit=_reaching_s(experiment) + trial.hold_s if trial.hold_s else trial.duration_s,
        release=trial.release_s,
        verdict=verdict_s,
    )


def heat_of(experiment: Experiment, times: TrialTimes, trials: int, share: float) -> Heat:
    """Return the heat over so many trials that are all alike; `share` of the budget is where the motor has to cool."""
    limits = experiment.rig.limits
    load = min(push_at_rest(experiment), limits.effort) / limits.nominal_effort
    tau = limits.thermal_time_constant_s
    push_s = _push_s(experiment)
    warms, cools = math.exp(-push_s / tau), math.exp(-(times.total - push_s) / tau)
    heat = peak = pause_s = 0.0
    first_pause = pauses = 0
    after_one = load**2 * (1.0 - warms)
    for number in range(1, min(trials, LONG) + 1):
        if heat > share:
            pause_s = math.ceil(cooling_s(heat, share, tau))
            first_pause = first_pause or number
            pauses += 1
            heat *= math.exp(-pause_s / tau)
        heat = heat * warms + load**2 * (1.0 - warms)
        peak = max(peak, heat)
        heat *= cools
    pauses = round(pauses * max(1.0, trials / LONG))
    return Heat(
        load=load,
        after_one=after_one,
        peak=peak,
        first_pause=first_pause,
        pause_s=pause_s,
        pauses=pauses,
    )


def _push_s(experiment: Experiment) -> float:
    """Return how long a hit pushes with all its effort (s): a person's hand has to get there first."""
    trial = experiment.trial
    return trial.hold_s or max(0.0, trial.duration_s - _reaching_s(experiment))


def _reaching_s(experiment: Experiment) -> float:
    """From the cue to the contact of a person who makes no haste (s)."""
    operator = experiment.operator
    return operator.begin_s + 0.5 * operator.reach_s if experiment.trial.kind == "human" else 0.0
