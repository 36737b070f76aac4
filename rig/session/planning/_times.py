"""Compute the duration of a session and the heat of the motor, from the experiment's times and the times of people.

The heat of the winding is a fraction of its budget, which is the heat after hours at the nominal effort. A push with
`load` times the nominal effort drives the heat towards load², with the thermal time constant of the winding; cooling
has the same time constant. Above the fraction ``rest.heat``, the session pauses until the heat is `COOL_TO` times that
fraction. The plan of a study, its checks and the engine's cooling pauses use it. It must not read a clock.
"""

import math
from dataclasses import dataclass, replace

from rig.config import Experiment, push_at_rest

# Chosen: time for a question that is read out and answered.
QUESTION_S = 10.0
# Chosen: time between two searches, to sit down and to look at the next one.
BETWEEN_RUNS_S = 5.0
# A cooling pause begins above the heat `rest.heat` and ends at this fraction of it, so that pauses are rare.
COOL_TO = 0.5
# Computing time of one tick of a rehearsal in virtual time: 85 to 130 µs were measured.
REHEARSED_TICK_S = 1e-4
# After this number of trials the heat is periodic: the rest of a longer session is extrapolated.
LONG = 10_000


def cooling_s(heat: float, share: float, time_constant_s: float) -> float:
    """Return how long (s) a motor cools from `heat` to a fixed part of `share`, at which a session continues.

    `heat` and `share` are relative to the heat of the winding after hours at the nominal effort.
    """
    return time_constant_s * math.log(heat / (COOL_TO * share))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialTimes:
    """Durations of the parts of one trial (s), from the time before it to the verdict after it."""

    ready: float
    homing: float
    baseline: float
    hit: float
    release: float
    verdict: float

    @property
    def recorded(self) -> float:
        """Duration (s) of the recorded part of a trial, without the time that participant and operator take."""
        return self.homing + self.baseline + self.hit + self.release

    @property
    def total(self) -> float:
        """Duration of a whole trial (s), with the times of people."""
        return self.ready + self.homing + self.baseline + self.hit + self.release + self.verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """Median durations measured in finished sessions (s), without practice.

    Attributes
    ----------
    sessions, trials
        Number of sessions and of trials that were evaluated.
    trial
        Time between the log entry of a trial and the log entry before it.
    verdict
        Time between the log entries of a trial and of its verdict; 0 if no person judges.
    question
        Time between the log entry of an answer to the questionnaire and the log entry before it.
    """

    sessions: int
    trials: int
    trial: float
    verdict: float
    question: float

    def of_people(self, planned: TrialTimes) -> TrialTimes:
        """Return the durations of a trial (s) with the measured times of people in place of the planned ones."""
        return replace(planned, ready=max(0.0, self.trial - planned.recorded), verdict=self.verdict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Heat:
    """Heat of the motor's winding in a session (1: after hours at the nominal effort), and cooling pauses.

    Attributes
    ----------
    load
        Effort of a push divided by the nominal effort.
    after_one
        Heat after one hit with a cold motor.
    peak
        Largest heat, with the pauses.
    first_pause
        Number of the trial before which the first pause occurs; 0 without a pause.
    pause_s
        Duration of the last pause (s).
    pauses
        Number of pauses.
    """

    load: float
    after_one: float
    peak: float
    first_pause: int
    pause_s: float
    pauses: int

    @property
    def cooling_s(self) -> float:
        """Total duration of the cooling pauses (s)."""
        return self.pauses * self.pause_s


def trial_times(experiment: Experiment, *, ready_s: float = 0.0, verdict_s: float = 0.0) -> TrialTimes:
    """Return the durations of the parts of one trial of an experiment.

    `ready_s` and `verdict_s` are the times that people take before and after the trial (s).
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
    """Return the heat of the motor's winding over a number of equal trials, and the pauses for cooling.

    Above the fraction `share` of the heat after hours at the nominal effort the session pauses.
    """
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
        load=load, after_one=after_one, peak=peak, first_pause=first_pause, pause_s=pause_s, pauses=pauses
    )


def _push_s(experiment: Experiment) -> float:
    """Return the time (s) for which a hit pushes with full effort, without the time of the reach to the wall."""
    trial = experiment.trial
    return trial.hold_s or max(0.0, trial.duration_s - _reaching_s(experiment))


def _reaching_s(experiment: Experiment) -> float:
    """Return the time (s) from the cue to the contact for a person who does not hurry; 0 if the motor hits."""
    operator = experiment.operator
    return operator.begin_s + 0.5 * operator.reach_s if experiment.trial.kind == "human" else 0.0
