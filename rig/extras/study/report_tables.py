"""Format the tables of a study for the HTML page of `rig session analyse`; the terminal prints some of them.

They must not compute a result: all numbers are in `StudyAnalysis`.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime

from rig.core.present import Table
from rig.extras.study.agreement import Agreement
from rig.extras.study.analyse import StudyAnalysis
from rig.extras.study.effects import Slope
from rig.extras.study.kmax import Beyond, Bound, Paired
from rig.extras.study.mixed import Contrast, Mixed
from rig.extras.study.psychometric import PsychometricFit
from rig.extras.study.report_events import Deviation
from rig.extras.study.rows import ENDED_BY_MOST, Measure
from rig.extras.study.study import StudySession
from rig.extras.study.tables import PRIOR_LAPSE_RATE
from rig.session.finished import END, VOIDED
from rig.views.report import MINUS, NOTHING, clock, interval, number, p, percent, shortest, signed

MEASURES: dict[Measure, str] = {
    "rule": "the limit by the search rule",
    "K50 person": "K50 of the person's verdicts",
    "K50 automatic": "K50 of the automatic verdicts",
}
BOUNDS: dict[Bound, str] = {"": "", "least": "≥ ", "most": "≤ ", "unknown": "? "}
MARK = " *"  # after a value that the verdicts do not support
_SAME = 0.005  # of a lapse rate: no further from the mean of its prior


def over_participants(found: StudyAnalysis, measure: Measure) -> Table:
    """Return a table of K_max (stiffest stable wall) over participants, for each condition and damping."""
    rows = [
        (
            one.condition,
            shortest(one.damping),
            write_bounded(one.mean, one.above, one.below, one.marked),
            interval(one.low, one.high),
            number(one.deviation),
            str(one.participants),
            str(one.runs),
            _describe_censored(one.above, one.below, one.limits),
        )
        for one in found.over_participants
        if one.measure == measure
    ]
    head = ("condition", *_units(found), "95 %", "SD", "participants", "runs", "censored")
    return Table(head, rows, f"K_max over participants: {MEASURES[measure]}")


def tabulate_participants(found: StudyAnalysis, measure: Measure) -> Table:
    """Return a table of K_max (stiffest stable wall) of each participant at each condition and damping."""
    rows = [
        (
            one.participant,
            one.condition,
            shortest(one.damping),
            write_bounded(one.mean, one.above, one.below, one.marked),
            interval(one.low, one.high),
            one.interval,
            interval(one.student_low, one.student_high),
            interval(one.bootstrap_low, one.bootstrap_high),
            number(one.deviation),
            str(one.repeats),
        )
        for one in found.of_participants
        if one.measure == measure
    ]
    head = (
        "participant",
        "condition",
        *_units(found),
        "95 %",
        "of",
        "Student's",
        "bootstrap",
        "SD",
        "repeats",
    )
    return Table(head, rows, f"K_max of each participant: {MEASURES[measure]}", words=2)


def contrasts(found: StudyAnalysis, some: Iterable[Contrast | Paired], caption: str) -> Table:
    """Return a table of the differences between conditions in `some`, with their intervals."""
    rows = [
        (
            f"{one.condition} {MINUS} {one.against}",
            "all" if one.damping is None else shortest(one.damping),
            f"{BOUNDS[one.bound]}{signed(one.difference)}{MARK if one.beyond.marked else ''}",
            interval(one.low, one.high),
            p(one.p),
            p(one.holm),
            f"{one.beyond.count} of {one.beyond.limits}",
        )
        for one in some
    ]
    damping, stiffness = (found.study.unit(name) for name in ("damping", "stiffness"))
    head = ("conditions", f"B ({damping})", f"difference ({stiffness})", "95 %", "p", "p (Holm)", "censored")
    return Table(head, rows, caption)


def likelihood_ratios(model: Mixed) -> Table:
    """Return a table of the likelihood-ratio tests of the factors."""
    rows = [(one.factor, number(one.statistic), str(one.degrees), p(one.p)) for one in model.tests]
    return Table(("factor", "χ²", "degrees of freedom", "p"), rows, "Likelihood ratios")


def terms(found: StudyAnalysis, model: Mixed) -> Table:
    """Return a table of the mixed model's means, slopes and standard deviations (in units of stiffness)."""
    named = [
        *[(f"{condition}, B = {damping:g}", term) for (condition, damping), term in model.means],
        *[(f"slope per {place(slope.name)}", slope) for slope in model.slopes],
    ]
    rows = [(name, number(term.value), interval(term.low, term.high)) for name, term in named]
    rows += [(f"SD of {name}", number(value), "") for name, value in model.deviations[:-1]]
    rows += [("residual SD", number(value), "") for _, value in model.deviations[-1:]]
    return Table(("term", "value", "95 %"), rows, f"Terms of the model ({found.study.unit('stiffness')})")


