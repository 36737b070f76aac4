"""Format the events of a session as sentences: complete, or without conditions and walls for people who are blinded.

Blinded people must not know which wall is presented.
"""

from collections.abc import Sequence

from rig.control.verdict import Kind
from rig.core.sample import Motion, unit_of
from rig.experiments.trials.judgement import FINISHED
from rig.session.engine._log import Event, log_losses
from rig.session.engine._place import device_words, list_lost_samples
from rig.session.planning._reasons import summarise_reasons
from rig.session.planning._trial import RecordedTrial, trial_of

_LINES: dict[str, str] = {
    "judged": "trial {trial}: {verdict}",
    "redone": "trial {trial} is discarded and repeated",
    "skipped": "run {run} ended without a limit",
    "retried": "run {run} continues after invalid trials",
    "block": "block {block} begins",
    "restarted": "block {block} starts over",
    "note": "note: {text}",
    "rested": "rested {seconds:g} s",
    "answered": "{item}: {answer}",
    "paused": "paused: {reason}",
    "ended": "ended: {reason}",
    "pulse": "torque pulse: {said}",
    "amended": "event {number} corrected: {value} ({why})",
}


def line_of_event(event: Event) -> str:
    """Return an event as one line without conditions and walls, for people who must not know them (blinded)."""
    if event.kind == "trial":
        content = event.content
        invalid = content["automatic"] == Kind.INVALID
        return (
            _invalid(content["trial"], content["reasons"], blind=True)
            if invalid
            else f"trial {content['trial']}"
        )
    if event.kind == "opened":
        opened = ["opened"]
        if walls := sum(len(one["stiffness"]) for one in event.content.get("armed_anyway", ())):
            opened.append(f"{walls} walls that the arming gate refuses are armed with the operator's consent")
        return "; ".join([*opened, *list_lost_samples(event.content)])
    if event.kind == "amended" and "trial" in event.content:
        value = event.content["value"]
        change = {True: "does not count", False: "counts after all"}.get(value, f"corrected: {value}")
        return f"trial {event.content['trial']} {change} ({event.content['why']})"
    # Many reasons already begin with the word "stopped".
    if event.kind == "stopped":
        return f"stopped: {event.content['reason']}".replace("stopped: stopped", "stopped", 1)
    if event.kind == "resumed":
        return "; ".join(["resumed", *log_losses(event)])
    return _LINES.get(event.kind, event.kind).format(**event.content)


def whole_line(event: Event, motion: Motion) -> str:
    """Return an event as one line with condition, wall and all reasons, for people who may know them."""
    content, parts = event.content, [line_of_event(event)]
    if event.kind == "trial":
        return _whole(trial_of(content), motion)
    if event.kind == "began":
        parts.append(f"{content['protocol']['study']['title']}, row {content['row']} of the order")
    elif event.kind == "opened":
        parts.append(device_words(content))
        parts += [
            f"armed anyway: {one['condition']}, B = {one['damping']:g}, "
            f"K = {', '.join(f'{stiffness:g}' for stiffness in one['stiffness'])}"
            for one in content.get("armed_anyway", ())
        ]
    elif event.kind == "pulse":
        parts += content["checks"]
    elif event.kind == "stopped" and "detail" in content:
        parts.append(" ".join(content["detail"].split()))
    return "; ".join(parts)


def _whole(trial: RecordedTrial, motion: Motion) -> str:
    wall = ", ".join(
        f"{symbol} = {value:g} {unit_of(quantity, motion)}"
        for symbol, value, quantity in (("K", trial.stiffness, "stiffness"), ("B", trial.damping, "damping"))
    )
    kind = [name for name in ("practice", "catch") if getattr(trial, name)]
    attempt = [f"attempt {trial.attempt}"] if trial.attempt > 1 else []
    ended = trial.aborted or trial.ended.replace(FINISHED, "")
    parts = [
        ", ".join([f"trial {trial.trial}", *kind, trial.condition, wall, *attempt]),
        ": ".join(["automatic verdict " + trial.automatic, *filter(None, ["; ".join(trial.reasons)])]),
        *([] if trial.invalid else _describe_missed_ranges(trial.outside, blind=False)),
        *([f"ended early: {ended.replace('_', ' ')}"] if ended else []),
    ]
    return "; ".join(parts)


def outcome(trial: RecordedTrial, *, blind: bool) -> str:
    """Return the result of a trial as text, without its wall and without anything that could influence a verdict.

    If `blind` is True, the reasons of an invalid trial contain no information about the wall.
    """
    if trial.invalid:
        return _invalid(trial.trial, trial.reasons, blind=blind)
    if not trial.verdict:
        return f"trial {trial.trial}: over"
    aborted = ["cut off for safety"] if trial.aborted else []
    return ", ".join(
        [
            f"trial {trial.trial}: done",
            *_describe_too_fast(trial),
            *aborted,
            *_describe_missed_ranges(trial.outside, blind=blind),
        ]
    )


def _describe_too_fast(trial: RecordedTrial) -> list[str]:
    """Return a list with a warning if the verdict was given sooner than a person can respond; otherwise []."""
    if not trial.too_fast or trial.response_time_s is None:
        return []
    after_ms = 1e3 * trial.response_time_s
    return [
        f"judged {after_ms:.0f} ms after the question, sooner than trial.fastest_verdict_s: release the key and redo it"
    ]


def _describe_missed_ranges(outside: Sequence[str], *, blind: bool) -> list[str]:
    # A trial that missed a required range (impact speed, press) may count. Not shown before the verdict: a measured
    # press reveals that the wall was not unstable.
    return [f"counts, but {summarise_reasons(outside, blind=blind)}"] if outside else []


def _invalid(trial: int, reasons: Sequence[str], *, blind: bool) -> str:
    return ": ".join(
        [
            f"trial {trial}",
            "invalid, will be repeated",
            *filter(None, [summarise_reasons(reasons, blind=blind)]),
        ]
    )
