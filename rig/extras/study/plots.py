"""Draw the pictures of a study: Z-width over participants, searches, psychometric functions, agreement, fatigue.

Each condition has one colour and one marker in all pictures. Verdicts differ in colour and in shape. Triangles mark
limits beyond the levels (searched stiffnesses): ▲ above the stiffest, ▼ below the softest.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rig.extras.study.agreement import Agreement
from rig.extras.study.analyse import StudyAnalysis
from rig.extras.study.effects import less_means
from rig.extras.study.kmax import OfParticipant, OverParticipants
from rig.extras.study.psychometric import PsychometricFit
from rig.extras.study.rows import Measure, RunRow, TrialRow
from rig.extras.study.trial_facts import file_name
from rig.views.plots import style

MEASURES: Mapping[Measure, str] = {
    "rule": "limit by the search rule",
    "K50 person": "K50 of the person's verdicts",
    "K50 automatic": "K50 of the automatic verdicts",
}
TRACKS = "tracks-"
MARKERS = "osDPX*hd"
VERDICTS: Mapping[str, tuple[str, str]] = {  # colour, marker
    "stable": (style.KINDS["stable"], "o"),
    "buzz": (style.KINDS["limit cycle"], "s"),
    "unstable": (style.BAD, "X"),
    "unsure": ("#56b4e9", "d"),
    "": (style.KINDS["invalid"], "x"),
}
_VERDICT_WORDS = {"": "invalid"}
EACH, ALL, ONE = "each participant", "all participants", "the participant"
AUTOMATIC, VERDICTS_THERE = "automatic verdicts", "verdicts, their number as area"
K50, K50_INTERVAL = "K50", "its interval of 95 %"
CURVES: Mapping[str, dict[str, Any]] = {  # lines and markers of a psychometric picture
    ALL: {"linewidth": 3.0},
    ONE: {"linewidth": 3.0},
    EACH: {"linewidth": 0.6, "alpha": 0.5},
    AUTOMATIC: {"color": "#000000", "linewidth": 1.0, "linestyle": "--"},
    VERDICTS_THERE: {"marker": "o", "linestyle": "", "fillstyle": "none", "markersize": 6},
    K50: {"color": "#222222", "marker": "|", "linestyle": "", "markersize": 9},
    K50_INTERVAL: {"color": "#222222", "linewidth": 2.4, "solid_capstyle": "butt"},
}
_LARGEST = 98.0  # area of a circle (pt²)
_RUNS_IN_A_ROW = 4
_TOGETHER = 10  # verdicts whose median time is one point
_LIMIT = {"color": "#333333", "linewidth": 0.9}
_INTERVAL = {"color": "#cccccc", "alpha": 0.5, "linewidth": 0.0}
_WAY = {"color": "#999999", "linewidth": 0.6}
_RING = {"s": 46, "facecolors": "none", "edgecolors": "#333333", "linewidths": 0.6}
_LEAST_SPAN = 0.1  # of an axis of limits, over the largest: what is closer together is alike
_QUIET = "#bbbbbb"

Draw = Callable[[StudyAnalysis], Any]


def pictures(found: StudyAnalysis) -> dict[str, Draw]:
    """Return a drawing function for each picture that the results allow, by name of the picture."""
    chosen: dict[str, Draw] = {}
    if found.over_participants:
        chosen["zwidth"] = partial(zwidth_figure, measure=found.options.measure)
    if found.psychometrics:
        chosen["psychometric"] = psychometric_figure
    if any(one.trials for one in found.agreements):
        chosen["agreement"] = agreement_figure
    if any(run.limits for run in found.runs):
        chosen["effects"] = effects_figure
    for session in found.study.sessions:
        if any(run.participant == session.code for run in found.runs):
            chosen[tracks_name(session.code)] = partial(tracks_figure, code=session.code)
    return chosen


def draw_study(
    found: StudyAnalysis,
    directory: Path,
    endings: Iterable[str] = ("png", "svg"),
    *,
    watch: Callable[[int, int], None] | None = None,
    on_failure: Callable[[Exception, str], None] | None = None,
) -> dict[str, Path]:
    """Draw all pictures of a study into an existing directory, in the formats `endings`; return the paths by name.

    Existing files of the same names are replaced. `watch` is called with the number of finished pictures and the total,
    `on_failure` with the error and the picture's name if a picture fails (None: the error is raised). Raises
    `RecordingError` if a file cannot be written.
    """
    written: dict[str, Path] = {}
    chosen = pictures(found)
    for number, (name, draw) in enumerate(chosen.items(), start=1):
        try:
            figure = draw(found)
            for file in dict.fromkeys(f"{name}.{ending}" for ending in endings):
                written[file] = style.save(figure, directory / file)
                # The layout is computed by the first file; computing it again takes as long as drawing.
                figure.set_layout_engine("none")
        except Exception as error:
            if on_failure is None:
                raise
            on_failure(error, name)
        if watch is not None:
            watch(number, len(chosen))
    return written


def tracks_name(code: str) -> str:
    """Return the file name, without ending, of the picture of a participant's searches (stiffness over trials)."""
    return f"{TRACKS}{file_name(code)}"


