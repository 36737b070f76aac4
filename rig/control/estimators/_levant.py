"""Levant's differentiator: exact for any motion whose acceleration stays below a bound C, with no filter delay.

A copy x of the position follows the measurement f with the velocity u; u is the estimate once x stays on f (sliding):

    e = x − f,   x' = u,   u = u1 − λ·|e|^½·sign(e),   u1' = −α·sign(e),      α = μ1·C, λ = μ2·√C.

If C is too small, the estimate does not follow a hard impact; if C is too large, it passes the encoder's noise: the
error grows with √(C·Δ). `rig.experiments.estimation.lipschitz` measures C from a recorded hit.

The code computes in counts and periods: α becomes α·T²/Δ, λ becomes λ·T/√Δ, and T = 1 below. Experiments name it
``levant``. Its update must not allocate.

Source: Levant 1998; Chawda et al., equations (9) to (14); the implicit form is the I-STD of the differentiator
toolbox of Mojallizadeh et al.
"""

import math
from collections.abc import Mapping
from typing import Any

from rig.control.estimators import levant_regions
from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import (
    COMMON,
    OWN_INTS,
    PERIOD,
    RESOLUTION,
    WINDOW,
    Choice,
    Estimator,
    Floats,
    Ints,
    Setting,
)
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

ALPHA, LAMBDA, SCHEME, OUTPUT = range(COMMON, COMMON + 4)  # parameters: in counts and periods, then indices
OWN_PARAMETERS = 4
ERROR, U1 = 0, 1  # state_f: x − last count, and the integrator (counts per period)
FLOATS = 2
PREVIOUS, STARTED = OWN_INTS, OWN_INTS + 1  # state_i
INTS = OWN_INTS + 2
SCHEMES = ("explicit", "semi-implicit", "implicit")
EXPLICIT, SEMI_IMPLICIT = 0, 1
OUTPUTS = ("u", "u1")
# Near the best for hits of both papers' rigs: 81 m/s² at 0.4 m/s into 20 kN/m, and in rad/s² what follows the link of
# koul-compliant but not its 586 Hz mode (measured on their recordings, 2026-11-20). Too large a C harms the implicit
# scheme little; the chatter of the explicit ones grows with it.
DEFAULT_LIPSCHITZ = 100.0
LONGEST_GAP = 1000  # periods; after a longer one it restarts on the mean slope


@kernel("UniTuple(f8, 3)(f8, f8, f8, f8, i8)", inline=True)
def step(error: float, u1: float, alpha: float, lambda_: float, scheme: int) -> tuple[float, float, float]:
    """Advance Levant's differentiator by one period; return the error x − f, the integral part u1, and the velocity u.

    x is the differentiator's copy of the position f (counts). `error` is the old x minus the new sample f; `alpha` and
    `lambda_` are the gains in counts and periods, `scheme` the discretisation (an index of `SCHEMES`).
    """
    # The sign is set-valued at zero. The explicit schemes cannot rest there: they chatter for ever, at a handle at rest
    # too, by 1.17·α·T rms (explicit, gains hba-sc), which damping turns into a buzz of the motor.
    if scheme <= SEMI_IMPLICIT:
        push = 0.0
        if error != 0.0:
            push = math.copysign(1.0, error)
        if scheme == SEMI_IMPLICIT:
            u1 -= alpha * push
        u = u1 - lambda_ * math.sqrt(abs(error)) * push
        if scheme == EXPLICIT:
            u1 -= alpha * push
        return error + u, u1, u
    # The implicit one solves for the sign at the end of the step. Inside the band |b| ≤ α every error can be removed at
    # once, and x lies on the sample.
    b = -error - u1
    beyond = abs(b) - alpha
    # If α, the largest change of velocity in one period, is above a count or two, this always holds: the result is the
    # finite difference.
    if beyond <= 0.0:
        return 0.0, -error, -error
    push = math.copysign(1.0, b)
    # The positive root of r² + λ·r = beyond, in the form that does not cancel.
    root = 2.0 * beyond / (lambda_ + math.sqrt(lambda_ * lambda_ + 4.0 * beyond))
    u1 += alpha * push
    u = u1 + lambda_ * root * push
    return error + u, u1, u


