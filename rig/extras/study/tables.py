"""Write the tables of an analysis to disk: as CSV, as Parquet with types and units, and a dictionary of all columns.

A column's name ends in its unit (``stiffness_n_m_per_rad``). The dictionary (``tables.json``) contains the unit in its
usual spelling, the type and the meaning; the columns of the Parquet files carry unit and meaning, too. Unknown values
are empty in CSV and null in Parquet.
"""

import csv
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_type_hints

from rig.core.deferred import parquet, pyarrow
from rig.core.quantity import quantities
from rig.experiments.trials.results import make_directory, write_document
from rig.extras.study.analyse import StudyAnalysis
from rig.extras.study.kmax import Paired
from rig.extras.study.rows import (
    MEASURES,
    AnswerRow,
    LimitInterval,
    Measure,
    ParticipantRow,
    RunRow,
    TrialRow,
)
from rig.extras.study.trials import NUMBERS
from rig.recording.files import whole_file
from rig.session.search import LAPSE_RATES

DICTIONARY = "tables.json"
PRIOR_LAPSE_RATE = sum(LAPSE_RATES) / len(LAPSE_RATES)


@dataclass(frozen=True, slots=True)
class DataColumn:
    """A column of a table: name without unit, type, quantity or unit, meaning, and function `of` a row to its value."""

    name: str
    kind: type
    quantity: str
    meaning: str
    of: Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class DataTable:
    """A table: name of its file, meaning of a row, its columns, and the objects whose values are its rows."""

    name: str
    row: str
    columns: tuple[DataColumn, ...]
    rows: Sequence[Any]


def write_study_tables(found: StudyAnalysis, directory: str | Path) -> dict[str, Path]:
    """Write all tables into a directory, which is created if it is missing; return the path of each file by name.

    Existing tables are replaced. Raises `RecordingError` if a file cannot be written.
    """
    place = Path(directory)
    make_directory(place)
    written: dict[str, Path] = {}
    described = {}
    for table in tables(found):
        names = [column_name(column, found) for column in table.columns]
        rows = [[_plain(column.of(row)) for column in table.columns] for row in table.rows]
        for suffix, write in ((".csv", _write_csv), (".parquet", _write_parquet)):
            path = place / f"{table.name}{suffix}"
            write(path, table, names, rows, found)
            written[path.name] = path
        described[table.name] = {
            "row": table.row,
            "rows": len(rows),
            "columns": {
                name: {"unit": _unit(column, found), "type": column.kind.__name__, "meaning": column.meaning}
                for name, column in zip(names, table.columns, strict=True)
            },
        }
    path = place / DICTIONARY
    write_document(path, {"study": found.study.protocol.study.title, "tables": described})
    written[path.name] = path
    return written


def column_name(column: DataColumn, found: StudyAnalysis) -> str:
    """Return a column's name with its unit; the plain name if it has no unit or already ends in the unit."""
    unit = _unit(column, found)
    slug = unit.lower().replace("·", "_").replace("/", "_per_").replace("²", "2")
    return column.name if unit in ("", "1") or column.name.endswith(f"_{slug}") else f"{column.name}_{slug}"


def _unit(column: DataColumn, found: StudyAnalysis) -> str:
    return found.study.unit(column.quantity) if column.quantity else ""


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _write_csv(
    path: Path, table: DataTable, names: Sequence[str], rows: Sequence[Sequence[Any]], found: StudyAnalysis
) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow(
            [
                "" if cell is None else str(cell).lower() if cell is True or cell is False else cell
                for cell in row
            ]
        )
    with whole_file(path, overwrite=True) as file:
        file.write(text.getvalue().encode("utf-8"))


def _write_parquet(
    path: Path, table: DataTable, names: Sequence[str], rows: Sequence[Sequence[Any]], found: StudyAnalysis
) -> None:

    types = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    schema = pyarrow.schema(
        [
            pyarrow.field(
                name,
                types[column.kind],
                metadata={"unit": _unit(column, found), "description": column.meaning},
            )
            for name, column in zip(names, table.columns, strict=True)
        ],
        metadata={"rig.study": json.dumps({"title": found.study.protocol.study.title, "row": table.row})},
    )
    columns = [
        pyarrow.array([row[place] for row in rows], type=types[column.kind])
        for place, column in enumerate(table.columns)
    ]
    with whole_file(path, overwrite=True) as file:
        parquet.write_table(pyarrow.Table.from_arrays(columns, schema=schema), file, compression="zstd")