# --------------------------------------------------------------------------------------------------------- Z-width


@style.own_style()
def zwidth_figure(found: StudyAnalysis, measure: Measure) -> Any:
    """Draw K_max (stiffest stable wall) over B by condition, for each participant and as a mean with intervals.

    With a single damping the conditions are side by side, and a line joins the values of each participant.
    """
    each = [one for one in found.of_participants if one.measure == measure]
    over = [one for one in found.over_participants if one.measure == measure]
    dampings = sorted({one.damping for one in each})
    figure = style.new_figure(7.2, 5.0)
    axes = figure.subplots()
    if len(dampings) > 1:
        _over_damping(axes, found, each, over, dampings)
        axes.set_xlabel(f"damping B ({found.study.unit('damping')})")
    else:
        _side_by_side(axes, found, each, over)
        damping = dampings[0] if dampings else 0.0
        axes.set_xlabel(f"condition, at B = {damping:g} {found.study.unit('damping')}")
    axes.set_ylim(bottom=0.0)
    style.tidy(axes, f"stiffest wall K ({found.study.unit('stiffness')})")
    participants = len({one.participant for one in each})
    title = "Z-width" if len(dampings) > 1 else "Stiffest wall at one damping"
    figure.suptitle(f"{title}, {MEASURES[measure]}; {_people(found, participants)}", fontsize=11)
    return figure


def _over_damping(
    axes: Any,
    found: StudyAnalysis,
    each: Sequence[OfParticipant],
    over: Sequence[OverParticipants],
    dampings: Sequence[float],
) -> None:
    names = _conditions(found)
    apart = 0.012 * (dampings[-1] - dampings[0])
    for number, name in enumerate(names):
        colour, marker, shift = (
            style_of(number),
            MARKERS[number % len(MARKERS)],
            (number - (len(names) - 1) / 2) * apart,
        )
        for code in dict.fromkeys(one.participant for one in each):
            line = [one for one in each if one.participant == code and one.condition == name]
            line.sort(key=lambda one: one.damping)
            axes.plot(
                [one.damping for one in line],
                [one.mean for one in line],
                color=colour,
                linewidth=0.7,
                alpha=0.4,
                zorder=1,
            )
            for one in line:
                _draw_censored(axes, one.damping, one.mean, one.above, one.below, colour, size=22, alpha=0.6)
        means = sorted((one for one in over if one.condition == name), key=lambda one: one.damping)
        if not means:
            continue
        at = [one.damping + shift for one in means]
        _draw_means(axes, at, means, each, colour, marker, name)
        axes.plot(at, [one.mean for one in means], color=colour, linewidth=1.8, zorder=3)
    axes.legend(fontsize=8, loc="best")
    axes.set_xlim(dampings[0] - 6 * apart, dampings[-1] + 6 * apart)


