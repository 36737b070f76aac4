"""From a recording to its verdicts: the recorded one, and in simulation the true one."""

from __future__ import annotations

from typing import Any

from rig import verdict
from rig.config import Experiment, experiment_from_mapping, verdict_limits
from rig.recording.data import Recording
from rig.verdict import Verdict

FINISHED = "finished"  # what the trailer of a whole run says


def experiment_of(recording: Recording) -> Experiment:
    """Return the experiment in effect; `ConfigError` when this version cannot read it."""
    return experiment_from_mapping(recording.experiment, "the recording's header")


def judge(recording: Recording) -> tuple[Verdict, Verdict | None]:
    """Return the verdict from what was recorded, and the one from the truth where there is one.

    A run that did not finish is invalid, whatever it showed until then.
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
    ending = (recording.trailer or {}).get("reason", "the writer died")
    if ending != FINISHED:
        reason = f"the run ended early: {ending}"
        return verdict.spoiled(recorded, reason), None if true is None else verdict.spoiled(true, reason)
    return recorded, true


def as_trailer(recorded: Verdict, true: Verdict | None) -> dict[str, Any]:
    """What a recording keeps of its verdicts."""
    return {"verdict": recorded.as_mapping(), "verdict_true": None if true is None else true.as_mapping()}
