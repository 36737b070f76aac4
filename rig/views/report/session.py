"""A study as one HTML page: what was planned, what happened, what came of it, and how, in words that a paper can print.

Everything is in the file: pictures inline, all numbers as JSON in the element ``numbers``.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rig import config
from rig.config import Experiment
from rig.recording.files import whole_file
from rig.session.analysis.analyse import Analysis
from rig.session.analysis.kmax import Beyond, Bound, Paired
from rig.session.analysis.mixed import Contrast
from rig.session.analysis.rows import Measure
from rig.session.analysis.study import LOG, VOIDED, Session
from rig.session.analysis.tables import SLIPS_BEFORE
from rig.session.state import END
from rig.views.plots.session import tracks_name
from rig.views.report.session_events import Deviation, deviations, notes, useless_trials
from rig.views.report.session_methods import MEASURES, Paragraph, analysed_with, effective, methods
from rig.views.report.template import data_uris, fill, provenance_lines

TEMPLATE = "session.html.j2"
PAGE, NUMBERS = "report.html", "report.json"
CAPTIONS: Mapping[str, str] = {
    "zwidth": "The Z-width. Thin lines are participants, thick ones their mean with an interval of 95 % (of one "
    "participant: over repeats). ▲ and ▼: limits beyond the levels that were searched.",
    "psychometric": "Share of stable verdicts over stiffness; areas of circles tell how many verdicts. Thin lines are "
    "participants, the thick one is all of them, its bar the interval of K50 (over three participants or more), dashed "
    "the automatic verdicts.",
    "agreement": "Verdicts of the person (rows) and of the recording (columns); percentages are of a row.",
    "effects": "Limits less what participant and condition have in common, along the session; the time to a verdict; "
    "and the share of trials that say nothing, were redone, or were cut off.",
}
TRACKS_CAPTION = (
    "Walls that each search of {code} asked for, and what was said of them; grey: limit and interval."
)
_MINUS = "−"
_MARKS: Mapping[Bound, str] = {"": "", "least": "≥ ", "most": "≤ ", "unknown": "? "}
_FATES = {"counted": "told limits", "invalid": "said nothing"}
_FIRST = 6  # differences in the summary
_SAME = 0.005  # of slips: no further from what was supposed before


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts under a head; the first columns, so many, are words and stand left."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture by its name, and what it shows."""

    name: str
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page; `folded` tables and figures are shown when asked for."""

    key: str
    title: str
    text: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    folded: Sequence[Table] = ()
    folded_figures: Sequence[Figure] = ()
    fold: str = "More"
    unfolded: bool = False  # from the start, so that it is printed


def render(found: Analysis, pictures: Mapping[str, bytes]) -> str:
    """Return the page.

    Parameters
    ----------
    found
        What it tells.
    pictures
        PNGs by name (`rig.views.plots.session.pictures`); one that is not there is told of instead of shown.

    """
    return fill(
        TEMPLATE,
        title=found.study.protocol.study.title,
        summary=_summary(found),
        rehearsed=found.study.rehearsed,
        messages=found.messages,
        sections=_sections(found),
        methods=methods(found),
        pictures=data_uris(pictures),
        provenance=provenance_lines(provenance(found)),
        data=as_mapping(found),
    )


def write_session_report(
    found: Analysis, pictures: Mapping[str, bytes], directory: Path
) -> tuple[Path, Path]:
    """Write the page and its numbers into a directory, which is there; returns both paths.

    Earlier ones are replaced.

    Raises
    ------
    RecordingError
        The disk refuses.
    """
    page = render(found, pictures).encode()
    numbers = json.dumps(as_mapping(found), ensure_ascii=False, allow_nan=False, indent=1).encode()
    paths = directory / PAGE, directory / NUMBERS
    for path, content in zip(paths, (page, numbers), strict=True):
        with whole_file(path, overwrite=True) as file:
            file.write(content)
    return paths


def finite(value: Any) -> Any:
    """Plain values for JSON: what is not finite is None."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


def as_mapping(found: Analysis) -> dict[str, Any]:
    """Everything that the page tells, as plain values; what is not finite is None."""
    told: dict[str, Any] = finite(
        {
            **found.as_mapping(),
            "methods": [asdict(paragraph) for paragraph in methods(found)],
            "deviations": [asdict(one) for one in deviations(found.study)],
            "useless_trials": [asdict(one) for one in useless_trials(found.study)],
            "notes": [asdict(one) for one in notes(found.study)],
            "provenance": provenance(found),
        }
    )
    return told