def _side_by_side(
    axes: Any, found: StudyAnalysis, each: Sequence[OfParticipant], over: Sequence[OverParticipants]
) -> None:
    names = _conditions(found)
    for code in dict.fromkeys(one.participant for one in each):
        line = [(names.index(one.condition), one) for one in each if one.participant == code]
        line.sort(key=lambda pair: pair[0])
        axes.plot(
            [number for number, _ in line],
            [one.mean for _, one in line],
            color=_QUIET,
            linewidth=0.8,
            zorder=1,
        )
        for number, one in line:
            colour = style_of(number)
            axes.plot([number], [one.mean], "o", color=colour, markersize=4, alpha=0.5, zorder=2)
            _draw_censored(axes, number, one.mean, one.above, one.below, colour, size=26, alpha=0.7)
    for number, name in enumerate(names):
        means = [one for one in over if one.condition == name]
        if means:
            _draw_means(
                axes, [number + 0.12], means, each, style_of(number), MARKERS[number % len(MARKERS)], name
            )
    axes.set_xticks(range(len(names)), [_plain(name) for name in names])
    axes.set_xlim(-0.6, len(names) - 0.4)


def _draw_means(
    axes: Any,
    at: Sequence[float],
    means: Sequence[OverParticipants],
    each: Sequence[OfParticipant],
    colour: str,
    marker: str,
    name: str,
) -> None:
    """Draw means of one condition with 95 % intervals: over participants, or over repeats of a single participant."""
    ends = [_ends(one, each) for one in means]
    lengths = np.array(
        [
            [max(one.mean - low, 0.0), max(high - one.mean, 0.0)]
            for one, (low, high) in zip(means, ends, strict=True)
        ]
    ).T
    axes.errorbar(
        at,
        [one.mean for one in means],
        yerr=np.nan_to_num(lengths),
        fmt=marker,
        color=colour,
        markersize=6,
        capsize=3,
        linewidth=1.6,
        label=_plain(name),
        zorder=4,
    )
    for x, one in zip(at, means, strict=True):
        _draw_censored(axes, x, one.mean, one.above, one.below, colour, size=60, alpha=1.0)


def _ends(one: OverParticipants, each: Sequence[OfParticipant]) -> tuple[float, float]:
    if math.isfinite(one.low) and math.isfinite(one.high):
        return one.low, one.high
    only = [o for o in each if (o.condition, o.damping) == (one.condition, one.damping)]
    ends = (only[0].low, only[0].high) if len(only) == 1 else (math.nan, math.nan)
    return ends if all(math.isfinite(end) for end in ends) else (one.mean, one.mean)


def _draw_censored(
    axes: Any,
    position: float,
    value: float,
    above: int,
    below: int,
    colour: str,
    *,
    size: float,
    alpha: float,
) -> None:
    for count, marker in ((above, "^"), (below, "v")):
        if count:
            axes.scatter([position], [value], marker=marker, s=size, color=colour, alpha=alpha, zorder=5)


# ---------------------------------------------------------------------------------------------- psychometric curves


@style.own_style()
def psychometric_figure(found: StudyAnalysis) -> Any:
    """Draw the share of stable verdicts over stiffness: a row of panels for each condition, a column per damping.

    A fitted function is drawn if its K50 (stiffness with half of the verdicts stable) lies within the searched
    stiffnesses; `CURVES` lists the lines and markers.
    """
    judge = "person" if any(one.judge == "person" for one in found.psychometrics) else "automatic"
    names = _conditions(found)
    dampings = sorted({one.damping for one in found.psychometrics})
    rows, columns = len(names), max(len(dampings), 1)
    figure = style.new_figure(1.0 + 3.0 * columns, 0.9 + 2.2 * rows)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    unit = found.study.unit("stiffness")
    most = max(count for one in found.psychometrics for count in one.verdicts)
    drawn: set[str] = set()
    for row, name in enumerate(names):
        for column, damping in enumerate(dampings):
            axes = panels[row][column]
            of = [one for one in found.psychometrics if (one.condition, one.damping) == (name, damping)]
            drawn |= _draw_functions(axes, of, judge, style_of(row), most)
            axes.set_ylim(-0.05, 1.05)
            style.lighten(axes)
            if not of:
                axes.set_axis_off()
            if row == 0:
                axes.set_title(f"B = {damping:g} {found.study.unit('damping')}", fontsize=9)
            if row == rows - 1:
                axes.set_xlabel(f"stiffness K ({unit})", fontsize=9)
            if column == 0:
                axes.set_ylabel(f"{_plain(name)}\nshare stable", fontsize=9)
            axes.tick_params(labelsize=8)
    for label in (known for known in CURVES if known in drawn):
        panels[0][0].plot([], [], **{"color": "#444444", **CURVES[label]}, label=label)
    style.key_below(figure, panels[0][0])
    whose = "the person's verdicts" if judge == "person" else "the automatic verdicts"
    figure.suptitle(f"Psychometric functions of {whose}", fontsize=11)
    return figure


