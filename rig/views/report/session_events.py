"""What did not go as planned in the sessions of a study, in the order in which it happened, from the logs alone."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from rig.control.verdict import Kind
from rig.core.sample import unit_of
from rig.session.analysis.study import Session, Study
from rig.session.log import Event
from rig.session.telling import lost

_MEASURED = {"felt": "velocity", "heard": "effort", "moved": "position"}
_REASON = re.compile(r"\b(felt|heard|moved) [-+.\de]+ above [-+.\de]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """Something that happened: to whom, how long after the session's begin (s), what, and the details."""

    participant: str
    at_s: float
    what: str
    detail: str


def deviations(study: Study) -> tuple[Deviation, ...]:
    """Decisions and interruptions: redone, amended, restarted, skipped, tried again, stopped, resumed, ended early.

    Recordings that are missing or were changed stand at the end of each session.
    """
    found: list[Deviation] = []
    for session in study.sessions:
        for event in session.events:
            tell = _TELL.get(event.kind)
            detail = None if tell is None else tell(session, event)
            if detail is not None:
                found.append(_deviation(session, event, event.kind, detail))
        for trial, state in session.recordings.items():
            if state in {"missing", "changed"}:
                found.append(_deviation(session, session.events[-1], f"recording {state}", f"trial {trial}"))
    return tuple(found)


def useless_trials(study: Study) -> tuple[Deviation, ...]:
    """Trials that said nothing or were cut off for safety, with the reasons."""
    found: list[Deviation] = []
    for session in study.sessions:
        for event in session.of_kind("trial"):
            content = event.content
            invalid = content["automatic"] == Kind.INVALID
            if invalid or content["aborted"]:
                what = f"cut off: {content['aborted']}" if content["aborted"] else "said nothing"
                reasons = _with_units(session, "; ".join(content["reasons"])) or str(content["ended"])
                wall = _wall(session, content)
                found.append(_deviation(session, event, what, f"trial {content['trial']}, {wall}: {reasons}"))
    return tuple(found)


def notes(study: Study) -> tuple[Deviation, ...]:
    """What somebody wrote down, corrections in place."""
    found: list[Deviation] = []
    for session in study.sessions:
        texts = {event.content["number"]: str(event.content["value"]) for event in session.of_kind("amended")}
        for event in session.of_kind("note"):
            text = texts.get(event.number, str(event.content["text"]))
            trial = event.content.get("trial")
            found.append(_deviation(session, event, f"trial {trial}" if trial else "", text))
    return tuple(found)


def _deviation(session: Session, event: Event, what: str, detail: str) -> Deviation:
    return Deviation(
        participant=session.code, at_s=max(event.at - session.began_at, 0.0), what=what, detail=detail
    )


def _redone(session: Session, event: Event) -> str:
    number = event.content["trial"]
    verdicts = [e.content["verdict"] for e in session.of_kind("judged") if e.content["trial"] == number]
    said = f", judged {verdicts[-1]}" if verdicts else ""
    return f"trial {number}{said}: it does not count and came again"


def _amended(session: Session, event: Event) -> str:
    content = event.content
    old = session.events[content["number"]]
    trial = old.content.get("trial")
    if content["field"] == "void":
        said = "does not count" if content["value"] else "counts after all"
        return f"trial {trial}: it {said}; why: {content['why']}"
    about = f"{old.kind}, trial {trial}" if trial else old.kind
    return (
        f"event {content['number']} ({about}): {content['field']} {_quoted(old.content.get(content['field']))} → "
        f"{_quoted(content['value'])}; why: {content['why']}"
    )


def _restarted(session: Session, event: Event) -> str:
    block = event.content["block"]
    lost = sum(e.content["block"] == block and e.number < event.number for e in session.of_kind("trial"))
    return f"block {block} began anew: {lost} trials do not count"


def _skipped(session: Session, event: Event) -> str:
    return f"{_run(session, event.content['run'])} was left without a limit"


def _retried(session: Session, event: Event) -> str:
    return f"{_run(session, event.content['run'])}: its trials said nothing, and the operator had it go on"


def _stopped(_: Session, event: Event) -> str:
    return f"the session was left: {event.content['reason']}"


def _resumed(session: Session, event: Event) -> str:
    files = event.content.get("abandoned") or []
    away = session.events[event.number - 1]
    told = f"gone on with after {_duration(max(event.at - away.at, 0.0))}"
    named = ", ".join(str(file.get("file", "?")) for file in files)
    told += f"; recordings that no trial had: {named}" if files else ""
    return "; ".join([told, *lost(event)])


def _ended(_: Session, event: Event) -> str | None:
    reason = str(event.content["reason"])
    return None if reason == "complete" else f"the session ended early: {reason}"


def _continued(session: Session, event: Event) -> str:
    paused = [e for e in session.of_kind("paused") if e.number < event.number]
    return f"after a pause of {_duration(event.at - paused[-1].at)}" if paused else "after a pause"


_TELL: Mapping[str, Callable[[Session, Event], str | None]] = {
    "redone": _redone,
    "amended": _amended,
    "restarted": _restarted,
    "skipped": _skipped,
    "retried": _retried,
    "stopped": _stopped,
    "resumed": _resumed,
    "ended": _ended,
    "continued": _continued,
}


def _run(session: Session, number: int) -> str:
    for run in _runs(session):
        if run.number == number:
            damping = f"{run.damping:g} {_unit(session, 'damping')}"
            return f"run {number} ({run.condition}, B = {damping}, repeat {run.repeat})"
    return f"run {number}"


def _runs(session: Session) -> Iterator[Any]:
    for block in session.state.blocks:
        yield from block.runs


def _wall(session: Session, content: Mapping[str, Any]) -> str:
    stiffness, damping = _unit(session, "stiffness"), _unit(session, "damping")
    return f"{content['condition']}, B = {content['damping']:g} {damping}, K = {content['stiffness']:g} {stiffness}"


def _with_units(session: Session, reasons: str) -> str:
    """Reasons of a verdict, which have numbers alone, with their units."""
    return _REASON.sub(lambda found: f"{found[0]} {_unit(session, _MEASURED[found[1]])}", reasons)


def _unit(session: Session, quantity: str) -> str:
    return unit_of(quantity, session.state.experiment["rig"]["motion"])


def _quoted(value: Any) -> str:
    return "nothing" if value is None else f"“{value}”"


def _duration(seconds: float) -> str:
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