def provenance(found: Analysis) -> dict[str, Any]:
    """Where the numbers come from: logs with their hashes, devices, versions, seeds."""
    sessions = found.study.sessions
    return {
        "logs": {
            session.code: {
                "events": len(session.events),
                "sha256": _sha256(session.directory / LOG),
                "protocol_sha256": session.began.get("protocol_sha256"),
            }
            for session in sessions
        },
        "devices": {
            session.code: [dict(event.content) for event in session.of_kind("opened")] for session in sessions
        },
        "versions of the sessions": {session.code: session.began.get("versions") for session in sessions},
        "versions of the analysis": analysed_with(),
        "seed of the study": found.study.protocol.study.seed,
        "seed of the bootstraps": found.options.seed,
        "protocol": sessions[0].began.get("protocol"),
        "experiment that the study changes": sessions[0].began.get("experiment"),
        "experiments": {
            name: config.as_mapping(x) if isinstance(x, Experiment) else {"not available here": x.message}
            for name, x in effective(found).items()
        },
    }


# ---------------------------------------------------------------------------------------------------- the sections


def _sections(found: Analysis) -> list[Section]:
    tell: tuple[Callable[[Analysis], Section | None], ...] = (
        _kmax,
        _differences,
        _psychometric,
        _agreement,
        _effects,
        _plan,
        _participants,
        _tracks,
        _questionnaire,
        _deviations,
    )
    return [section for part in tell if (section := part(found)) is not None]


def _summary(found: Analysis) -> list[str]:
    """The study in a few sentences."""
    study, measure, unit = found.study, found.options.measure, found.study.unit("stiffness")
    counts = found.counts()
    people = "simulated participant" if study.rehearsed else "participant"
    told = [
        f"{_count(len(study.sessions), people)}, {_count(len(study.protocol.condition), 'condition')}, "
        f"{counts['recorded']} recorded hits, of which {counts.get('counted', 0)} told limits. Rig: "
        f"{study.sessions[0].state.experiment['rig']['name']}. K_max is {MEASURES[measure]}."
    ]
    contrasts = _contrasts(found, measure)
    overall = {(one.condition, one.against) for one, _ in contrasts if one.damping is None and _tested(one)}
    first = [
        _sentence_of(one, by, unit)
        for one, by in contrasts
        if one.damping is None or (one.condition, one.against) not in overall
    ]
    return [*told, *first[:_FIRST]]


def _tested(one: Contrast | Paired) -> bool:
    return not (isinstance(one, Paired) and one.withheld)


def _sentence_of(one: Contrast | Paired, by: str, unit: str) -> str:
    """A difference, how sure it is, and how many of the limits behind it are no more than bounds."""
    where = "over all dampings" if one.damping is None else f"at B = {one.damping:g}"
    beyond = f"{one.beyond.count} of {one.beyond.limits} limits beyond the levels" if one.beyond.count else ""
    if math.isfinite(one.low):
        sure = f"({_signed(one.low)} … {_signed(one.high)}), p (Holm) {_p_text(one.holm)} ({by})"
        sure += f"; {beyond}, which biases it" if beyond else ""
    elif not _tested(one):
        sure = f"with {beyond}, too many for an interval and a p"
    else:
        sure = "for every participant, which leaves no interval and no p" + (f"; {beyond}" if beyond else "")
    value = f"{_MARKS[one.bound]}{_signed(one.difference)} {unit}"
    return f"{one.condition} {_MINUS} {one.against}, {where}: {value} {sure}."