def psychometric(found: StudyAnalysis, some: Iterable[PsychometricFit], caption: str) -> Table:
    """Return a table of the parameters of the psychometric functions in `some`."""
    unit = found.study.unit("stiffness")
    rows = [
        (
            one.participant or "all",
            one.condition,
            one.judge,
            shortest(one.damping),
            write_bounded(one.threshold.mean, one.above, one.below, one.mark),
            NOTHING if _is_mostly_censored(one) else interval(one.threshold.low, one.threshold.high),
            number(one.spread.mean),
            interval(one.spread.low, one.spread.high),
            lapse_rate(one.lapse_rate.mean),
            str(sum(one.verdicts)),
        )
        for one in some
    ]
    head = (
        "participant",
        "condition",
        "judge",
        f"B ({found.study.unit('damping')})",
        f"K50 ({unit})",
        "95 %",
        f"spread ({unit})",
        "95 %",
    )
    return Table((*head, "lapse rate", "verdicts"), rows, caption, words=3)


def _is_mostly_censored(one: PsychometricFit) -> bool:
    return one.participants > 1 and Beyond(one.participants, one.above, one.below).mostly


def agreement(some: Iterable[Agreement]) -> Table:
    """Return a table with Cohen's kappa of each confusion matrix in `some`."""
    rows = [
        (
            one.condition or "all",
            one.name,
            one.weights,
            NOTHING if one.kappa is None else f"{one.kappa:.2f}",
            interval(one.low, one.high, 2),
            percent(one.share),
            percent(one.positive),
            percent(one.negative),
            str(one.people),
            str(one.trials),
            str(one.left_out),
        )
        for one in some
    ]
    head = ("condition", "classes", "weights", "κ", "95 %", "same", "on stable", "on not stable", "people")
    return Table(
        (*head, "trials", "left out"),
        rows,
        "Agreement of the person's verdicts with the automatic ones, Cohen's κ",
        words=3,
    )


def slopes(found: StudyAnalysis, some: Iterable[Slope]) -> Table:
    """Return a table of the slopes in `some`: of limits, response times and invalid trials along a session."""
    units = {"limit": found.study.unit("stiffness"), "response time": "ln s"}
    rows = [
        (
            one.of + (f", {one.measure}" if one.measure else ""),
            place(one.along),
            units.get(one.of, "share"),
            number(one.slope),
            interval(one.low, one.high),
            p(one.p),
            p(one.holm),
            str(one.participants),
            str(one.count),
        )
        for one in some
    ]
    head = ("of", "for each", "unit", "slope", "95 %", "p", "p (Holm)", "participants", "values")
    return Table(
        head, rows, "Slopes along the session, exploratory: one for each participant, and their mean", words=3
    )


def blocks(found: StudyAnalysis) -> Table:
    """Return a table of the trials of each block, without practice."""
    rows = [
        (
            one.participant,
            one.block,
            one.trials,
            one.invalid,
            one.redone,
            one.aborted,
            one.unsure,
            number(one.response_s, 3),
        )
        for one in found.blocks
    ]
    head = ("participant", "block", "trials", "invalid", "redone", "cut off", "unsure", "response time (s)")
    return Table(head, rows, "Blocks, practice aside")


def searches(found: StudyAnalysis) -> Table:
    """Return a table of planned and finished searches, by condition and damping."""
    protocol, sessions = found.study.protocol, found.study.sessions
    planned = protocol.order.repeats * len(sessions)
    rows = []
    for condition, damping in ((one, damping) for one in protocol.condition for damping in one.damping):
        of = [run for run in found.runs if (run.condition, run.damping) == (condition.name, damping)]
        states = [run.state for run in of]
        rows.append(
            (
                condition.name,
                found.schemes[condition.name],
                shortest(damping),
                planned,
                *(states.count(state) for state in ("complete", ENDED_BY_MOST, "unfinished", "skipped")),
                planned - len(of),
                f"{sum(run.hits for run in of) / len(of):.1f}" if of else NOTHING,
                sum(run.invalid for run in of),
                sum(run.voided for run in of),
            )
        )
    head = (
        "condition",
        "scheme",
        f"B ({found.study.unit('damping')})",
        "runs planned",
        "complete",
        ENDED_BY_MOST,
        "unfinished",
    )
    return Table((*head, "skipped", "not begun", "hits a run", "invalid", "void"), rows, "Searches", words=2)