def _draw_functions(axes: Any, of: Sequence[PsychometricFit], judge: str, colour: str, most: int) -> set[str]:
    """Draw psychometric functions and shares of stable verdicts in a panel; return the drawn keys of `CURVES`.

    The circle of a stiffness grows with its number of verdicts; `most` verdicts give the largest circle.
    """
    mine = [one for one in of if one.judge == judge]
    together = _find_common(mine)
    if together is None:
        return set()
    low, high = together.levels[0], together.levels[-1]
    margin = 0.05 * (high - low) or 0.05 * high
    at = np.linspace(max(low - margin, 0.0), high + margin, 200)
    other = _find_common([one for one in of if one.judge != judge])
    curves: dict[str, Sequence[PsychometricFit | None]] = {
        EACH: [one for one in mine if one is not together],
        ONE if together.participant else ALL: [together],
        AUTOMATIC: [other],  # drawn on top, since it is often equal to the one before
    }
    drawn = {VERDICTS_THERE}
    for label, some in curves.items():
        for one in (one for one in some if one is not None and one.bounded):
            axes.plot(at, one.share(at), **{"color": colour, **CURVES[label]})
            drawn.add(label)
    shares = [stable / count for stable, count in zip(together.stable, together.verdicts, strict=True)]
    sizes = [_LARGEST * count / most for count in together.verdicts]
    axes.scatter(together.levels, shares, s=sizes, facecolors="none", edgecolors=colour, linewidths=1.0)
    threshold = together.threshold
    if together.bounded:
        axes.plot([threshold.mean], [0.5], **CURVES[K50])
        drawn.add(K50)
        if math.isfinite(threshold.low) and math.isfinite(threshold.high):
            axes.plot([threshold.low, threshold.high], [0.5, 0.5], **CURVES[K50_INTERVAL])
            drawn.add(K50_INTERVAL)
    where = (
        (0.98, 0.93, "right", "top") if 2.0 * threshold.mean < low + high else (0.02, 0.07, "left", "bottom")
    )
    x, y, ha, va = where  # the corner from which the function is far
    axes.text(x, y, _describe_k50(together), transform=axes.transAxes, ha=ha, va=va, fontsize=7.5)
    return drawn


def _describe_k50(one: PsychometricFit) -> str:
    """Return K50 as text, with ≥ or ≤ if it is a bound; if participants have bounds of both kinds, their number."""
    if one.above and one.below:
        return f"K50 of {one.above + one.below} of {one.participants} censored"
    mark = "≥" if one.above else "≤" if one.below else "="
    return f"K50 {mark} {one.threshold.mean:.4g}"


def _find_common(of: Sequence[PsychometricFit]) -> PsychometricFit | None:
    for one in of:
        if one.participant == "":
            return one
    return of[0] if of else None


# ----------------------------------------------------------------------------------------------------------- tracks


@style.own_style()
def tracks_figure(found: StudyAnalysis, code: str) -> Any:
    """Draw the stiffness of each trial with its verdict, in a panel for each search (run) of a participant."""
    runs = [run for run in found.runs if run.participant == code]
    trials = [trial for trial in found.trials if trial.participant == code and not trial.practice]
    columns = min(_RUNS_IN_A_ROW, max(len(runs), 1))
    rows = math.ceil(max(len(runs), 1) / columns)
    figure = style.new_figure(0.9 + 2.5 * columns, 1.1 + 1.7 * rows)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for place, axes in enumerate(panels.flat):
        if place >= len(runs):
            axes.set_axis_off()
            continue
        _draw_track(axes, runs[place], [trial for trial in trials if trial.run == runs[place].run], found)
        if place % columns == 0:
            axes.set_ylabel(f"K ({found.study.unit('stiffness')})", fontsize=8)
        if place + columns >= len(runs):
            axes.set_xlabel("trial", fontsize=8)
    _add_legend(panels[0][0], [trial for run in runs for trial in trials if trial.run == run.run])
    if any(found.options.measure in run.limits for run in runs):
        panels[0][0].plot([], [], **_LIMIT, label=MEASURES[found.options.measure])
        panels[0][0].fill_between([], [], **_INTERVAL, label="its interval of 95 %")
    style.key_below(figure, panels[0][0])
    figure.suptitle(f"Tracks of {_plain(code)}", fontsize=10)
    return figure


