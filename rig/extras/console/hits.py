"""Jobs that hit a wall with a rig: pushed by the motor, or by a person who drags the handle of a simulated rig.

The job's process (`worker`) calls `hit` and `play`; other jobs and errands use the functions that read an experiment.
This file must not run in the server, which would delay its replies.
"""

import hashlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rig import config
from rig.config import Experiment, presets
from rig.config.controller import for_experiment
from rig.core.errors import ConfigError
from rig.core.sample import phase_name
from rig.doctor.gate_result import Gate
from rig.experiments.hits import hit as hits
from rig.experiments.hits.admission import admit
from rig.extras.console.talk import Talk
from rig.recording.canonical import canonical_json

EVERY_S = 0.05  # between two progress messages
# Free play: no baseline, foreperiod or holding time; a long thermal time constant, as no real winding heats up.
PLAY = {
    "trial.kind": "human",
    "trial.hold_s": 0.0,
    "trial.baseline_s": 0.0,
    "trial.foreperiod_s": 0.0,
    "rig.limits.thermal_time_constant_s": 8000.0,
}
SIMULATED = "sim://"


def experiment_of(content: Mapping[str, Any]) -> Experiment:
    """Return the experiment named by ``content["rig"]``: a built-in rig or a file."""
    return presets.load_named(str(content.get("rig") or "koul-compliant"))


def apply_changes(experiment: Experiment, changes: Mapping[str, Any]) -> Experiment:
    """Return the experiment with the settings that a page has changed, for a run in real time.

    Raise `RigError` if a key or value is not valid.
    """
    found = config.with_realtime(experiment, changes)
    for_experiment(found, current_quantum_a=found.rig.amplifier.current_quantum_a)
    return found


def describe_rig(rig: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``experiment`` (all settings, with those that a page has changed) and its ``digest``, for JSON."""
    experiment = apply_changes(experiment_of({"rig": rig}), changes)
    return {"experiment": config.as_mapping(experiment), "digest": digest_of(experiment)}


def digest_of(experiment: Experiment) -> str:
    """Return a short digest of all settings of an experiment: equal digests mean the same experiment."""
    return short(canonical_json(config.as_mapping(experiment)))


def short(data: bytes) -> str:
    """Return the first 8 hex digits of the SHA-256 of `data`, which two people can compare by eye."""
    found = hashlib.sha256(data).hexdigest()
    return f"{found[:4]} {found[4:8]}"


def hit(content: Mapping[str, Any], talk: Talk) -> Any:
    """Run a wall hit in real time, as a page requests it by `content`; return verdict and recording for the page.

    Raise `ConfigError` if the experiment has changed since a person at the rig confirmed it.
    """
    experiment, changes = experiment_of(content), dict(content.get("changes") or {})
    agreed = content.get("digest")
    if agreed is not None and agreed != digest_of(apply_changes(experiment, changes)):
        raise ConfigError(
            f"the experiment of {content['rig']} has changed since the operator agreed to it",
            remedy="start the run again",
        )
    return _run(experiment, content, talk, changes, str(content.get("url") or SIMULATED))


def play(content: Mapping[str, Any], talk: Talk) -> Any:
    """Run a simulated rig whose handle a person drags on a page; the page's hand position arrives in a shared file.

    `content` is the page's request, `talk` the connection to the console.
    """
    url = str(content.get("url") or SIMULATED)
    if not url.startswith("sim:"):
        raise ConfigError(
            f"{url}: the handle can be dragged with the mouse only on a simulated rig",
            remedy="use a sim: URL, or start a hit and move the real handle by hand",
        )
    url += ("&" if "?" in url else "?") + f"hand={content['hand']}"
    changes = {**PLAY, "trial.duration_s": float(content["duration_s"]), **(content.get("changes") or {})}
    return _run(experiment_of(content), content, talk, changes, url)


def _run(
    experiment: Experiment, content: Mapping[str, Any], talk: Talk, changes: Mapping[str, Any], url: str
) -> Any:
    request = hits.HitRequest(
        experiment=experiment,
        url=url,
        changes=changes,
        realtime=True,
        verified=bool(content.get("verified")),
        output=Path(str(content["output"])),
        measuring=lambda share: talk.progress(stage="measuring the link", share=share),
        judged_link=lambda gate: _report_gate(gate, talk),
        hands_off=lambda text: talk.progress(stage=text),
    )
    return list(hits.hit(request, admit, lambda _, __: _watch(talk)))


def _watch(talk: Talk) -> Callable[[int, int], None]:
    last_s = 0.0

    def report(ticks: int, phase: int) -> None:
        nonlocal last_s
        if time.monotonic() - last_s >= EVERY_S:
            last_s = time.monotonic()
            talk.progress(stage=phase_name(phase), ticks=ticks)

    return report


def _report_gate(gate: Gate, talk: Talk) -> None:
    if not gate.armable:
        talk.progress(stage="arming a simulated rig that the gate would refuse", why=gate.text)