def orders(found: StudyAnalysis) -> Table:
    """Return a table with the order of the searches in each block of each participant."""
    rows = [
        (
            session.code,
            session.state.row,
            block.number,
            " → ".join(f"{run.condition} (B = {run.damping:g})" for run in block.runs)
            + (", alternating" if block.interleave else ""),
        )
        for session in found.study.sessions
        for block in session.state.blocks
        if not block.practice
    ]
    return Table(("participant", "row", "block", "order"), rows, "Order of the searches", words=4)


def participants(found: StudyAnalysis) -> Table:
    """Return a table of the sessions, one row for each participant."""
    head = (
        "participant",
        "began (UTC)",
        "ended",
        "row",
        "duration (min)",
        "blocks begun",
        "trials",
        "counted",
    )
    rows = [_participant(found, session) for session in found.study.sessions]
    return Table(
        (*head, "invalid", "by the machine", "redone, restarted or left out", "cut off"),
        rows,
        "Sessions",
        words=3,
    )


def _participant(found: StudyAnalysis, session: StudySession) -> tuple[object, ...]:
    state = session.state
    trials = [trial for trial in found.trials if trial.participant == session.code]
    planned = [block for block in state.blocks if not block.practice]
    began = datetime.fromtimestamp(session.began_at, UTC)
    return (
        session.code,
        NOTHING if found.study.rehearsed else f"{began:%Y-%m-%d %H:%M}",
        state.ended or (f"left: {state.stopped}" if state.stopped else "not ended"),
        state.row,
        f"{state.active_s / 60.0:.0f}",
        f"{len({number for number in state.begun if number})} of {len(planned)}",
        len(trials),
        next(one.counted for one in found.participants if one.participant == session.code),
        sum(trial.void == "invalid" for trial in trials),
        sum(trial.void == "invalid" and trial.by_machine for trial in trials),
        sum(trial.void in VOIDED for trial in trials),
        sum(trial.aborted != "" for trial in trials),
    )


def tracks(found: StudyAnalysis) -> Table:
    """Return a table of every search with its stiffness limit."""
    rows = []
    for run in found.runs:
        limit = run.limits.get(found.options.measure)
        value, ends = NOTHING, NOTHING
        if limit is not None:
            value = write_bounded(
                limit.value, limit.censored == "above", limit.censored == "below", limit.mark
            )
            ends = interval(limit.low, limit.high)
        mark = limit.mark if limit is not None and limit.mark not in run.note else ""
        state = "; ".join(filter(None, (run.state, run.note, mark)))
        rows.append(
            (
                run.participant,
                run.condition,
                run.rule,
                state,
                run.run,
                run.block,
                shortest(run.damping),
                run.repeat,
                value,
                ends,
                run.hits,
                f"{run.lapses} of {run.catches}",
            )
        )
    unit, damping = found.study.unit("stiffness"), found.study.unit("damping")
    head = ("participant", "condition", "rule", "state", "run", "block", f"B ({damping})", "repeat")
    return Table((*head, f"limit ({unit})", "95 %", "hits", "lapses"), rows, "Searches", words=4)


def answers(found: StudyAnalysis) -> Table:
    """Return a table of the answers to the questionnaire."""
    items = {item.name: item.text for item in found.study.protocol.question}
    rows = [
        (
            session.code,
            items.get(name, name),
            {0: "start", END: "end"}.get(block, f"after block {block}"),
            str(answer),
        )
        for session in found.study.sessions
        for (name, block), answer in session.state.answered.items()
    ]
    return Table(("participant", "question", "when", "answer"), rows, "Answers", words=4)


def events(some: Iterable[Deviation], caption: str) -> Table:
    """Return a table of events: participant, time since the session's start, and text."""
    rows = [(one.participant, clock(one.at_s), one.what, one.detail) for one in some]
    return Table(("participant", "since the begin", "what", "details"), rows, caption, words=4)


def drop_empty_columns(table: Table) -> Table:
    """Return a table without the columns that contain only dashes."""
    kept = [
        i for i in range(len(table.head)) if not table.rows or any(row[i] != NOTHING for row in table.rows)
    ]
    head, rows = [table.head[i] for i in kept], [[row[i] for i in kept] for row in table.rows]
    return replace(table, head=head, rows=rows, words=sum(i < table.words for i in kept))


# What the terminal and the page begin with.


