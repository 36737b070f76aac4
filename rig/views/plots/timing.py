"""Draw the duration of each stage of a tick: distribution, worst ticks, and course over the run.

``rig/views/table.json`` registers it. It must not change a duration; long curves show the largest value of each
stretch.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.recording.timing_report import LATENESS, STAGES, Ledger, Timing, TimingSummary
from rig.views.plots import style

COLOURS = {
    "transport_in": style.MEASURED,
    "law": style.OTHER,
    "send": style.TRUE,
    "transport_out": style.SENT,
    "answered": "#7a5195",
    "whole": "#444444",
    LATENESS: style.BAD,
}
# Stages that together make up the whole time of a tick, in this order.
IN_A_ROW = ("transport_in", "law", "send", "transport_out")
POINTS = 2000  # of a curve, at most
US = 1e-3  # µs in a ns


def label(name: str) -> str:
    """Return the text for a stage of a tick in a legend; `name` is a stage of `STAGES` or `LATENESS`."""
    return STAGES[name].label if name in STAGES else "late on the grid"


@style.own_style()
def timing_figure(timing: Timing) -> Any:
    """Return the matplotlib figure of a run's timing: distribution, worst ticks, and course over the run."""
    ledger, summary = timing.ledger, timing.summary
    figure = style.new_figure(width=11.0, height=7.5)
    panels = figure.subplot_mosaic([["often", "worst"], ["when", "when"]], height_ratios=(3, 2))
    _draw_survival(panels["often"], ledger)
    _draw_worst(panels["worst"], summary)
    _draw_run(panels["when"], ledger, summary)
    figure.suptitle(timing.name or f"{summary.ticks} ticks of {summary.period_ns * US:.4g} µs", fontsize=11)
    return figure


def _draw_survival(axes: Any, ledger: Ledger) -> None:
    drawn = False
    for name, colour in COLOURS.items():
        values, known = ledger.stage(name)
        found = np.sort(values[known])
        longer = np.arange(len(found) - 1, -1, -1) + 1
        first = int(np.searchsorted(found, 1))
        if first == len(found):
            continue
        # Many points where ticks are rare, few where they crowd.
        chosen = np.unique(len(found) - np.geomspace(1, len(found) - first, POINTS).astype(np.int64))
        axes.plot(
            found[chosen] * US, longer[chosen] / len(found), color=colour, linewidth=1.2, label=label(name)
        )
        drawn = True
    if drawn:
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.axvline(
            ledger.period_ns * US, color=style.WALL, linewidth=0.8, linestyle="--", label="one period"
        )
        axes.legend(frameon=False, fontsize=8)
    else:
        style.say(axes, "no stage took any time: virtual time" if len(ledger.tick) else "no ticks")
    axes.set_xlabel("time (µs)")
    style.tidy(axes, "share of ticks that took longer")


def _draw_worst(axes: Any, summary: TimingSummary) -> None:
    for place, bad in enumerate(summary.worst):
        begin = 0.0
        for name in IN_A_ROW:
            length = bad.stages[name]
            if length is not None:
                axes.barh(place, length * US, left=begin, color=COLOURS[name], height=0.7)
                begin += length * US
        late = bad.stages[LATENESS]
        if late is not None:
            axes.plot(late * US, place, "|", color=COLOURS[LATENESS], markersize=10)
    if summary.worst:
        axes.set_yticks(range(len(summary.worst)), [f"{bad.tick}" for bad in summary.worst], fontsize=8)
        axes.invert_yaxis()
    else:
        style.say(axes, "no tick took any time")
    axes.set_xlabel("time from the sample (µs); the mark is the lateness")
    axes.set_axisbelow(True)
    style.tidy(axes, "worst ticks")


def _draw_run(axes: Any, ledger: Ledger, summary: TimingSummary) -> None:
    values, known = ledger.stage("answered")
    name = "answered"
    if not known.any():
        (values, known), name = ledger.stage(LATENESS), LATENESS
    chosen = np.flatnonzero(known)
    if len(chosen):
        time_s = (ledger.received[chosen] - ledger.received[0]) * 1e-9
        time_s, longest = _longest(time_s, values[chosen])
        axes.plot(time_s, longest * US, color=COLOURS[name], linewidth=0.8, label=f"{label(name)}, longest")
        worst = [(bad.time_s, bad.stages[name]) for bad in summary.worst]
        axes.plot(
            [at for at, _ in worst],
            [(length or 0) * US for _, length in worst],
            "o",
            color=style.BAD,
            fillstyle="none",
            label="worst ticks",
        )
        axes.axhline(
            ledger.period_ns * US, color=style.WALL, linewidth=0.8, linestyle="--", label="one period"
        )
        axes.legend(frameon=False, fontsize=8, ncols=3, loc="upper right")
        axes.set_ylim(bottom=min(0.0, longest.min() * US))
    axes.set_xlabel("time from the first sample (s)")
    style.tidy(axes, "time (µs)")


def _longest(
    time_s: NDArray[np.float64], values: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return start time (s) and largest value of each stretch of a curve; at most `POINTS` stretches."""
    each = -(-len(values) // POINTS)
    starts = np.arange(0, len(values), each)
    return time_s[starts], np.maximum.reduceat(values, starts)