def _draw_track(axes: Any, run: RunRow, trials: Sequence[TrialRow], found: StudyAnalysis) -> None:
    limit = run.limits.get(found.options.measure)
    if limit is not None:
        low, high = (end if math.isfinite(end) else limit.value for end in (limit.low, limit.high))
        axes.axhspan(low, high, **_INTERVAL)
        axes.axhline(limit.value, **_LIMIT)
    for track in sorted({trial.track for trial in trials if not trial.catch}):
        counted = [trial for trial in trials if trial.track == track and not trial.void and not trial.catch]
        axes.plot(
            [trial.trial for trial in counted], [trial.stiffness for trial in counted], **_WAY, zorder=1
        )
    for verdict, (colour, marker) in VERDICTS.items():
        for counts in (True, False):
            some = [
                trial for trial in trials if _verdict_of(trial) == verdict and (trial.void == "") == counts
            ]
            if not some:
                continue
            axes.scatter(
                [trial.trial for trial in some],
                [trial.stiffness for trial in some],
                marker=marker,
                s=13,
                **_paint(colour, counts or marker == "x"),
                linewidths=0.8,
                zorder=3,
            )
    caught = [trial for trial in trials if trial.catch]
    axes.scatter([trial.trial for trial in caught], [trial.stiffness for trial in caught], **_RING, zorder=2)
    marked = limit is not None and limit.mark and run.state == "complete"
    state = ", limit marked" if marked else "" if run.state == "complete" else f", {run.state}"
    title = f"{run.run}. {_plain(run.condition)}, B = {run.damping:g}, repeat {run.repeat}{state}"
    axes.set_title(title, fontsize=7)
    style.count_along(axes)
    axes.tick_params(labelsize=7)
    style.lighten(axes)


def _verdict_of(trial: TrialRow) -> str:
    return "" if trial.void == "invalid" else trial.verdict


def _paint(colour: str, filled: bool) -> dict[str, Any]:
    return {"color": colour} if filled else {"facecolors": "none", "edgecolors": colour}


def _add_legend(axes: Any, trials: Sequence[TrialRow]) -> None:
    for verdict, (colour, marker) in VERDICTS.items():
        if any(_verdict_of(trial) == verdict for trial in trials):
            name = _VERDICT_WORDS.get(verdict, verdict)
            axes.scatter([], [], marker=marker, s=18, color=colour, label=name)
    if any(trial.void and _verdict_of(trial) for trial in trials):
        axes.scatter([], [], s=18, **_paint("#333333", False), label="hollow: does not count")
    if any(trial.catch for trial in trials):
        axes.scatter([], [], **_RING, label="catch trial")
    if not all(trial.void for trial in trials):
        axes.plot([], [], **_WAY, label="order of those that count")


# -------------------------------------------------------------------------------------------------------- agreement


@style.own_style()
def agreement_figure(found: StudyAnalysis) -> Any:
    """Draw the confusion matrices of the person's and the automatic verdicts, over all conditions."""
    tables = _keep_one_per_name([one for one in found.agreements if one.condition == "" and one.trials])
    figure = style.new_figure(1.0 + 3.3 * len(tables), 3.7)
    panels = figure.subplots(1, len(tables), squeeze=False)[0]
    for axes, table in zip(panels, tables, strict=True):
        _draw_confusions(axes, table)
    panels[0].set_ylabel("verdict of the person", fontsize=9)
    figure.suptitle("Agreement of the person's verdicts and the automatic ones", fontsize=11)
    return figure


