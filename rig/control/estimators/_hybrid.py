"""Weighted mean of adaptive windowing (FOAW), for straight motion, and Levant's differentiator, for other motion.

Chawda et al. (section V) suggest to combine FOAW and Levant without a definition; this definition is the project's.
FOAW's chord over n periods has noise of Δ/(n·T), which is large if the motion bends and the window is short. Levant's
error is of the order of 2·√(C·Δ), which is too large for straight motion. So

    v = w·v_FOAW + (1 − w)·v_Levant,   w = straight · precise,

    straight   0 up to `fast_window`, 1 from `slow_window`, linear in between;
    precise    (2·√(C·Δ))² / ((2·√(C·Δ))² + (Δ/(n·T))²): weight by the inverse squares of both errors.

Experiments name it ``foaw-levant``. Its update must not allocate.
"""

from collections.abc import Mapping
from typing import Any

from rig.control.estimators import _foaw as foaw
from rig.control.estimators import _foaw_end as foaw_end
from rig.control.estimators import _levant as levant
from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import PERIOD, RESOLUTION, WINDOW, Estimator, Floats, Ints, Setting
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

# The memory and the parameters of FOAW end-fit come first and as they are; what follows is Levant's and the weight.
ERROR, U1 = foaw_end.ESTIMATOR.floats, foaw_end.ESTIMATOR.floats + 1  # state_f
ALPHA, LAMBDA, SCHEME, OUTPUT = range(foaw.OWN_PARAMETERS, foaw.OWN_PARAMETERS + levant.OWN_PARAMETERS)
FAST, SLOW, BOUND = OUTPUT + 1, OUTPUT + 2, OUTPUT + 3


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
    """Return the velocity (rad/s or m/s): weighted mean of adaptive windowing (FOAW) and Levant's differentiator.

    It is zero for the first sample. `state_i[WINDOW]` becomes the length of FOAW's window (periods): the longer it is,
    the more FOAW counts.
    """
    started = state_i[foaw.SAMPLES] > 0
    moved = count_difference(count, state_i[foaw.PREVIOUS])
    straight = foaw_end.update(count, edge_age_s, elapsed_ticks, effort, state_f, state_i, parameters)
    if not started:
        return 0.0
    # Both always run, so that neither starts in the middle of an impact.
    error, u1, u = levant.advance(
        state_f[ERROR],
        state_f[U1],
        moved,
        elapsed_ticks,
        parameters[ALPHA],
        parameters[LAMBDA],
        int(parameters[SCHEME]),
    )
    state_f[ERROR], state_f[U1] = error, u1
    if parameters[OUTPUT] != 0.0:
        u = u1
    bent = u * parameters[RESOLUTION] / parameters[PERIOD]
    window = float(state_i[WINDOW])
    bounds = parameters[BOUND] * window * window
    weight = (window - parameters[FAST]) / (parameters[SLOW] - parameters[FAST])
    # A weight and not a switch: each jump of the velocity is a knock that the wall's damping gives to the hand.
    weight = min(max(weight, 0.0), 1.0) * bounds / (bounds + 1.0)
    return float(weight * straight + (1.0 - weight) * bent)


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return all parameters: of adaptive windowing (FOAW), of Levant's differentiator, and of their weighted mean.

    Raises `ConfigError` unless fast_window < slow_window ≤ window_limit.
    """
    fast, slow, limit = settings["fast_window"], settings["slow_window"], settings["window_limit"]
    if not fast < slow <= limit:
        raise ConfigError(
            f"estimator foaw-levant: fast_window = {fast:g}, slow_window = {slow:g} and window_limit = {limit:g} "
            "are not in order",
            remedy="choose fast_window < slow_window ≤ window_limit",
        )
    mu1, mu2 = levant.multipliers(settings, "foaw-levant")
    own = levant.own_parameters(settings, mu1, mu2, resolution, period_s)
    bound = 4.0 * settings["lipschitz"] * period_s**2 / abs(resolution)  # (2·√(C·Δ) / (Δ/T))²
    return [*foaw.design(settings, resolution, period_s), *own, fast, slow, bound]


ESTIMATOR = Estimator(
    name="foaw-levant",
    summary="hybrid: adaptive window where the motion is straight, Levant where it bends",
    source="named by Chawda et al., section V, without a definition; this one is the project's",
    update=update,
    floats=foaw_end.ESTIMATOR.floats + levant.FLOATS,
    ints=foaw.INTS,
    settings=(
        *foaw.SETTINGS,
        *levant.SETTINGS,
        # Both windows were chosen on thirteen signals (a wall bounce at 1 to 50 kHz with 1 and 20 µm, hits of both
        # rigs; 2026-11-20): the RMS error was 0.73 to 1.17 times that of the better of FOAW and Levant. Their mean is
        # more accurate at 1 to 2 kHz; at other rates it only replaces the choice between FOAW and Levant.
        Setting("fast_window", 2.0, 1.0, foaw.LONGEST, "velocity periods", "up to this window Levant alone"),
        Setting("slow_window", 8.0, 1.0, foaw.LONGEST, "velocity periods", "from this window FOAW alone"),
    ),
    design=design,
)
