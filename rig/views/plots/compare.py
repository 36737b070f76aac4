"""Draw a comparison of sampling schemes: penetration and velocity after the first impact.

``rig/views/table.json`` registers the figure; papers draw single panels. This file must not compute a comparison.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rig.core.sample import unit_of
from rig.experiments.hits.compare import SchemeComparison, SchemeImpacts
from rig.views.plots import style

COLOURS = (style.TRUE, style.SENT, style.MEASURED, style.OTHER, "#cc79a7", "#56b4e9", "#000000")
# End of the velocity axis over the largest true speed: a noisy estimate must not flatten the other curves.
STRONGEST = 1.15
SHORTEST_S, LONGEST_S = 0.03, 0.3


@style.own_style()
def scheme_figure(comparison: SchemeComparison, *, offset: int = 0) -> Any:
    """Return the matplotlib figure of penetration and velocity after the first contact, for each sampling scheme.

    `offset` is the index of the encoder offset (start position between two counts) that is drawn.
    """
    experiment, motion = comparison.experiment, comparison.experiment.rig.motion
    until_s = _shown_s(comparison.outcomes)
    figure = style.new_figure(width=9.0, height=3.5 + 1.8 * len(comparison.outcomes))
    heights = (2.5, *(1.0 for _ in comparison.outcomes))
    top, *below = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    draw_penetration(top, comparison.outcomes, offset)
    top.legend(loc="lower right", framealpha=0.85, edgecolor="none", fontsize=8)
    largest = max(float(np.abs(o.impacts[offset].velocity_true).max()) for o in comparison.outcomes)
    for number, (axes, outcome) in enumerate(zip(below, comparison.outcomes, strict=True)):
        impact = outcome.impacts[offset]
        axes.plot(impact.time_s, impact.velocity_true, color=style.WALL, linewidth=2.5, label="true")
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(impact.time_s, impact.velocity, color=colour, linewidth=0.9, label="as the law saw it")
        axes.set_ylim(-STRONGEST * largest, STRONGEST * largest)
        axes.set_title(outcome.label, fontsize=9, loc="left")
        style.tidy(axes, f"velocity ({unit_of('velocity', motion)})")
    below[0].legend(loc="upper right", framealpha=0.85, edgecolor="none", fontsize=8, ncols=2)
    below[-1].set_xlabel("time from first contact (s)")
    below[-1].set_xlim(0.0, until_s)
    stiffness, damping = (
        f"{getattr(experiment.wall, q):g} {unit_of(q, motion)}" for q in ("stiffness", "damping")
    )
    figure.suptitle(f"{experiment.rig.name}: the same hit, K = {stiffness}, B = {damping}", fontsize=11)
    return figure


def draw_penetration(axes: Any, outcomes: Sequence[SchemeImpacts], offset: int) -> None:
    """Draw the penetration (counts) over time for each sampling scheme.

    `offset` is the index of the encoder offset (start position between two counts) that is drawn.
    """
    for i, outcome in enumerate(outcomes):
        impact, wide = outcome.impacts[offset], 3.0 - 2.0 * min(1.0, i / max(1, len(outcomes) - 1))
        # Equal curves remain visible under each other: widths differ.
        look = {"color": COLOURS[i % len(COLOURS)], "linewidth": wide}
        axes.plot(impact.time_s, impact.counts, **look, label=outcome.label)
    axes.axhline(0.0, color=style.WALL, linewidth=0.8)
    style.tidy(axes, "penetration (counts)")


def _shown_s(outcomes: Sequence[SchemeImpacts]) -> float:
    settling = [impact.numbers.settling_s for outcome in outcomes for impact in outcome.impacts]
    slowest = max((LONGEST_S if s is None else s for s in settling), default=LONGEST_S)
    longest = max(float(impact.time_s[-1]) for outcome in outcomes for impact in outcome.impacts)
    return max(min(1.3 * slowest, LONGEST_S, longest), min(SHORTEST_S, longest), 1e-9)
