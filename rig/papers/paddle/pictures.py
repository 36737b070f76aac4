"""Pictures of the paddle's reproduction: one function for each, by the name that the report calls it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rig.papers.paddle import data, rigs, rules
from rig.papers.paddle.results import Paddle
from rig.views.plots import style

COLOUR = dict(zip(data.ESTIMATORS, style.SERIES, strict=False))


@style.own_style()
def _curves(paddle: Paddle, path: Path) -> None:
    figure = style.new_figure(11.0, 4.4)
    panels = figure.subplots(1, 2, sharex=True)
    for name in data.ESTIMATORS:
        curve = data.CURVES[name]
        panels[0].plot(data.dampings(len(curve)), np.array(curve) / 1e3, "o-", color=COLOUR[name], label=name)
        found = np.array([curves[name] for curves in paddle.plausible_curves]) / 1e3
        if len(found):
            low, middle, high = np.quantile(found, (0.1, 0.5, 0.9), axis=0)
            panels[1].plot(paddle.scale.dampings, middle, color=COLOUR[name], label=name)
            panels[1].fill_between(paddle.scale.dampings, low, high, color=COLOUR[name], alpha=0.12)
    for axes, title in zip(
        panels, ("measured", "simulated: median, 10 to 90 % of the plausible rigs"), strict=True
    ):
        _label(axes, title)
    panels[0].legend(fontsize=8)
    style.save(figure, path)


@style.own_style()
def _fits(paddle: Paddle, path: Path) -> None:
    figure = style.new_figure(12.0, 3.8)
    panels = figure.subplots(1, len(paddle.fits), sharey=True)
    numbers = [rig.number for rig in paddle.drawn]
    for axes, fit in zip(panels, paddle.fits, strict=True):
        curves = paddle.curves[numbers.index(fit.rig)]
        for name in data.ESTIMATORS:
            wide = 2.4 if name == fit.left_out else 1.0
            curve = data.CURVES[name]
            axes.plot(data.dampings(len(curve)), np.array(curve) / 1e3, "o", color=COLOUR[name], markersize=3)
            axes.plot(
                paddle.scale.dampings,
                np.array(curves[name]) / 1e3,
                color=COLOUR[name],
                linewidth=wide,
                label=name,
            )
        _label(axes, f"predicted: {fit.left_out} (rig {fit.rig})")
    panels[0].legend(fontsize=8)
    style.save(figure, path)


@style.own_style()
def _decides(paddle: Paddle, path: Path) -> None:
    figure = style.new_figure(11.0, 4.0)
    names = [name for name, _ in paddle.decides[:3]]
    panels = figure.subplots(1, max(1, len(names)), sharey=True, squeeze=False)[0]
    leads = [rules.lead(curves) for curves in paddle.plausible_curves]
    for axes, name in zip(panels, names, strict=False):
        drawn = [paddle.drawn[place] for place in paddle.plausible]
        values = [float(rig.delay) if name == "delay" else rig.values[name] for rig in drawn]
        axes.plot(values, leads, "o", color=style.MEASURED, markersize=4)
        axes.axhline(1.0, color=style.WALL, linewidth=0.9)
        axes.set_yscale("log")
        prior = rigs.PRIORS.get(name)
        if prior is not None:
            axes.set_xscale("log")
        axes.set_xlabel(f"{prior.meaning} ({prior.unit})" if prior else "computation delay (ticks)")
        style.lighten(axes)
    panels[0].set_ylabel("Levant's stiffest wall over the best other")
    style.save(figure, path)


def _label(axes: Any, title: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("damping B (N·s/m)")
    axes.set_ylabel("stiffness K (N/mm)")
    style.lighten(axes)


PICTURES: Mapping[str, Callable[[Paddle, Path], None]] = {
    "curves": _curves,
    "fits": _fits,
    "decides": _decides,
}