def _kmax(found: Analysis) -> Section:
    measure, unit, damping = found.options.measure, found.study.unit("stiffness"), found.study.unit("damping")
    each = [one for one in found.of_participants if one.measure == measure]
    tables = [_over(found, measure)]
    head = (
        "participant",
        "condition",
        f"B ({damping})",
        f"K_max ({unit})",
        "95 %",
        "of",
        "Student's",
        "bootstrap",
        "SD",
        "repeats",
    )
    rows = [
        (
            one.participant,
            one.condition,
            f"{one.damping:g}",
            _bounded(one.mean, one.above, one.below),
            _range(one.low, one.high),
            one.interval,
            _range(one.student_low, one.student_high),
            _range(one.bootstrap_low, one.bootstrap_high),
            _number(one.deviation),
            str(one.repeats),
        )
        for one in each
    ]
    others = [_over(found, other) for other in MEASURES if other != measure]
    return Section(
        "kmax",
        "K_max",
        text=(
            f"K_max is {MEASURES[measure]}. ≥ and ≤ mark means that hold limits beyond the levels that were "
            "searched: they "
            "are bounds.",
            *(
                (
                    "Intervals of “verdicts” are told from all verdicts of a participant together, not from the mean "
                    "of the limits beside them, and need not hold it.",
                )
                if measure == "rule" and any(one.interval == "verdicts" for one in each)
                else ()
            ),
        ),
        figures=(Figure("zwidth", CAPTIONS["zwidth"]),),
        tables=tables,
        folded=(
            Table("K_max of each participant", head, rows, words=2),
            *[table for table in others if table.rows],
        ),
        fold="Each participant, and K_max told otherwise",
    )


def _over(found: Analysis, measure: Measure) -> Table:
    unit, damping = found.study.unit("stiffness"), found.study.unit("damping")
    rows = [
        (
            one.condition,
            f"{one.damping:g}",
            _bounded(one.mean, one.above, one.below),
            _range(one.low, one.high),
            _number(one.deviation),
            str(one.participants),
            str(one.runs),
            _beyond(one.above, one.below, one.limits),
        )
        for one in found.over_participants
        if one.measure == measure
    ]
    head = (
        "condition",
        f"B ({damping})",
        f"K_max ({unit})",
        "95 %",
        "SD",
        "participants",
        "runs",
        "beyond the levels",
    )
    return Table(f"Over participants: {MEASURES[measure]}", head, rows)


def _differences(found: Analysis) -> Section | None:
    measure, unit = found.options.measure, found.study.unit("stiffness")
    model = next((one for one in found.mixed if one.measure == measure), None)
    paired = [one for one in found.paired if one.measure == measure]
    if model is None and not paired:
        return None
    text: list[str] = []
    tables: list[Table] = []
    if model is not None and model.problem:
        text.append(f"There is no mixed model: {model.problem}.")
    if model is not None and not model.problem:
        text.append(
            f"A linear mixed model of the limits of {_count(model.runs, 'run')} of "
            f"{_count(model.participants, 'participant')}, averaged over the repeats of each in each condition at each "
            f"damping; intervals with {_count(model.degrees, 'degree')} of freedom."
        )
        text += [f"{note[:1].upper()}{note[1:]}." for note in model.notes]
        tables.append(_contrast_table("Differences between conditions, mixed model", model.contrasts, unit))
        tables.append(
            Table(
                "Likelihood ratios",
                ("factor", "χ²", "degrees of freedom", "p"),
                [(t.factor, _number(t.statistic), str(t.degrees), _p(t.p)) for t in model.tests],
            )
        )
        terms = [
            *[(f"{condition}, B = {b:g}", term) for (condition, b), term in model.means],
            *[(f"for each {'place in the block' if s.name == 'order' else s.name}", s) for s in model.slopes],
        ]
        tables.append(
            Table(
                f"Terms of the model ({unit})",
                ("term", "value", "95 %"),
                [
                    *((name, _number(term.value), _range(term.low, term.high)) for name, term in terms),
                    *((f"SD of {name}", _number(value), "") for name, value in model.deviations),
                ],
            )
        )
        if model.slopes:
            text.append(
                "Order and block are taken out here; what can be said of them is under Order and fatigue."
            )
    withheld = [one for one in paired if one.withheld]
    if withheld:
        text.append(
            "≥ and ≤ mark differences that are bounds. Where most limits of a condition lie beyond the levels, there "
            "is neither interval nor p."
        )
        tables.append(_contrast_table("Differences that are no more than bounds", withheld, unit))
    told = [one for one in paired if one.participants > 1 and not one.withheld]
    folded = (_contrast_table("Paired within participants (Student's t)", told, unit),) if told else ()
    return Section(
        "differences",
        "Differences between conditions",
        text=text,
        tables=[table for table in tables if table.rows],
        folded=folded,
        fold="Paired differences",
    )


def _contrast_table(caption: str, contrasts: Sequence[Contrast | Paired], unit: str) -> Table:
    rows = [
        (
            f"{one.condition} {_MINUS} {one.against}",
            "all" if one.damping is None else f"{one.damping:g}",
            f"{_MARKS[one.bound]}{_signed(one.difference)}",
            _range(one.low, one.high),
            _p(one.p),
            _p(one.holm),
            f"{one.beyond.count} of {one.beyond.limits}",
        )
        for one in contrasts
    ]
    head = ("difference", "B", f"({unit})", "95 %", "p", "p (Holm)", "beyond the levels")
    return Table(caption, head, rows)