# ------------------------------------------------------------------------------------------------ the tables


def tables(found: StudyAnalysis) -> tuple[DataTable, ...]:
    """Return all tables of an analysis, in the order in which they are written."""
    return (
        DataTable("participants", "a participant", (*_PARTICIPANTS, *_items(found)), found.participants),
        DataTable("answers", "an answer to the questionnaire", _ANSWERS, found.answers),
        DataTable("trials", "one recorded hit", _TRIALS, found.trials),
        DataTable("runs", "one search: a condition, a damping, a repeat", _RUNS, found.runs),
        DataTable("kmax", "a participant under a condition at a damping", _KMAX, found.of_participants),
        DataTable("kmax_over_participants", "a condition at a damping", _OVER, found.over_participants),
        DataTable("differences", "a difference of two conditions", _DIFFERENCES, _differences(found)),
        DataTable("agreement", "a cell of a table of confusions", _AGREEMENT, _list_confusions(found)),
        DataTable("psychometric", _FUNCTION, _PSYCHOMETRIC, found.psychometrics),
        DataTable("effects", "a slope along the session", _EFFECTS, found.slopes),
        DataTable("blocks", "a block of a participant", _BLOCKS, found.blocks),
    )


def _own(name: str, kind: type, quantity: str, meaning: str, field: str = "") -> DataColumn:
    """Describe a table column whose value is the row's field `field`, or the field with the column's name."""
    return DataColumn(name, kind, quantity, meaning, lambda row: getattr(row, field or name))


def columns_of(described: type, *names: str) -> tuple[DataColumn, ...]:
    """Describe columns, by their annotations, for all fields of a row class or for the fields `names`."""
    known, hints = quantities(described), get_type_hints(described)
    return tuple(
        DataColumn(
            name.removesuffix("_s") if known[name].unit == "s" else name,
            _kind(hints[name]),
            known[name].unit,
            known[name].meaning,
            attrgetter(name),
        )
        for name in names or known
    )


def _kind(hint: Any) -> type:
    kinds = (
        [one for one in get_args(hint) if one is not type(None)] if isinstance(hint, UnionType) else [hint]
    )
    return next((kind for kind in (bool, int, float) if kind in kinds), str)


_CONDITION = _own("condition", str, "", "name in the protocol")
_DAMPING = _own("damping", float, "damping", "B of the wall")
_PARTICIPANT = _own("participant", str, "", "code")
_CATCHES = (
    DataColumn(
        "soft_catches",
        int,
        "",
        "judged catch trials of the softest wall; empty if the limit lies below it",
        lambda row: row.caught.soft,
    ),
    DataColumn(
        "false_unstable",
        int,
        "",
        "soft catch trials judged not stable",
        lambda row: row.caught.false_unstable,
    ),
    DataColumn(
        "stiff_catches",
        int,
        "",
        "judged catch trials of the stiffest wall; empty if the limit lies above it",
        lambda row: row.caught.stiff,
    ),
    DataColumn(
        "false_stable", int, "", "stiff catch trials judged stable", lambda row: row.caught.false_stable
    ),
)
_PARTICIPANTS = (*columns_of(ParticipantRow), *_CATCHES)
_ANSWERS = columns_of(AnswerRow)
_OUTSIDE = DataColumn(
    "outside", str, "", quantities(TrialRow)["outside"].meaning, lambda row: "; ".join(row.outside)
)
_TRIALS = (*columns_of(
    TrialRow,
    "participant", "row", "block", "run", "place", "trial", "attempt", "condition", "scheme", "damping", "repeat",
    "stiffness", "track", "catch", "practice", "void", "automatic", "automatic_stable", "verdict", "judged_by",
    "amended", "response_time_s", "ended", "aborted", "since_begin_s", "heat", *NUMBERS, "baseline_velocity",
    "baseline_effort", "recording", "recorded",
), _OUTSIDE)  # fmt: skip


def _limit(measure: Measure, field: str) -> Callable[[RunRow], Any]:
    def of(run: RunRow) -> Any:
        limit: LimitInterval | None = run.limits.get(measure)
        return None if limit is None else getattr(limit, field)

    return of