def first_contrasts(found: StudyAnalysis) -> tuple[Mixed | None, list[tuple[Contrast | Paired, str]]]:
    """Return the mixed model, and the differences between conditions to show first, as (difference, method).

    They are the model's differences, or without a model the paired ones. Paired differences that are only bounds are
    added.
    """
    measure = found.options.measure
    paired = [one for one in found.paired if one.measure == measure and one.participants > 1]
    model = next((one for one in found.mixed if one.measure == measure), None)
    if model is None or not model.contrasts:
        return model, [(one, "paired") for one in paired]
    first: list[tuple[Contrast | Paired, str]] = [(one, "mixed model") for one in model.contrasts]
    return model, first + [(one, "paired") for one in paired if one.withheld]


def is_tested(one: Contrast | Paired) -> bool:
    """Return False for a paired difference without a test, because most of its limits are censored."""
    return not (isinstance(one, Paired) and one.withheld)


def summarise_differences(found: StudyAnalysis) -> Iterator[tuple[Contrast | Paired, str]]:
    """Yield the differences for a summary: over all dampings or, if that is only a bound, at each damping."""
    _, first = first_contrasts(found)
    overall = {(one.condition, one.against) for one, _ in first if one.damping is None and is_tested(one)}
    for one, method in first:
        if one.damping is None or (one.condition, one.against) not in overall:
            yield one, method


def write_bounded(value: float, above: int, below: int, marked: object = "") -> str:
    """Return a value as text, after ≥, ≤ or ? if limits `above` or `below` all searched stiffnesses make it a bound.

    An asterisk follows if `marked` is true: the verdicts do not support some of the limits.
    """
    bound = "? " if above and below else "≥ " if above else "≤ " if below else ""
    return f"{bound}{number(value)}{MARK if marked else ''}"


def lapse_rate(mean: float) -> str:
    """Return a lapse rate in percent as text; a dash if it is missing, or equals the mean of its prior."""
    return NOTHING if abs(mean - PRIOR_LAPSE_RATE) < _SAME else percent(mean, 1)


def place(along: str) -> str:
    """Return the words for the position along which a slope is computed, such as "place in the block"."""
    return "place in the block" if along == "order" else along


def _describe_censored(above: int, below: int, limits: int) -> str:
    sides = [f"{count} {side}" for count, side in ((above, "above"), (below, "below")) if count]
    return f"{', '.join(sides)} of {limits}" if sides else "none"


def _units(found: StudyAnalysis) -> Sequence[str]:
    return (f"B ({found.study.unit('damping')})", f"K_max ({found.study.unit('stiffness')})")


def whole(found: StudyAnalysis) -> tuple[list[PsychometricFit], list[PsychometricFit]]:
    """Split psychometric functions: of all participants together (or the only one), and of single participants."""
    alone = len(found.study.sessions) == 1
    every = list(found.psychometrics)
    together = [one for one in every if alone or not one.participant]
    return together, [one for one in every if one not in together]


def no_slope(found: StudyAnalysis) -> dict[str, list[str]]:
    """Return, for each reason, the names of the slopes along the session that have no value."""
    problems: dict[str, list[str]] = {}
    for one in found.slopes:
        if one.problem:
            of = one.of + (f" ({one.measure})" if one.measure else "")
            problems.setdefault(one.problem, []).append(f"{of} per {place(one.along)}")
    return problems


def no_interval(found: StudyAnalysis) -> dict[str, list[str]]:
    """Return, for each reason, the names of the confusion matrices whose kappa has no interval."""
    problems: dict[str, list[str]] = {}
    for one in found.agreements:
        name = one.name + (f" of {one.condition}" if one.condition else "")
        if one.problem and name not in problems.setdefault(one.problem, []):
            problems[one.problem].append(name)
    return problems


def no_mean_interval(found: StudyAnalysis, measure: Measure) -> dict[str, list[str]]:
    """Return, for each reason, the conditions and dampings whose mean over participants has no interval."""
    problems: dict[str, list[str]] = {}
    for one in found.over_participants:
        if one.measure == measure and one.problem:
            problems.setdefault(one.problem, []).append(f"{one.condition} at B = {one.damping:g}")
    return problems


def group_untested(found: StudyAnalysis, some: Iterable[Paired]) -> dict[str, list[str]]:
    """Return, for each reason, the differences in `some` without an interval, as text."""
    unit, problems = found.study.unit("stiffness"), dict[str, list[str]]()
    for one in some:
        if one.problem:
            where = "over all dampings" if one.damping is None else f"at B = {one.damping:g}"
            value = f"{BOUNDS[one.bound]}{signed(one.difference)} {unit}"
            problems.setdefault(one.problem, []).append(
                f"{one.condition} {MINUS} {one.against} {where} ({value})"
            )
    return problems


def has_interval(one: Contrast | Paired) -> bool:
    """Return True if a difference has an interval."""
    return math.isfinite(one.low)