def _contrasts(found: Analysis, measure: Measure) -> list[tuple[Contrast | Paired, str]]:
    """Differences to begin with and how they are told: by the model where there is one, and those that are bounds."""
    paired = [one for one in found.paired if one.measure == measure and one.participants > 1]
    model = next((one for one in found.mixed if one.measure == measure and one.contrasts), None)
    if model is None:
        return [(one, "paired") for one in paired]
    return [
        *((one, "mixed model") for one in model.contrasts),
        *((one, "paired") for one in paired if one.withheld),
    ]


def _psychometric(found: Analysis) -> Section | None:
    if not found.psychometrics:
        return None
    unit = found.study.unit("stiffness")
    rows = [
        (
            one.participant or "all",
            one.condition,
            one.judge,
            f"{one.damping:g}",
            _bounded(one.threshold.mean, one.above, one.below),
            "–"
            if one.participants > 1 and Beyond(one.participants, one.above, one.below).mostly
            else _range(one.threshold.low, one.threshold.high),
            _number(one.spread.mean),
            _range(one.spread.low, one.spread.high),
            _slips(one.slips.mean),
            str(sum(one.verdicts)),
        )
        for one in found.psychometrics
    ]
    head = (
        "participant", "condition", "judge", "B", f"K50 ({unit})", "95 %", f"spread ({unit})", "95 %",
        "slips", "verdicts",
    )  # fmt: skip
    whole = [row for row in rows if row[0] == "all" or len(found.study.sessions) == 1]
    return Section(
        "psychometric",
        "Psychometric functions",
        text=(
            "Slips are “–” where verdicts say no more of them than was supposed before: a person's few slips cannot be "
            "told from none by some dozens of verdicts.",
        ),
        figures=(Figure("psychometric", CAPTIONS["psychometric"]),),
        tables=(Table("All participants together", head, whole, words=3),),
        folded=(Table("Each participant", head, [row for row in rows if row not in whole], words=3),)
        if len(whole) < len(rows)
        else (),
        fold="Each participant",
    )


def _agreement(found: Analysis) -> Section | None:
    if not found.agreements:
        return None
    rows = [
        (
            one.condition or "all",
            one.name,
            one.weights,
            "–" if one.kappa is None else f"{one.kappa:.2f}",
            _range(one.low, one.high, 2),
            one.over,
            _percent(one.share),
            _percent(one.positive),
            _percent(one.negative),
            str(one.people),
            str(one.trials),
            str(one.left_out),
        )
        for one in found.agreements
    ]
    head = (
        "condition", "classes", "weights", "κ", "95 %", "over", "same", "on stable", "on not stable", "people",
        "trials", "left out",
    )  # fmt: skip
    problems: dict[str, list[str]] = {}
    for one in found.agreements:
        name = one.name + (f" of {one.condition}" if one.condition else "")
        if one.problem and name not in problems.setdefault(one.problem, []):
            problems[one.problem].append(name)
    return Section(
        "agreement",
        "Agreement of the person's verdicts and the automatic ones",
        text=(
            "Searches ask most about walls near the limit, where verdicts differ most: κ reads lower than "
            "over all walls "
            "alike.",
            "“On stable” and “on not stable” are the agreement on one class: of the verdicts that are of it by one of "
            "the two, the share that are by both.",
            *(f"No interval for {', '.join(names)}: {problem}." for problem, names in problems.items()),
        ),
        figures=(Figure("agreement", CAPTIONS["agreement"]),),
        tables=(Table("Cohen's κ", head, rows, words=3),),
    )


