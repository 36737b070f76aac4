"""What is exported of a trial besides its recording: what was hit, what was said of it, and whether it counts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rig.session.analysis.study import Session
from rig.session.state import Trial

FACTS: Mapping[str, tuple[str, str]] = {  # name: meaning, quantity or unit
    "trial": ("number of the trial over the session, practice and repeated ones included", ""),
    "block": ("block of the session, from 1; 0 is practice", ""),
    "search_run": ("search that asked for the wall, numbered over the session; 0 is practice", ""),
    "repeat": ("which repeat of this condition and damping the search is, from 1", ""),
    "attempt": ("1, or more where the trial before it said nothing", ""),
    "condition": ("what is compared, as the protocol names it", ""),
    "damping": ("B of the wall", "damping"),
    "stiffness": ("K of the wall", "stiffness"),
    "track": ("which track of the search asked, from 0", ""),
    "catch": ("1 for a catch trial, which moves no track", ""),
    "practice": ("1 for a practice trial", ""),
    "counts": ("1 when the trial counts; 0 for practice, and for what void tells", ""),
    "void": (
        "why the trial does not count: redone, restarted (its block began anew), or left out afterwards",
        "",
    ),
    "ended": ("finished, or why the recording ended early", ""),
    "automatic": ("verdict from the recording: stable, limit cycle, unstable or invalid", ""),
    "verdict": ("verdict of whoever judged: stable, buzz, unstable or unsure", ""),
    "judged_by": ("person, automatic or simulated", ""),
    "response_time": ("from the question to the verdict", "s"),
    "sha256": ("of the sealed recording", ""),
}


def facts_of(trial: Trial, void: str) -> dict[str, Any]:
    """Value of each of `FACTS`; `void` says why the trial does not count."""
    return {
        "trial": trial.trial,
        "block": trial.block,
        "search_run": trial.run,
        "repeat": trial.repeat,
        "attempt": trial.attempt,
        "condition": trial.condition,
        "damping": trial.damping,
        "stiffness": trial.stiffness,
        "track": trial.track,
        "catch": trial.catch,
        "practice": trial.practice,
        "counts": not trial.void and not trial.practice,
        "void": void,
        "ended": trial.ended,
        "automatic": trial.automatic,
        "verdict": trial.verdict,
        "judged_by": trial.by,
        "response_time": trial.took_s,
        "sha256": trial.sha256,
    }


def unusable(session: Session, trial: Trial) -> str | None:
    """Why the recording of a trial must not be exported, as a sentence; None when it may."""
    found = session.recordings.get(trial.trial)
    if found in {"missing", "changed"}:
        return f"{session.code}, trial {trial.trial}: its recording is {found}"
    return None


def file_name(code: str) -> str:
    """A participant's code as the name of a file or directory: what a path could mean otherwise is left out."""
    return re.sub(r"[^\w.+-]", "-", code).lstrip(".") or "-"
