"""Robust exact differentiator with the smallest worst-case error: a chord whose length depends on the observed noise.

For noise up to N and an acceleration up to C, the error of a chord over the time τ is at most 2·N/τ + C·τ/2, which is
smallest for τ = 2·√(N/C). N is estimated from the samples. While the acceleration is at most C, the motion deviates
from the chord between samples k and k − l by at most C·T²·j·(l − j)/2 at sample k − j. A larger deviation must be
noise; the noise of the three samples can add up to 2·N:

    N̂ = max over 0 < j < l ≤ n of ½·(|f_{k−j} − f_k + (f_k − f_{k−l})·j/l| − C·T²·j·(l − j)/2), and 0 at least.

Like Levant's differentiator it needs only C. It has no memory beyond its window, so that it neither overshoots after an
impact nor chatters at rest. n is the length of the chord for half a count of noise. Experiments name it ``optimal``.
Its update must not allocate.

Source: Seeber and Haimovich, "Optimal robust exact differentiation via linear adaptive techniques", Automatica 148
(2023); the error bound for uniform samples is 2·√(2·N·C) + C·T/2 (Aldana-López et al., arXiv 2404.05863). Only
abstracts and a public implementation could be read; the formulas above were derived again.
"""

import math
from collections.abc import Mapping
from typing import Any

from rig.control.estimators import _foaw as foaw
from rig.control.estimators._foaw import COUNTS, MASK, PERIODS, SAMPLES
from rig.control.estimators._levant import DEFAULT_LIPSCHITZ
from rig.control.estimators.estimator import (
    COMMON,
    PERIOD,
    RESOLUTION,
    WINDOW,
    Estimator,
    Floats,
    Ints,
    Setting,
)
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

BEND, LIMIT = COMMON, COMMON + 1  # parameters: C in counts per period², longest chord in periods
RISE, SPAN = 0, foaw.LONGEST + 1  # state_f: the window laid out flat


@kernel("f8(f8[::1], i8, f8)", inline=True)
def _noise(state_f: Floats, samples: int, bend: float) -> float:
    """Return the estimated noise (counts) of the newest samples; `bend` bounds the acceleration (counts/period²)."""
    noise = 0.0
    # n²/2 comparisons in each period, n the longest chord.
    for l in range(2, samples + 1):  # noqa: E741  (as in the formula)
        span = state_f[SPAN + l]
        chord = state_f[RISE + l] / span
        worst = 0.0
        for j in range(1, l):
            s = state_f[SPAN + j]
            away = abs(state_f[RISE + j] - chord * s) - 0.5 * bend * s * (span - s)
            worst = away if away > worst else worst
        noise = max(noise, worst)
    return 0.5 * noise


@kernel(ESTIMATOR_SIGNATURE, no_refcount=True)
def update(
    count: int,
    edge_age_s: float,
    elapsed_ticks: int,
    effort: float,
    state_f: Floats,
    state_i: Ints,
    parameters: Floats,
) -> float:
    """Return the velocity (rad/s or m/s): slope of the chord with the least possible error, 0 for the first sample."""
    newest = foaw.remember(count, elapsed_ticks, state_i)
    position, period = state_i[COUNTS + newest], state_i[PERIODS + newest]
    bend, limit = parameters[BEND], int(parameters[LIMIT])
    samples = 0
    for n in range(1, min(state_i[SAMPLES] - 1, limit) + 1):
        oldest = (newest - n) & MASK
        span = period - state_i[PERIODS + oldest]
        if span > limit and n > 1:
            break
        state_f[RISE + n], state_f[SPAN + n] = float(position - state_i[COUNTS + oldest]), float(span)
        samples = n
    state_i[WINDOW] = 0
    if samples == 0:
        return 0.0
    best = math.ceil(2.0 * math.sqrt(_noise(state_f, samples, bend) / bend))
    chosen = 1
    while chosen < samples and state_f[SPAN + chosen] < best:
        chosen += 1
    state_i[WINDOW] = int(state_f[SPAN + chosen])
    slope = state_f[RISE + chosen] / state_f[SPAN + chosen]
    return float(slope * parameters[RESOLUTION] / parameters[PERIOD])


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the bound of the acceleration (counts per period²) and the longest chord (periods, at least 2)."""
    limit = settings["window_limit"]
    if limit != round(limit):
        raise ConfigError(
            f"estimator optimal: window_limit = {limit:g} is not a whole number of velocity periods",
            remedy=f"choose {int(limit)} or {int(limit) + 1}",
        )
    bend = settings["lipschitz"] * period_s**2 / abs(resolution)
    # For half a count, which is all an ideal encoder has: a C that is too small costs delay, but no more than this.
    needed = math.ceil(2.0 * math.sqrt(settings["noise"] / bend))
    # At least 2: a chord of one period would show no noise.
    return [bend, min(limit, max(2.0, needed))]


ESTIMATOR = Estimator(
    name="optimal",
    summary="chord of adaptive length, chosen by the observed noise: smallest worst-case error",
    source="Seeber and Haimovich, Automatica 148 (2023); Aldana-López et al., arXiv 2404.05863",
    update=update,
    floats=2 * (foaw.LONGEST + 1),
    ints=foaw.INTS,
    settings=(
        Setting(
            "lipschitz",
            DEFAULT_LIPSCHITZ,
            1e-6,
            1e9,
            "position unit/s²",
            "C, largest acceleration to follow; identify it from a hit of your rig",
        ),
        Setting(
            "noise", 0.5, 0.01, 1e6, "counts", "largest error of a sample; an ideal encoder has half a count"
        ),
        Setting(
            "window_limit", 32.0, 2.0, foaw.LONGEST, "velocity periods", "upper bound of the chord's length"
        ),
    ),
    design=design,
)