def _effects(found: Analysis) -> Section | None:
    if not found.slopes:
        return None
    units = {"limit": found.study.unit("stiffness"), "response time": "ln s", "said nothing": "share"}
    rows = [
        (
            f"{one.of}" + (f", {one.measure}" if one.measure else ""),
            "place in the block" if one.along == "order" else one.along,
            units.get(one.of, ""),
            _number(one.slope),
            _range(one.low, one.high),
            _p(one.p),
            _p(one.holm),
            str(one.participants),
            str(one.count),
            one.problem,
        )
        for one in found.slopes
    ]
    block_rows = [
        (
            one.participant,
            str(one.block),
            str(one.trials),
            str(one.invalid),
            str(one.redone),
            str(one.aborted),
            str(one.unsure),
            "–" if one.response_s is None else f"{one.response_s:.3g}",
        )
        for one in found.blocks
    ]
    return Section(
        "effects",
        "Order and fatigue",
        text=(
            "Exploratory: no question was asked of these slopes before. p (Holm) is corrected for those of the same "
            "quantity.",
        ),
        figures=(Figure("effects", CAPTIONS["effects"]),),
        tables=(
            Table(
                "Slopes, exploratory: one for each participant, and the mean of them",
                ("of", "for each", "unit", "slope", "95 %", "p", "p (Holm)", "participants", "values", ""),
                rows,
                words=3,
            ),
        ),
        folded=(
            Table(
                "Blocks, practice aside",
                (
                    "participant",
                    "block",
                    "trials",
                    "said nothing",
                    "redone",
                    "cut off",
                    "unsure",
                    "time to a verdict (s)",
                ),
                block_rows,
            ),
        ),
        fold="Blocks",
    )


def _plan(found: Analysis) -> Section:
    study, order = found.study, found.study.protocol.order
    unit = study.unit("damping")
    rows = []
    for condition in study.protocol.condition:
        for damping in condition.damping:
            of = [run for run in found.runs if (run.condition, run.damping) == (condition.name, damping)]
            planned = order.repeats * len(study.sessions)
            rows.append(
                (
                    condition.name,
                    found.schemes[condition.name],
                    f"{damping:g}",
                    str(planned),
                    *(
                        str(sum(run.state == state for run in of))
                        for state in ("complete", "unfinished", "skipped")
                    ),
                    str(planned - len(of)),
                    f"{sum(run.hits for run in of) / len(of):.1f}" if of else "–",
                    str(sum(run.invalid for run in of)),
                    str(sum(run.void for run in of)),
                )
            )
    head = (
        "condition", "scheme", f"B ({unit})", "runs planned", "complete", "unfinished", "skipped", "not begun",
        "hits a run", "said nothing", "void",
    )  # fmt: skip
    orders = [
        (session.code, str(session.state.row), str(block.number), _order_text(block))
        for session in study.sessions
        for block in session.state.blocks
        if not block.practice
    ]
    return Section(
        "plan",
        "Plan and what happened",
        text=(
            f"{study.protocol.study.participants} participants were planned, {len(study.sessions)} took part."
            f" Trials: {', '.join(f'{count} {_FATES.get(name, name)}' for name, count in found.counts().items())}.",
        ),
        tables=(Table("Searches", head, rows, words=2),),
        folded=(Table("Order of the searches", ("participant", "row", "block", "order"), orders, words=4),),
        fold="Order of the searches",
    )


def _order_text(block: Any) -> str:
    runs = " → ".join(f"{run.condition} (B = {run.damping:g})" for run in block.runs)
    return f"{runs}, in turns" if block.interleave else runs


def _participants(found: Analysis) -> Section:
    rows = [_participant(found, session) for session in found.study.sessions]
    head = (
        "participant", "began (UTC)", "how it ended", "row", "duration (min)", "blocks begun", "trials",
        "told limits", "said nothing", "redone, restarted or left out", "cut off",
    )  # fmt: skip
    return Section("participants", "Participants", tables=(Table("Sessions", head, rows, words=3),))


def _participant(found: Analysis, session: Session) -> tuple[str, ...]:
    state = session.state
    trials = [trial for trial in found.trials if trial.participant == session.code]
    blocks = [block for block in state.blocks if not block.practice]
    began = datetime.fromtimestamp(session.began_at, UTC)
    return (
        session.code,
        "in the simulation's time" if found.study.rehearsed else f"{began:%Y-%m-%d %H:%M}",
        state.ended or (f"left: {state.stopped}" if state.stopped else "not ended"),
        str(state.row),
        f"{state.active_s / 60.0:.0f}",
        f"{len({number for number in state.begun if number})} of {len(blocks)}",
        str(len(trials)),
        str(next(one.counted for one in found.participants if one.participant == session.code)),
        str(sum(trial.void == "invalid" for trial in trials)),
        str(sum(trial.void in VOIDED for trial in trials)),
        str(sum(trial.aborted != "" for trial in trials)),
    )


