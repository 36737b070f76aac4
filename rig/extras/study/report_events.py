"""List deviations from the plan in the sessions of a study, in order of time, from the logs alone.

The text of an event is in ``session_events.j2``.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from rig.control.verdict import Kind
from rig.core.sample import unit_of
from rig.extras.study.study import Study, StudySession
from rig.session.finished import Event, list_lost_samples, log_losses, value_words
from rig.views.report import fill_text

TEMPLATE = "extras/study/session_events.j2"
KINDS = ("redone", "amended", "restarted", "skipped", "retried", "stopped", "resumed", "ended", "continued")
_CUT_OFF = {
    "violent": "effort oscillation",
    "energy": "energy limit",
    "out_of_window": "position or speed limit",
}
_MEASURED = {"felt": "velocity", "heard": "effort", "moved": "position"}
_REASON = re.compile(r"\b(felt|heard|moved) [-+.\de]+ above [-+.\de]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """A deviation from the plan: participant, time since the session's start (s), what happened, and details."""

    participant: str
    at_s: float
    what: str
    detail: str


def deviations(study: Study) -> tuple[Deviation, ...]:
    """Return deviations from the plan: verdicts amended, blocks restarted, searches skipped, sessions stopped, etc.

    Values of the protocol that differ from most participants' come first. The opening of a rig is listed if the
    computer or the link lost samples in the measurement before it. Recordings that are missing or changed are last in
    each session.
    """
    found = list(_of_protocols(study))
    for session in study.sessions:
        for event in session.events:
            planned = event.kind == "ended" and event.content["reason"] == "complete"
            lossy = event.kind == "opened" and bool(list_lost_samples(event.content))
            if (event.kind in KINDS or lossy) and not planned:
                found.append(_deviation(session, event, event.kind, _sentence(session, event)))
        for trial, state in session.recordings.items():
            if state in {"missing", "changed"}:
                found.append(_deviation(session, session.events[-1], f"recording {state}", f"trial {trial}"))
    return tuple(found)


def _of_protocols(study: Study) -> Iterator[Deviation]:
    for one in study.differences:
        what = "wording or conduct" if one.is_neutral else "another protocol"
        for code, value in one.values.items():
            if value != one.usual:
                detail = f"{one.key}: {value_words(value)}; most had {value_words(one.usual)}"
                yield Deviation(participant=code, at_s=0.0, what=what, detail=detail)


def invalid_trials(study: Study) -> tuple[Deviation, ...]:
    """Return the trials that were invalid or cut off for safety, with the reasons."""
    found: list[Deviation] = []
    for session in study.sessions:
        for event in session.of_kind("trial"):
            aborted = event.content["aborted"]
            if aborted or event.content["automatic"] == Kind.INVALID:
                why = _CUT_OFF.get(aborted, aborted.replace("_", " "))
                invalid = "invalid, by the machine" if event.content["by_machine"] else "invalid"
                what = f"cut off: {why}" if aborted else invalid
                found.append(_deviation(session, event, what, _sentence(session, event)))
    return tuple(found)


def notes(study: Study) -> tuple[Deviation, ...]:
    """Return the operators' notes, with their later corrections applied."""
    found: list[Deviation] = []
    for session in study.sessions:
        texts = {event.content["number"]: str(event.content["value"]) for event in session.of_kind("amended")}
        for event in session.of_kind("note"):
            text = texts.get(event.number, str(event.content["text"]))
            trial = event.content.get("trial")
            found.append(_deviation(session, event, f"trial {trial}" if trial else "", text))
    return tuple(found)


def _deviation(session: StudySession, event: Event, what: str, detail: str) -> Deviation:
    at_s = max(event.at - session.began_at, 0.0)
    return Deviation(participant=session.code, at_s=at_s, what=what, detail=detail)


def _sentence(session: StudySession, event: Event) -> str:
    content, before = event.content, session.events[: event.number]
    trial = content.get("trial")
    verdicts = [one.content["verdict"] for one in session.of_kind("judged") if one.content["trial"] == trial]
    runs = {run.number: run for block in session.state.blocks for run in block.runs}
    text = fill_text(
        TEMPLATE,
        kind=event.kind,
        c=content,
        unit=lambda quantity: _unit(session, quantity),
        run=runs.get(content.get("run", -1)),
        verdict=verdicts[-1] if verdicts else "",
        corrected=session.events[content["number"]] if event.kind == "amended" else None,
        lost_trials=sum(
            one.kind == "trial" and one.content["block"] == content.get("block") for one in before
        ),
        why_paused=next((one.content["reason"] for one in reversed(before) if one.kind == "paused"), ""),
        away_s=_pause_s(session, event),
        losses=log_losses(event),
        lost_samples=list_lost_samples(content),
        reasons=_with_units(session, "; ".join(content.get("reasons", ()))),
    )
    return " ".join(text.split())


def _pause_s(session: StudySession, event: Event) -> float | None:
    since = [
        one
        for one in session.events[: event.number]
        if event.kind == "resumed" or (event.kind == "continued" and one.kind == "paused")
    ]
    return max(event.at - since[-1].at, 0.0) if since else None


def _with_units(session: StudySession, reasons: str) -> str:
    return _REASON.sub(lambda found: f"{found[0]} {_unit(session, _MEASURED[found[1]])}", reasons)


def _unit(session: StudySession, quantity: str) -> str:
    return unit_of(quantity, session.state.experiment["rig"]["motion"])