def _limit_columns(measure: Measure) -> tuple[DataColumn, ...]:
    name = measure.lower().replace(" ", "_")
    meaning = {
        "rule": "limit by the search rule, from the verdicts that it used",
        "K50 person": "stiffness judged stable in half of the trials, from the person's verdicts",
        "K50 automatic": "stiffness judged stable in half of the trials, from the automatic verdicts",
    }[measure]
    return (
        DataColumn(f"limit_{name}", float, "stiffness", meaning, _limit(measure, "value")),
        DataColumn(
            f"limit_{name}_low", float, "stiffness", "lower end of the 95 % interval", _limit(measure, "low")
        ),
        DataColumn(
            f"limit_{name}_high",
            float,
            "stiffness",
            "upper end of the 95 % interval; empty: open",
            _limit(measure, "high"),
        ),
        DataColumn(
            f"limit_{name}_beyond",
            str,
            "",
            "above or below: the limit lies beyond the searched levels",
            _limit(measure, "censored"),
        ),
        DataColumn(
            f"limit_{name}_mark",
            str,
            "",
            "why the verdicts do not determine the limit, so that it is excluded from K_max by default; empty: they do",
            _limit(measure, "mark"),
        ),
    )


_SEARCH = columns_of(RunRow)
_SPLIT = next(place for place, column in enumerate(_SEARCH) if column.name == "trials")
_RUNS = (
    *_SEARCH[:_SPLIT],
    *(column for measure in MEASURES for column in _limit_columns(measure)),
    *_SEARCH[_SPLIT:],
    *_CATCHES,
)
_MEASURE = _own("measure", str, "", "how limits are estimated: rule, K50 person, K50 automatic")
_BEYOND = (
    _own("limits", int, "", "number of limits used: one per run (rule) or per participant (K50)"),
    _own("above", int, "", "number of these limits above the stiffest level"),
    _own("below", int, "", "number of these limits below the softest level"),
    _own(
        "marked",
        int,
        "",
        "number of these limits that their verdicts do not determine; 0 unless such limits are included",
    ),
)
_MEAN = (
    _own("kmax", float, "stiffness", "mean", "mean"),
    _own("kmax_low", float, "stiffness", "lower end of the interval of 95 %", "low"),
    _own("kmax_high", float, "stiffness", "upper end", "high"),
    _own("deviation", float, "stiffness", "standard deviation of the averaged values"),
)
_KMAX = (
    _MEASURE,
    _PARTICIPANT,
    _CONDITION,
    _DAMPING,
    _own("repeats", int, "", "number of averaged runs"),
    *_MEAN,
    _own(
        "interval",
        str,
        "",
        "source of kmax_low and kmax_high: Student or bootstrap over repeats; the single run; all verdicts together "
        "(an interval of the stiffness estimated from them, which need not contain the rule's mean in kmax); none",
    ),
    _own(
        "student_low",
        float,
        "stiffness",
        "lower end of Student's interval over repeats; empty below three repeats, or if only rounding scatters them",
    ),
    _own("student_high", float, "stiffness", "upper end"),
    _own(
        "bootstrap_low",
        float,
        "stiffness",
        "lower end of the bootstrap interval over repeats; empty below three repeats",
    ),
    _own("bootstrap_high", float, "stiffness", "upper end"),
    *_BEYOND,
)
_OVER = (
    _MEASURE,
    _CONDITION,
    _DAMPING,
    _own("participants", int, "", "number of averaged participants"),
    _own("runs", int, "", "number of runs of all participants"),
    *_MEAN,
    _own("problem", str, "", "why there is no interval"),
    *_BEYOND,
)
_DIFFERENCES = (
    DataColumn("measure", str, "", "how limits are estimated", lambda row: row["measure"]),
    DataColumn(
        "method",
        str,
        "",
        "paired: Student's test within participants; mixed: the mixed model",
        lambda row: row["method"],
    ),
    DataColumn("condition", str, "", "name in the protocol", lambda row: row["condition"]),
    DataColumn("against", str, "", "condition that is subtracted", lambda row: row["against"]),
    DataColumn(
        "damping",
        float,
        "damping",
        "B of the wall; empty: mean over all dampings",
        lambda row: row["damping"],
    ),
    DataColumn(
        "participants",
        int,
        "",
        "number of participants with both conditions",
        lambda row: row["participants"],
    ),
    DataColumn(
        "difference",
        float,
        "stiffness",
        "limit of condition minus limit of against",
        lambda row: row["difference"],
    ),
    DataColumn(
        "difference_low",
        float,
        "stiffness",
        "lower end of the 95 % interval; empty if problem gives a reason",
        lambda row: row["low"],
    ),
    DataColumn("difference_high", float, "stiffness", "upper end", lambda row: row["high"]),
    DataColumn("p", float, "1", "two-sided p value of no difference", lambda row: row["p"]),
    DataColumn(
        "p_holm",
        float,
        "1",
        "p corrected (Holm) for all differences of the same measure and method",
        lambda row: row["holm"],
    ),
    DataColumn(
        "bound",
        str,
        "",
        "limits beyond the searched levels make the difference a bound: at least, at most, or unknown (both); empty: "
        "no such limits",
        lambda row: row["bound"],
    ),
    DataColumn("problem", str, "", "why there is no interval and no p", lambda row: row["problem"]),
    DataColumn("limits", int, "", "number of limits used", lambda row: row["beyond"].limits),
    DataColumn(
        "beyond", int, "", "number of limits beyond the searched levels", lambda row: row["beyond"].count
    ),
    DataColumn(
        "marked",
        int,
        "",
        "number of limits that their verdicts do not determine; 0 unless such limits are included",
        lambda row: row["beyond"].marked,
    ),
)
_AGREEMENT = (
    DataColumn("table", str, "", "two, three or four classes", lambda row: row["name"]),
    DataColumn("condition", str, "", "of the trials; empty: all", lambda row: row["condition"]),
    DataColumn("weights", str, "", "weights of disagreements in kappa", lambda row: row["weights"]),
    DataColumn("person", str, "", "class of the person's verdict", lambda row: row["person"]),
    DataColumn("automatic", str, "", "class of the automatic verdict", lambda row: row["automatic"]),
    DataColumn("trials", int, "", "trials with this pair of verdicts", lambda row: row["trials"]),
    DataColumn("kappa", float, "1", "Cohen's kappa of the whole table", lambda row: row["kappa"]),
    DataColumn(
        "kappa_low",
        float,
        "1",
        "lower end of the 95 % interval over people (jackknife)",
        lambda row: row["low"],
    ),
    DataColumn("kappa_high", float, "1", "upper end", lambda row: row["high"]),
    DataColumn("problem", str, "", "why there is no interval", lambda row: row["problem"]),
    DataColumn(
        "same", float, "1", "share of trials in which both verdicts are equal", lambda row: row["share"]
    ),
    DataColumn(
        "positive",
        float,
        "1",
        "agreement on stable: share of the stable verdicts given by either that are given by both; two classes",
        lambda row: row["positive"],
    ),
    DataColumn(
        "negative", float, "1", "agreement on not stable, defined likewise", lambda row: row["negative"]
    ),
    DataColumn(
        "people",
        int,
        "",
        "number of people who judged the trials of the whole table",
        lambda row: row["people"],
    ),
    DataColumn(
        "left_out",
        int,
        "",
        "judged trials missing in the whole table, because one of the two verdicts is missing",
        lambda row: row["left_out"],
    ),
)
_FUNCTION = (
    f"a psychometric function; a lapse rate near {PRIOR_LAPSE_RATE:g}, the mean of the prior, is "
    "not determined by the verdicts"
)
_PSYCHOMETRIC = (
    _own("participant", str, "", "code; empty: all participants together"),
    _CONDITION,
    _DAMPING,
    _own("judge", str, "", "whose verdicts"),
    _own("participants", int, "", "number of participants"),
    DataColumn("verdicts", int, "", "number of verdicts", lambda row: sum(row.verdicts)),
    DataColumn(
        "k50",
        float,
        "stiffness",
        "stiffness judged stable in half of the trials: median of the posterior, or the end of the levels if beyond; "
        "over all participants the mean of theirs",
        lambda row: row.threshold.mean,
    ),
    DataColumn(
        "k50_low",
        float,
        "stiffness",
        "lower end of the 95 % interval: of the posterior, assuming one K50 in all repeats; over all participants "
        "Student's, for three or more",
        lambda row: row.threshold.low,
    ),
    DataColumn(
        "k50_high",
        float,
        "stiffness",
        "upper end; empty: open, or no interval",
        lambda row: row.threshold.high,
    ),
    _own(
        "mark",
        str,
        "",
        "why the verdicts do not determine K50; over all participants, in how many; empty: they do",
    ),
    _own("above", int, "", "participants whose K50 lies above the stiffest level"),
    _own("below", int, "", "participants whose K50 lies below the softest level"),
    DataColumn(
        "spread",
        float,
        "stiffness",
        "scale s of the logistic psychometric function",
        lambda row: row.spread.mean,
    ),
    DataColumn(
        "spread_low", float, "stiffness", "lower end; empty over all participants", lambda row: row.spread.low
    ),
    DataColumn("spread_high", float, "stiffness", "upper end", lambda row: row.spread.high),
    DataColumn("lapse_rate", float, "1", "share of inverted verdicts", lambda row: row.lapse_rate.mean),
    DataColumn(
        "lapse_rate_low", float, "1", "lower end; empty over all participants", lambda row: row.lapse_rate.low
    ),
    DataColumn("lapse_rate_high", float, "1", "upper end", lambda row: row.lapse_rate.high),
)
_EFFECTS = (
    _own("of", str, "", "quantity: limit (stiffness), response time (natural logarithm), invalid (0 or 1)"),
    _own(
        "along", str, "", "against what: order (place in the block), block, or trial (number in the session)"
    ),
    _own("measure", str, "", "measure of the limit; empty for other quantities"),
    _own("values", int, "", "number of values used", "count"),
    _own("participants", int, "", "number of participants with a slope of their own"),
    _own(
        "slope",
        float,
        "",
        "mean of the participants' slopes per place, block or trial, with the effect of conditions removed",
    ),
    _own("slope_low", float, "", "lower end of Student's 95 % interval over participants", "low"),
    _own("slope_high", float, "", "upper end", "high"),
    _own("p", float, "1", "two-sided p value of a zero slope; exploratory, not planned"),
    _own("p_holm", float, "1", "p corrected (Holm) for the slopes of the same quantity", "holm"),
    _own("problem", str, "", "why there is no slope or no interval"),
)
_BLOCKS = (
    _PARTICIPANT,
    _own("block", int, "", "number, from 1"),
    _own("trials", int, "", "recorded hits"),
    _own("invalid", int, "", "invalid ones"),
    _own("redone", int, "", "trials repeated on request"),
    _own("aborted", int, "", "trials cut off for safety"),
    _own("unsure", int, "", "verdicts"),
    _own("response_time", float, "s", "median time to a verdict", "response_s"),
)