def _keep_one_per_name(tables: Sequence[Agreement]) -> list[Agreement]:
    by_name: dict[str, Agreement] = {}
    for table in tables:
        by_name.setdefault(table.name, table)
    return list(by_name.values())


def _draw_confusions(axes: Any, table: Agreement) -> None:
    counts = np.array(table.counts, dtype=np.float64)
    rows = counts.sum(axis=1, keepdims=True)
    shares = np.divide(counts, rows, out=np.zeros_like(counts), where=rows > 0.0)
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.3)
    for row, column in np.ndindex(counts.shape):
        text = f"{counts[row, column]:.0f}" + (f"\n{100 * shares[row, column]:.0f} %" if rows[row, 0] else "")
        colour = "white" if shares[row, column] > 0.8 else "black"
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(len(table.classes)), table.classes, fontsize=8)
    axes.set_yticks(range(len(table.classes)), table.classes, fontsize=8)
    axes.set_xlabel("automatic verdict", fontsize=9)
    weights = "" if table.weights == "none" else f", {table.weights} weights"
    kappa_text = (
        "not defined"
        if table.kappa is None
        else f"{table.kappa:.2f}"
        + (", no interval" if table.low is None else f" ({_number(table.low)} … {_number(table.high)})")
    )
    axes.set_title(f"{table.name}, n = {table.trials}\nκ{weights} = {kappa_text}", fontsize=9)


# ------------------------------------------------------------------------------------------------- order and fatigue


@style.own_style()
def effects_figure(found: StudyAnalysis) -> Any:
    """Draw stiffness limits, minus the mean of participant and condition, against place in the block, block and trial.

    Lower panels: time to a verdict along the session, and share of trials of each block that were invalid, redone or
    cut off.
    """
    measure = found.options.measure
    runs = [run for run in found.runs_as_counted if run.state == "complete" and measure in run.limits]
    limits = np.array([run.limits[measure].value for run in runs])
    centred = less_means(limits, [(run.participant, run.condition, run.damping) for run in runs])
    figure = style.new_figure(10.5, 6.2)
    panels = figure.subplots(2, 3)
    (first, *_), (times, lost, over_session) = panels
    positions: dict[str, tuple[str, Callable[[RunRow], float]]] = {
        "order": ("place in the block", lambda run: run.order),
        "block": ("block", lambda run: run.block),
        "trial": ("mean trial of the run", lambda run: run.middle_trial),
    }
    for axes, (along, (label, position)) in zip(panels[0], positions.items(), strict=True):
        at = [position(run) for run in runs]
        for number, name in enumerate(_conditions(found)):
            chosen = [index for index, run in enumerate(runs) if run.condition == name]
            axes.plot(
                [at[index] for index in chosen],
                [centred[index] for index in chosen],
                MARKERS[number % len(MARKERS)],
                color=style_of(number),
                markersize=4,
                alpha=0.6,
                label=_plain(name),
            )
        _draw_slope(axes, found, "limit", along, measure, at)
        axes.axhline(0.0, color="#777777", linewidth=0.7)
        axes.set_xlabel(label, fontsize=9)
        style.at_least(axes, "y", _LEAST_SPAN * float(limits.max(initial=0.0)))
        _count_runs(axes, runs)
    first.set_ylabel(f"limit less the mean ({found.study.unit('stiffness')})", fontsize=9)
    if runs:
        first.legend(fontsize=7, loc="best")
    _draw_response_times(times, found)
    _draw_lost_trials(lost, found)
    _limits_over_session(over_session, found, runs, measure)
    figure.suptitle("Order and fatigue", fontsize=11)
    return figure


def _draw_slope(
    axes: Any, found: StudyAnalysis, of: str, along: str, measure: str, at: Sequence[float]
) -> None:
    for slope in found.slopes:
        if (slope.of, slope.along, slope.measure) != (of, along, measure):
            continue
        if slope.problem:
            axes.set_title("no slope", fontsize=8)
            return
        p = "" if math.isnan(slope.holm) else f", p (Holm) = {slope.holm:.2g}"
        axes.set_title(f"slope {slope.slope:+.3g} ({slope.low:+.3g} … {slope.high:+.3g}){p}", fontsize=8)
        ends = np.array([min(at), max(at)])
        middle = float(np.mean(at))
        axes.plot(ends, slope.slope * (ends - middle), color="#222222", linewidth=1.2)