@kernel("UniTuple(f8, 3)(f8, f8, i8, i8, f8, f8, i8)", inline=True)
def advance(
    error: float, u1: float, moved: int, elapsed_ticks: int, alpha: float, lambda_: float, scheme: int
) -> tuple[float, float, float]:
    """Advance Levant's differentiator by `elapsed_ticks` periods; return x − f (counts), integral part u1, velocity u.

    x is its copy of the position f. The count has changed by `moved`; lost samples are assumed on a straight line.
    """
    slope = moved / elapsed_ticks
    if elapsed_ticks > LONGEST_GAP:
        return 0.0, slope, slope
    u = u1
    for _ in range(elapsed_ticks):
        error, u1, u = step(error - slope, u1, alpha, lambda_, scheme)
    return error, u1, u


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
    """Return the velocity (rad/s or m/s) at a new encoder count, by Levant's differentiator; 0 for the first sample."""
    if state_i[STARTED] == 0:
        state_i[STARTED] = 1
        state_i[PREVIOUS] = count
        return 0.0
    moved = count_difference(count, state_i[PREVIOUS])
    state_i[PREVIOUS] = count
    state_i[WINDOW] = elapsed_ticks
    error, u1, u = advance(
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
    return float(u * parameters[RESOLUTION] / parameters[PERIOD])


def multipliers(settings: Mapping[str, Any], estimator: str = "levant") -> tuple[float, float]:
    """Return Levant's gains (μ1, μ2); raise `ConfigError` if they fail the proof that the setting "gains" names."""
    gains, mu1, mu2 = settings["gains"], settings["mu1"], settings["mu2"]
    if gains in levant_regions.NAMED_GAINS:
        if mu1 or mu2:
            raise ConfigError(
                f"estimator {estimator}: gains = {gains!r} fixes mu1 and mu2, but mu1 = {mu1:g} and mu2 = {mu2:g} "
                "are given",
                remedy="leave out mu1 and mu2, or choose gains = 'custom', 'hba' or 'lfba'",
            )
        return levant_regions.NAMED_GAINS[gains]
    if not (mu1 and mu2):
        raise ConfigError(
            f"estimator {estimator}: gains = {gains!r} needs mu1 and mu2",
            remedy="give mu1 and mu2; `rig theory levant-regions` shows which pairs converge",
        )
    outside_region = f"estimator {estimator}: mu1 = {mu1:g}, mu2 = {mu2:g} lie outside the region {gains!r}"
    or_custom_gains = "or gains = 'custom', for which convergence is not checked"
    if gains == "hba" and not levant_regions.in_hba(mu1, mu2):
        least_mu1 = f"mu1 ≥ {levant_regions.hba_mu1(mu2):.5g}, or " if mu2 > 2.0 else ""
        raise ConfigError(
            f"{outside_region}, which requires mu2 > 2 and mu1 ≥ (mu2² + 4)/(mu2² − 4)",
            remedy=f"choose {least_mu1}a larger mu2 (above 2), which lowers the least mu1 towards 1; {or_custom_gains}",
        )
    if gains == "lfba" and not levant_regions.in_lfba(mu1, mu2):
        raise ConfigError(
            f"{outside_region}, which requires mu1 > 3 + 2/mu2²",
            remedy=f"choose mu1 > {levant_regions.lfba_mu1(mu2):.5g}, or a larger mu2, which lowers this limit of mu1 "
            f"towards 3; {or_custom_gains}",
        )
    return float(mu1), float(mu2)


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return Levant's gains α and λ (counts, periods), then the indices of the discretisation and of the output."""
    mu1, mu2 = multipliers(settings)
    return own_parameters(settings, mu1, mu2, resolution, period_s)


def own_parameters(
    settings: Mapping[str, Any], mu1: float, mu2: float, resolution: float, period_s: float
) -> list[float]:
    """Return Levant's gains α and λ (counts, periods) for checked μ1, μ2; then the indices of scheme and output."""
    bound = settings["lipschitz"] * period_s**2 / abs(resolution)  # counts per period²
    scheme, output = settings["discretisation"], settings["output"]
    return [mu1 * bound, mu2 * math.sqrt(bound), float(SCHEMES.index(scheme)), float(OUTPUTS.index(output))]


SETTINGS: tuple[Setting | Choice, ...] = (
    Setting(
        "lipschitz",
        DEFAULT_LIPSCHITZ,
        1e-6,
        1e9,
        "position unit/s²",
        "C, largest acceleration to follow; identify it from a hit of your rig",
    ),
    Choice(
        "gains", "levant", (*levant_regions.NAMED_GAINS, "hba", "lfba", "custom"), "μ1 and μ2: named or given"
    ),
    Setting("mu1", 0.0, 0.0, 1e3, "1", "α/C, for gains hba, lfba and custom"),
    Setting("mu2", 0.0, 0.0, 1e3, "1", "λ/√C, for gains hba, lfba and custom"),
    Choice(
        "discretisation", "implicit", SCHEMES, "discretisation of the sign at zero; the explicit ones chatter"
    ),
    Choice("output", "u", OUTPUTS, "u, which follows at once, or u1, its integrator, smoother and later"),
)

ESTIMATOR = Estimator(
    name="levant",
    summary="Levant's first-order sliding-mode differentiator",
    source="Levant 1998; Chawda et al., equations (9) to (14); implicit form: I-STD of Mojallizadeh et al.",
    update=update,
    floats=FLOATS,
    ints=INTS,
    settings=SETTINGS,
    design=design,
)
