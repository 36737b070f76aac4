"""Draw a comparison of velocity estimators: errors over the rate, or with a single rate, estimates over time.

``rig/views/table.json`` registers it. It must not compute an error or a delay.
"""

from typing import Any

import numpy as np

from rig.core.errors import ConfigError
from rig.core.sample import unit_of
from rig.experiments.estimation.interface import Case, EstimatorComparison, Score, Variant, estimates
from rig.views.plots import style

# One colour and mark a variant, in order (Okabe and Ito, then marks tell the second round apart).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKS = "osv^Dx"
PANELS = 4  # more would be too small to read


@style.own_style()
def estimators_figure(comparison: EstimatorComparison) -> Any:
    """Return the matplotlib figure of a comparison of estimators; raise `ConfigError` if the comparison is empty.

    There is a row of panels for each signal and resolution, at most `PANELS` rows. Left: error after removal of the
    delay; right: the delay; both over the velocity rate. With a single rate the panels show estimates and errors over
    time instead.
    """
    panels: dict[tuple[str, float], list[Case]] = {}
    for case in comparison.cases:
        panels.setdefault((case.name, abs(case.resolution)), []).append(case)
    chosen = list(panels.values())[:PANELS]
    if not chosen or not comparison.variants:
        raise ConfigError(
            "the comparison is empty, so there is no picture to draw",
            remedy="give at least one signal or recording, and one estimator",
        )
    figure = style.new_figure(width=10.0, height=1.5 + 3.0 * len(chosen))
    rows = figure.subplots(len(chosen), 2, squeeze=False)
    for axes, cases in zip(rows, chosen, strict=True):
        if len(cases) > 1:
            _against_rate(axes, cases, comparison)
        else:
            _over_time(axes, cases[0], comparison.variants)
    handles, labels = rows[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def _against_rate(axes: Any, cases: list[Case], comparison: EstimatorComparison) -> None:
    left, right = axes
    shown = {(case.name, case.rate_hz, abs(case.resolution)) for case in cases}
    for number, variant in enumerate(comparison.variants):
        scores = sorted(
            (
                score
                for score in comparison.scores
                if _belongs(score, variant) and (score.case, score.rate_hz, score.resolution) in shown
            ),
            key=lambda score: score.rate_hz,
        )
        rate = [score.rate_hz for score in scores]
        left.loglog(rate, [score.rms_without_delay for score in scores], label=variant.label, **_look(number))
        right.semilogx(rate, [1e3 * score.delay_s for score in scores], **_look(number))
    style.tidy(left, f"rms error without delay ({unit_of('velocity', cases[0].motion)})")
    style.tidy(right, "delay (ms)")
    for each in axes:
        each.set_xlabel("velocity rate (Hz)")
        each.set_title(_title(cases[0]), fontsize=9)


def _over_time(axes: Any, case: Case, variants: tuple[Variant, ...]) -> None:
    left, right = axes
    unit = unit_of("velocity", case.motion)
    left.plot(case.judged_time_s, case.true_velocity, color=style.WALL, linewidth=3.0, label=case.reference)
    for number, variant in enumerate(variants):
        try:
            velocity = estimates(case, variant)[case.judged]
        except ConfigError:
            continue  # not realisable at this rate: the scores say why
        noise = float(np.std(velocity - case.true_velocity))
        look = {
            **_look(number),
            "marker": "",
            "linewidth": 0.8,
            "zorder": 3.0 + 1.0 / (1.0 + noise / case.speed_rms),
        }
        left.plot(case.judged_time_s, velocity, label=variant.label, **look)
        right.plot(case.judged_time_s, velocity - case.true_velocity, **look)
    largest = 1.3 * float(np.max(np.abs(case.true_velocity)))  # a noisy one may not flatten the others
    left.set_ylim(-largest, largest)
    style.tidy(left, f"velocity ({unit})")
    style.tidy(right, f"error ({unit})")
    for each in axes:
        each.set_xlabel("time (s)")
        each.set_title(f"{_title(case)}, {case.rate_hz:g} Hz", fontsize=9)


def _belongs(score: Score, variant: Variant) -> bool:
    return score.estimator == variant.estimator and dict(score.settings) == dict(variant.settings)


def _title(case: Case) -> str:
    return f"{case.name}, {abs(case.resolution):.4g} {unit_of('position', case.motion)} a count"


def _look(number: int) -> dict[str, Any]:
    round_ = number // len(COLOURS)
    return {
        "color": COLOURS[number % len(COLOURS)],
        "marker": MARKS[number % len(MARKS)],
        "linestyle": ("-", "--", ":")[round_ % 3],
        "linewidth": 1.1,
        "markersize": 4,
    }