def _items(found: StudyAnalysis) -> tuple[DataColumn, ...]:
    """Return a column for each question that was asked once: integer for a scale, else text."""
    return tuple(
        DataColumn(
            f"answer_{item.name}", int if item.kind == "scale" else str, "", item.text, _answer(item.name)
        )
        for item in found.study.protocol.question
        if item.when != "block"
    )


def _answer(item: str) -> Callable[[ParticipantRow], Any]:
    return lambda row: row.answers.get(item)


def _differences(found: StudyAnalysis) -> list[Mapping[str, Any]]:
    rows: list[Mapping[str, Any]] = [
        _difference(one, one.measure, "paired", one.participants) for one in found.paired
    ]
    rows += [
        _difference(one, model.measure, "mixed", model.participants)
        for model in found.mixed
        for one in model.contrasts
    ]
    return rows


def _difference(one: Any, measure: Measure, method: str, participants: int) -> Mapping[str, Any]:
    fields = ("condition", "against", "damping", "difference", "low", "high", "p", "holm", "bound", "beyond")
    values = {name: getattr(one, name) for name in fields}
    values["problem"] = one.problem if isinstance(one, Paired) else ""
    return {"measure": measure, "method": method, "participants": participants, **values}


_OF_TABLE = ("kappa", "low", "high", "problem", "share", "positive", "negative", "people", "left_out")


def _list_confusions(found: StudyAnalysis) -> list[Mapping[str, Any]]:
    return [
        {
            "name": table.name,
            "condition": table.condition,
            "weights": table.weights,
            "person": person,
            "automatic": automatic,
            "trials": table.counts[row][column],
            **{name: getattr(table, name) for name in _OF_TABLE},
        }
        for table in found.agreements
        for row, person in enumerate(table.classes)
        for column, automatic in enumerate(table.classes)
    ]