def _tracks(found: Analysis) -> Section | None:
    codes = [s.code for s in found.study.sessions if any(run.participant == s.code for run in found.runs)]
    if not codes:
        return None
    unit = found.study.unit("stiffness")
    rows = []
    for run in found.runs:
        limit = run.limits.get(found.options.measure)
        rows.append(
            (
                run.participant,
                run.condition,
                run.rule,
                run.state + (f"; {run.note}" if run.note else ""),
                str(run.run),
                str(run.block),
                f"{run.damping:g}",
                str(run.repeat),
                "–"
                if limit is None
                else _bounded(limit.value, limit.censored == "above", limit.censored == "below"),
                "–" if limit is None else _range(limit.low, limit.high),
                str(run.hits),
                f"{run.slips} of {run.catches}",
            )
        )
    head = (
        "participant", "condition", "rule", "state", "run", "block", "B", "repeat", f"limit ({unit})", "95 "
        "%", "hits", "slips",
    )  # fmt: skip
    figures = [Figure(tracks_name(code), TRACKS_CAPTION.format(code=code)) for code in codes]
    return Section(
        "tracks",
        "Searches, one by one",
        folded_figures=figures,
        folded=(Table("Searches", head, rows, words=4),),
        fold="Tracks and limits of every search",
    )


def _questionnaire(found: Analysis) -> Section | None:
    items = {item.name: item for item in found.study.protocol.question}
    rows = [
        (
            session.code,
            items[name].text if name in items else name,
            {0: "start", END: "end"}.get(block, f"after block {block}"),
            str(answer),
        )
        for session in found.study.sessions
        for (name, block), answer in session.state.answered.items()
    ]
    if not rows:
        return None
    table = Table("Answers", ("participant", "question", "when", "answer"), rows, words=4)
    return Section("questionnaire", "Questionnaire", folded=(table,), fold="Answers")


def _deviations(found: Analysis) -> Section:
    decided, useless, written = deviations(found.study), useless_trials(found.study), notes(found.study)
    tables = [
        table
        for table in (_told("Decisions and interruptions", decided), _told("Notes", written))
        if table.rows
    ]
    caption = "Trials that said nothing, or were cut off for safety"
    return Section(
        "deviations",
        "Deviations",
        text=()
        if decided or useless
        else (
            "Nothing was redone, corrected, skipped, started over or interrupted, and every trial said something.",
        ),
        tables=tables,
        folded=(_told(caption, useless),) if useless else (),
        fold=f"{_count(len(useless), 'trial')} that said nothing or were cut off",
        unfolded=True,
    )


def _told(caption: str, found: Sequence[Deviation]) -> Table:
    rows = [(one.participant, _clock(one.at_s), one.what, one.detail) for one in found]
    return Table(caption, ("participant", "after the begin", "what", "details"), rows, words=4)


# ------------------------------------------------------------------------------------------------------------ words


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.4g}".replace("-", _MINUS)


def _signed(value: float) -> str:
    return f"{value:+.4g}".replace("-", _MINUS) if math.isfinite(value) else "–"


def _range(low: float | None, high: float | None, decimals: int | None = None) -> str:
    """An interval, perhaps an open one; a dash where there is none, or it is open on both sides."""
    if low is None or high is None or math.isnan(low) or math.isnan(high) or math.isinf(low):
        return "–"
    how = ".4g" if decimals is None else f".{decimals}f"
    if math.isinf(high):
        return f"{low:{how}} … ∞" if low > 0.0 else "–"
    return f"{low:{how}} … {high:{how}}".replace("-", _MINUS)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _slips(mean: float) -> str:
    """Share of slips; a dash where it is absent, or what was supposed before any verdict."""
    if not math.isfinite(mean) or abs(mean - SLIPS_BEFORE) < _SAME:
        return "–"
    return f"{100 * mean:.1f} %"


def _bounded(value: float, above: int, below: int) -> str:
    mark = "? " if above and below else "≥ " if above else "≤ " if below else ""
    return f"{mark}{_number(value)}"


def _beyond(above: int, below: int, limits: int) -> str:
    told = ", ".join(f"{count} {where}" for count, where in ((above, "above"), (below, "below")) if count)
    return f"{told} of {limits}" if told else "none"


def _p(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _p_text(value: float) -> str:
    return _p(value) if value < 0.001 else f"= {_p(value)}"


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _sha256(path: Path) -> str | None:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None


__all__ = ["Paragraph", "render", "write_session_report"]