def _draw_response_times(axes: Any, found: StudyAnalysis) -> None:
    for number, session in enumerate(found.study.sessions):
        timed = [
            (trial.trial, trial.response_time_s)
            for trial in found.trials
            if trial.participant == session.code and trial.response_time_s and not trial.practice
        ]
        groups = [timed[first : first + _TOGETHER] for first in range(0, len(timed), _TOGETHER)]
        axes.plot(
            [float(np.mean([at for at, _ in group])) for group in groups],
            [float(np.median([took for _, took in group])) for group in groups],
            ".-",
            color=style_of(number),
            markersize=4,
            linewidth=0.8,
            alpha=0.8,
        )
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("trial", fontsize=9)
    axes.set_ylabel("time to the verdict (s)", fontsize=9)
    axes.set_title(f"medians of {_TOGETHER}, a line for each participant", fontsize=8)
    if any(line.get_xdata().size for line in axes.lines):
        style.count_along(axes)
    else:
        style.say(axes, "no verdict was timed")
    axes.tick_params(labelsize=8)
    style.lighten(axes)


def _draw_lost_trials(axes: Any, found: StudyAnalysis) -> None:
    numbers = sorted({block.block for block in found.blocks})
    bottom = np.zeros(len(numbers))
    for name, colour in (("invalid", "#999999"), ("redone", style.TRUE), ("aborted", style.BAD)):
        shares = []
        for number in numbers:
            of = [block for block in found.blocks if block.block == number]
            total = sum(block.trials for block in of)
            shares.append(100.0 * sum(getattr(block, name) for block in of) / max(total, 1))
        axes.bar(numbers, shares, bottom=bottom, color=colour, width=0.6, label=name)
        bottom += np.array(shares)
    axes.set_xlabel("block", fontsize=9)
    axes.set_ylabel("trials (%)", fontsize=9)
    axes.set_ylim(0.0, max(1.3 * float(bottom.max(initial=0.0)), 1.0))
    if bottom.any():
        axes.legend(fontsize=7, loc="upper right", ncols=3)
        style.count_along(axes)
    else:
        style.say(axes, "no trial was invalid, redone or aborted")
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    style.lighten(axes)


def _limits_over_session(axes: Any, found: StudyAnalysis, runs: Sequence[RunRow], measure: Measure) -> None:
    for number, name in enumerate(_conditions(found)):
        of = [run for run in runs if run.condition == name]
        axes.plot(
            [run.middle_trial for run in of],
            [run.limits[measure].value for run in of],
            MARKERS[number % len(MARKERS)],
            color=style_of(number),
            markersize=4,
            alpha=0.6,
        )
    axes.set_xlabel("mean trial of the run", fontsize=9)
    axes.set_ylabel(f"limit ({found.study.unit('stiffness')})", fontsize=9)
    style.at_least(axes, "y", _LEAST_SPAN * max((run.limits[measure].value for run in runs), default=0.0))
    _count_runs(axes, runs)


def _count_runs(axes: Any, runs: Sequence[RunRow]) -> None:
    if runs:
        style.count_along(axes)
    else:
        style.say(axes, "no run is complete")
    axes.tick_params(labelsize=8)
    style.lighten(axes)


# ------------------------------------------------------------------------------------------------------------ shared


def style_of(number: int) -> str:
    """Return the colour of the condition with this index in the protocol."""
    return style.SERIES[number % len(style.SERIES)]


def _conditions(found: StudyAnalysis) -> list[str]:
    return [condition.name for condition in found.study.protocol.condition]


def _plain(text: str) -> str:
    # matplotlib reads text between $ as a formula, and hides labels that begin with _ from a legend.
    text = text.replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def _people(found: StudyAnalysis, count: int) -> str:
    kind = "simulated participant" if found.study.rehearsed else "participant"
    return f"{count} {kind}{'' if count == 1 else 's'}"


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.2f}"
