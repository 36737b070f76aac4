"""The lines that a person at the rig confirms before it is armed; the terminal and the requesting page show the same.

One line is a digest of all settings that decide what the rig does, so that the person and the operator can check that
they mean the same run. The job refuses to start if the digest has changed, for example because a file was edited.
"""

from collections.abc import Sequence

from rig.config import Experiment
from rig.core.sample import unit_of
from rig.extras.console.client import Client
from rig.extras.console.requests import Run
from rig.extras.console.session_requests import BeginSession
from rig.extras.console.terminal import Terminal

ENDS = "ends when no page operates the rig any more"


def describe_run(request: Run, experiment: Experiment, digest: str) -> list[str]:
    """Return the lines to confirm for a run on a real rig; `experiment` includes the request's changes."""
    trial, wall = experiment.trial, experiment.wall
    stiffness, damping = (unit_of(name, experiment.rig.motion) for name in ("stiffness", "damping"))
    longest_s = trial.duration_s + trial.hold_s
    changed = [f"{key} = {value}" for key, value in request.changes.items()]
    return [
        f"{request.url} for a {request.job} on {request.rig}",
        f"changed: {', '.join(changed) or 'nothing'}",
        f"a {trial.kind} trial of {longest_s:g} s at most",
        f"wall: K {wall.stiffness:g} {stiffness}, B {wall.damping:g} {damping}, law {wall.law}",
        f"without a page: {'continues to its end' if request.is_detached else ENDS}",
        f"experiment {digest}",
    ]


def describe_session(request: BeginSession, url: str, digest: str) -> list[str]:
    """Return the lines to confirm for a session on a real rig."""
    whose = f"{request.code} with {request.protocol}"
    if request.directory:
        whose = f"{request.directory}, resumed{' at the block' if request.at == 'block' else ''}"
    consents = {
        "arming walls that `rig session check` refuses": request.arm_anyway,
        "a computer or link that loses samples": request.lossy_anyway,
        "another device than before": request.other_device,
        "another protocol than the study's earlier sessions": request.other_protocol,
    }
    return [
        f"{url} for the session of {whose}",
        f"consents to: {', '.join(what for what, given in consents.items() if given) or 'nothing else'}",
        "lasts until its protocol is done, or the operator leaves",
        "without a page: a running hit ends, and the session pauses",
        f"protocol and experiment {digest}",
    ]


async def insist(terminal: Terminal, client: Client, url: str, lines: Sequence[str]) -> None:
    """Show the lines on the page and in the terminal; raise `ConfigError` unless the person at the terminal agrees."""
    client.put_newest({"say": "consent", "lines": list(lines)})
    try:
        await terminal.insist(url, lines)
    finally:
        client.put_newest({"say": "consent", "lines": None})
