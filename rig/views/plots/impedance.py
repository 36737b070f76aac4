"""Draw magnitude, phase and real part of measured impedances and of the ideal wall, like Chawda et al., Figs. 4 and 6.

`rig impedance` and papers draw several results; ``rig/views/table.json`` draws one. This file must not measure or fit.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.analysis.impedance import Impedance, ideal_wall
from rig.core.errors import RecordingError
from rig.core.sample import unit_of
from rig.experiments.mapping.impedance import ImpedanceResult, refuse_other_excitation
from rig.views.plots import style

# Half width of the shaded bands in standard deviations.
Z_SCORE = 2.0
# Range of the real part's axis over the range of the measured values.
HEADROOM = 1.3


def draw_impedance(results: Sequence[ImpedanceResult], picture: str | Path) -> Path:
    """Draw impedances into a file and return its path; raise `RecordingError` if no result has an impedance."""
    return style.save(impedance_figure(results), Path(picture))


@style.own_style()
def impedance_figure(results: Sequence[ImpedanceResult]) -> Any:
    """Return the matplotlib figure of measured impedances, with one colour for each result.

    Solid lines with a band of two standard deviations are measured. Thin dark lines are the closed form of rig and wall
    without friction and quantisation. Dashed lines are the ideal wall K/(jω) + B.

    Raise `RecordingError` if no result has a measured impedance, `ConfigError` if their excitations differ.
    """
    shown = [result for result in results if result.impedance is not None]
    if not shown:
        raise RecordingError(
            "no impedance to draw: the safety guard ended every run",
            remedy="choose a softer wall or a smaller excitation",
        )
    refuse_other_excitation([result.experiment for result in shown])
    figure = style.new_figure(9.0, 10.0)
    size, phase, real = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1.4, 1.4))
    for i, result in enumerate(shown):
        assert result.impedance is not None
        _draw(size, phase, real, result, result.impedance, style.SERIES[i % len(style.SERIES)])
    _limits(phase, real, shown)
    damping = unit_of("damping", shown[0].experiment.rig.motion)
    size.set_xscale("log")
    size.set_yscale("log")
    style.tidy(size, f"|Z| ({damping})")
    style.tidy(phase, "phase of Z (degrees)")
    style.tidy(real, f"Re Z ({damping})")
    real.set_xlabel("frequency (Hz)")
    size.legend(loc="best", fontsize=8, framealpha=0.85, edgecolor="none")
    first = shown[0]
    excitation, count = first.experiment.excitation, first.impedance.realisations if first.impedance else 0
    who = "own motor" if excitation.channel == "motor" else "second actuator"
    figure.suptitle(
        f"{first.experiment.rig.name}, excited by its {who}"
        if excitation.channel == "motor"
        else f"{first.experiment.rig.name}, excited by a {who}",
        fontsize=11,
    )
    size.set_title(
        f"{first.method}, {count} × {excitation.periods} periods of {excitation.period_s:g} s; bands: {Z_SCORE:g} "
        "standard deviations; thin: closed form; dashed: K/(jω) + B",
        fontsize=8,
        loc="left",
    )
    return figure


def _draw(
    size: Any, phase: Any, real: Any, result: ImpedanceResult, measured: Impedance, colour: str
) -> None:
    lines_hz, spread = measured.lines_hz, np.nan_to_num(measured.spread(Z_SCORE))
    magnitude, angle = measured.magnitude, measured.phase_deg
    phase_spread = np.degrees(np.arcsin(np.clip(spread / np.maximum(magnitude, 1e-300), 0.0, 1.0)))
    for axes, value, band in (
        (size, magnitude, spread),
        (phase, angle, phase_spread),
        (real, measured.z.real, spread),
    ):
        low = np.maximum(value - band, 0.1 * value) if axes is size else value - band
        axes.fill_between(lines_hz, low, value + band, color=colour, alpha=0.2, linewidth=0)
        axes.plot(lines_hz, value, color=colour, linewidth=1.2, label=result.label if axes is size else None)
    closed = result.expected(lines_hz)
    if closed is not None:
        _draw_line(size, phase, real, lines_hz, closed, color="#222222", linewidth=0.6)
    if not result.bare:
        ideal = ideal_wall(*result.wall, lines_hz)
        _draw_line(size, phase, real, lines_hz, ideal, color=colour, linewidth=1.0, linestyle="--")


def _draw_line(size: Any, phase: Any, real: Any, f: Any, z: Any, **look: Any) -> None:
    for axes, value in ((size, np.abs(z)), (phase, np.degrees(np.angle(z))), (real, z.real)):
        axes.plot(f, value, **look)


def _limits(phase: Any, real: Any, shown: Sequence[ImpedanceResult]) -> None:
    """Draw lines at the limits of passivity (phase ±90°, real part 0), and choose axes that cut off outliers."""
    for level in (-90.0, 90.0):
        phase.axhline(level, color=style.BAD, linewidth=0.8)
    real.axhline(0.0, color=style.BAD, linewidth=0.8)
    phase.set_ylim(-135.0, 135.0)
    phase.set_yticks((-90, -45, 0, 45, 90))
    values = np.concatenate([r.impedance.z.real for r in shown if r.impedance is not None])
    low, high = np.percentile(values, (1.0, 99.0))
    middle, half = 0.5 * (low + high), 0.5 * max(high - low, 1e-12)
    real.set_ylim(min(middle - HEADROOM * half, -0.1 * half), max(middle + HEADROOM * half, 0.1 * half))
