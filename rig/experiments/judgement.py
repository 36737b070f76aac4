"""From a recording to its verdicts: the recorded one, and in simulation the true one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from firmware_protocol.faults import Fault
from rig.config import Experiment, experiment_from_mapping, verdict_limits
from rig.control import judging, verdict
from rig.control.verdict import Kind, Measured, Verdict
from rig.core.sample import Phase
from rig.recording.data import Recording

FINISHED = "finished"  # what the trailer of a whole run says
THREW_OUT = {  # reasons of a trailer: what the wall did to the handle
    "out_of_window": "the wall threw the handle out of its window or beyond the speed limit",
    "energy": "the wall gave the hand more energy than rig.limits.energy",
    "violent": "the wall was violent: the effort oscillated between nothing and its limit",
}
THROWN_OUT = {Fault.POSITION_WINDOW.name, Fault.OVER_SPEED.name, Fault.RUNAWAY.name}


def experiment_of(recording: Recording) -> Experiment:
    """Return the experiment in effect; `ConfigError` when this version cannot read it."""
    return experiment_from_mapping(recording.experiment, "the recording's header")


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What a recording says of its wall.

    Attributes
    ----------
    verdict, verdict_true
        From what was recorded, and from the truth where there is one. A push that did not last is invalid, unless the
        wall threw the handle out: then it is unstable.
    measured, measured_true
        The numbers that these go by, and what each criterion says.
    early
        What an early end makes of the verdict (`ended_early`).
    """

    verdict: Verdict
    verdict_true: Verdict | None
    measured: Measured
    measured_true: Measured | None
    early: tuple[Kind, str] | None

    def as_trailer(self) -> dict[str, Any]:
        """What a recording keeps of its verdicts."""
        true = self.verdict_true
        return {
            "verdict": self.verdict.as_mapping(),
            "verdict_true": None if true is None else true.as_mapping(),
        }


def judge(recording: Recording, experiment: Experiment) -> Judgement:
    """Measure and judge a recording; `experiment` is the one in effect, from `experiment_of` where nobody has it."""
    limits, wall, early = verdict_limits(experiment), experiment.wall, ended_early(recording)
    tick_s, thrown_out = 1.0 / experiment.controller.position_rate, early is not None
    signals = judging.recorded_signals(recording.rows, tick_s, experiment.rig.encoder.resolution)
    measured, true = judging.measured(signals, limits, thrown_out=thrown_out), None
    if recording.has_truth:
        signals = judging.true_signals(recording.rows, tick_s, wall.position, wall.side)
        true = judging.measured(signals, limits, thrown_out=thrown_out)
    overruling = early
    if early is None and experiment.trial.kind == "excitation":
        overruling = (
            Kind.INVALID,
            "the rig was excited about its wall, not driven into it: see rig impedance",
        )
    return Judgement(
        verdict=_overruled(measured, overruling),
        verdict_true=None if true is None else _overruled(true, overruling),
        measured=measured,
        measured_true=true,
        early=early,
    )


def _overruled(measured: Measured, overruling: tuple[Kind, str] | None) -> Verdict:
    return measured.verdict if overruling is None else verdict.overruled(measured.verdict, *overruling)


def ended_early(recording: Recording) -> tuple[Kind, str] | None:
    """What an early end makes of the verdict: nothing after the push, else invalid, or unstable if thrown out."""
    reason = (recording.trailer or {}).get("reason", "the recording breaks off")
    phases = recording.rows["phase"]
    if reason == FINISHED or (phases == Phase.RELEASE).any():
        return None
    fault = ((recording.trailer or {}).get("fault") or {}).get("name", "")
    thrown = THREW_OUT["out_of_window"] if fault in THROWN_OUT else THREW_OUT.get(reason)
    touched = bool((recording.rows["penetration"][phases == Phase.TRIAL] > 0.0).any())
    if thrown and touched:
        return Kind.UNSTABLE, thrown
    return Kind.INVALID, f"the run ended early: {reason.replace('_', ' ')}"
