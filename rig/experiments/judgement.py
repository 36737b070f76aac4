"""From a recording to its verdicts: the recorded one, and in simulation the true one."""

from __future__ import annotations

from typing import Any

from firmware_protocol.faults import Fault
from rig.config import Experiment, experiment_from_mapping, verdict_limits
from rig.control import verdict
from rig.control.verdict import Kind, Measured, Verdict
from rig.core.sample import Phase
from rig.recording.data import Recording

FINISHED = "finished"  # what the trailer of a whole run says
THREW_OUT = {  # reasons of a trailer: what the wall did to the handle
    "out_of_window": "the wall threw the handle out of its window or beyond the speed limit",
    "energy": "the wall gave the hand more energy than rig.limits.energy",
    "violent": "the wall beat: the effort swung between nothing and its limit",
}
THROWN_OUT = {Fault.POSITION_WINDOW.name, Fault.OVER_SPEED.name, Fault.RUNAWAY.name}


def experiment_of(recording: Recording) -> Experiment:
    """Return the experiment in effect; `ConfigError` when this version cannot read it."""
    return experiment_from_mapping(recording.experiment, "the recording's header")


def judge(recording: Recording) -> tuple[Verdict, Verdict | None]:
    """Return the verdict from what was recorded, and the one from the truth where there is one.

    A push that did not last is invalid, unless the wall threw the handle out: then it is unstable.
    """
    experiment = experiment_of(recording)
    limits = verdict_limits(experiment)
    tick_s = 1.0 / experiment.controller.position_rate
    resolution = experiment.rig.encoder.resolution
    recorded = verdict.judge(verdict.recorded_signals(recording.rows, tick_s, resolution), limits)
    true = None
    if recording.has_truth:
        wall = experiment.wall
        true = verdict.judge(verdict.true_signals(recording.rows, tick_s, wall.position, wall.side), limits)
    early = ended_early(recording)
    if early is None and experiment.trial.kind == "excitation":
        early = Kind.INVALID, "the rig was shaken about its wall, not driven into it: see rig impedance"
    if early is None:
        return recorded, true
    return verdict.overruled(recorded, *early), None if true is None else verdict.overruled(true, *early)


def measure(recording: Recording) -> tuple[Measured, Measured | None]:
    """Measure a recording, and its truth if it has one: what `judge` goes by, and what each criterion says."""
    experiment = experiment_of(recording)
    limits, wall = verdict_limits(experiment), experiment.wall
    tick_s, thrown_out = 1.0 / experiment.controller.position_rate, ended_early(recording) is not None
    signals = verdict.recorded_signals(recording.rows, tick_s, experiment.rig.encoder.resolution)
    recorded = verdict.measured(signals, limits, thrown_out=thrown_out)
    if not recording.has_truth:
        return recorded, None
    true = verdict.true_signals(recording.rows, tick_s, wall.position, wall.side)
    return recorded, verdict.measured(true, limits, thrown_out=thrown_out)


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


def as_trailer(recorded: Verdict, true: Verdict | None) -> dict[str, Any]:
    """What a recording keeps of its verdicts."""
    return {"verdict": recorded.as_mapping(), "verdict_true": None if true is None else true.as_mapping()}
