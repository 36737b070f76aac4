"""Build the linear loop of the theory from a rig and a scheme: plant, held effort, estimator and their rates.

`resolve` accepts a rig in several forms; `linear_loop` computes the matrices. The theory leaves out what is not linear:
Coulomb friction, the encoder's quantum, saturation, and the release (its wall may pull, τ = −(K·θ + B·v)). Hits on
koul-compliant, koul-rigid and chawda-linear (`rig zwidth -B 0`: 1, 5 and 20 kHz, B = 0, a normal hand) are stable up to
1.1 to 2.5 times the K_max of theory, and without friction up to 0.4 to 0.9 times. The quantum reduces the range of
stable damping by 30 to 50 % for a dual-rate wall and by nearly all for a uniform 20 kHz wall.

Cogging enters as a stiffness of the motor's side (its slope), at the stiffest and the softest position between the wall
and the end of the window. Ripple is not included: it multiplies K and B by 1 ± r (`rig experiment plan` reports r).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.analysis.theory._linear import NotLinearError, Realisation, realise
from rig.config import Controller, Experiment, Wall, presets
from rig.config.schemes import Scheme, usual_settings
from rig.control import estimators
from rig.core.errors import ConfigError
from rig.core.exponential import expm
from rig.core.model import Matrix, Operator, RigModel, StateSpace, state_space
from rig.core.operators import GRIPS, NO_OPERATOR

RigLike = str | Path | Experiment | RigModel
SchemeLike = str | Scheme
Vector = NDArray[np.float64]

# Positions at which the slope of cogging is computed, in one wave of its highest harmonic.
SLOPES = 64


@dataclass(frozen=True, slots=True)
class Subject:
    """A rig to which theory is applied: its model, its experiment (or None), and the model of a hand (or None)."""

    model: RigModel
    experiment: Experiment | None
    operator: Operator | None

    @property
    def damping(self) -> float:
        """Return the damping of a rig in slow rigid motion (N·m·s/rad or N·s/m): motor, link and back-EMF."""
        # Without the hand: a passive wall must be stable with any hand, even the lightest.
        return self.model.damping

    @property
    def port_damping(self) -> float:
        """Return the least damping of the motor's side with any passive hand on the handle (N·m·s/rad or N·s/m).

        On a rigid rig this is `damping`. On two masses the link's damper b_l acts through the transmission's damper c,
        and the least damping over all frequencies and passive hands is b_m + c·b_l/(c + b_l). Back-EMF is included.
        """
        mechanics = self.model.mechanics
        link, across = mechanics.link_damping, mechanics.transmission_damping
        if mechanics.structure == "rigid" or link == 0.0:
            return self.damping
        return self.damping - link + link * across / (link + across)

    @property
    def inertia(self) -> float:
        """Return the inertia of a rigid motion of motor and link, without a hand on the handle (kg·m² or kg)."""
        return self.model.mechanics.inertia


@dataclass(frozen=True, slots=True, eq=False)
class LinearLoop:
    """Linear model of a rig under a sampling scheme: matrices of the plant over one tick, estimator, rates and delay.

    ``phi`` and ``gamma`` step the plant over a tick with a held command; ``sensed`` is the index of the measured
    position. `cogging` is the stiffness by cogging at the stiffest position (N·m/rad or N/m), `compensated` the part
    that the law cancels. `softest` is the loop at the position with the softest cogging; None without cogging.
    """

    subject: Subject
    controller: Controller
    estimator: Realisation
    phi: Matrix
    gamma: Vector
    sensed: int
    tick_s: float
    divider: int
    extrapolate: bool
    delay_ticks: int
    cogging: float = 0.0
    compensated: float = 0.0
    softest: LinearLoop | None = None

    @property
    def period_s(self) -> float:
        """Return the velocity period T2 (time between two velocity samples) of the loop (s)."""
        return self.tick_s * self.divider

    @property
    def late_s(self) -> float:
        """Return the delay of an effort (s) in addition to the hold: electrical lag plus computation delay."""
        return self.subject.model.amplifier.lag_s + self.delay_ticks * self.tick_s


def resolve(rig: RigLike, operator: str | Operator | None = None) -> Subject:
    """Return model, experiment and hand of a rig that is given as preset name, TOML file, experiment or model.

    Parameters
    ----------
    rig
        A text without a suffix that names a preset selects the preset; any other text is a path.
    operator
        Model of the hand on the handle: ``"none"``, the name of a grip, or an `rig.core.model.Operator`; None: the hand
        of the experiment if a person performs its trial, else no hand. With a hand the end mass, which is fixed to the
        handle for trials without a person, is 0.

    Raises
    ------
    ConfigError
        The preset, file or grip does not exist, or the experiment is not valid.
    """
    if isinstance(rig, RigModel):
        experiment, model = None, rig
    else:
        experiment = presets.load_named(rig)
        model = config.rig_model(experiment if operator is None else experiment.rig)
    hand = _hand(operator, model)
    if hand is not None:
        model = replace(model, mechanics=replace(model.mechanics, end_mass=0.0))
    return Subject(model, experiment, hand)


def linear_loop(
    rig: RigLike | Subject,
    scheme: SchemeLike | None = None,
    *,
    operator: str | Operator | None = None,
    estimator: Realisation | None = None,
) -> LinearLoop:
    """Return the linear model of a rig under a sampling scheme; None selects the experiment's own sampling scheme.

    `rig` is a preset name, TOML file, experiment or model, `operator` the model of a hand. `estimator` is the
    estimator's state space from another call, if it is not that for this rig in this hand, or to save time.

    Raises
    ------
    ConfigError
        The rig, the hand or the scheme is not valid, or the scheme is missing.
    NotLinearError
        The estimator is not linear, the velocity rate depends on speed, or the wall has options that theory lacks.
    """
    subject = rig if isinstance(rig, Subject) else resolve(rig, operator)
    controller = _controller(subject, Scheme.parse(scheme) if isinstance(scheme, str) else scheme)
    _check_fixed_rates(controller)
    if subject.experiment is not None:
        _check_wall(subject.experiment.wall)
    model = subject.model
    tick_s = 1.0 / controller.position_rate
    resolution, name = model.encoder.sign * model.encoder.resolution, controller.estimator
    of_rig = config.settings_of_rig(model)  # with the end mass, or without where a hand is on the handle
    settings = {**estimators.get(name).settings_of(of_rig), **controller.parameters}
    continuous = state_space(model.mechanics, model.amplifier, subject.operator)
    least, most = cogging_stiffness(subject)
    phi, gamma = _over_tick(_stiffer(continuous, most), tick_s)
    loop = LinearLoop(
        subject=subject,
        controller=controller,
        estimator=estimator or realise(name, settings, 1.0 / controller.velocity_rate, resolution),
        phi=phi,
        gamma=gamma,
        sensed=continuous.sensed_position,
        tick_s=tick_s,
        divider=controller.position_rate // controller.velocity_rate,
        extrapolate=controller.prediction == "extrapolate",
        delay_ticks=model.delay_ticks(tick_s),
        cogging=most,
        compensated=most if controller.cogging_compensation else 0.0,
    )
    if least == most:
        return loop
    phi, gamma = _over_tick(_stiffer(continuous, least), tick_s)
    taken = least if controller.cogging_compensation else 0.0
    return replace(loop, softest=replace(loop, phi=phi, gamma=gamma, cogging=least, compensated=taken))


def cogging_stiffness(subject: Subject) -> tuple[float, float]:
    """Return the smallest (at most 0) and largest (at least 0) stiffness by cogging at the motor (N·m/rad or N/m).

    The positions are those from the wall to the end of the window; for a model without experiment, a period of cogging.
    """
    cogging, experiment = subject.model.cogging, subject.experiment
    if cogging.period is None or not cogging.orders:
        return 0.0, 0.0
    low, high = 0.0, cogging.period
    if experiment is not None:
        limits, wall = experiment.rig.limits, experiment.wall
        ends = (wall.position, limits.position_maximum if wall.side > 0 else limits.position_minimum)
        low, high = min(ends), max(ends)
    steps = math.ceil(SLOPES * max(cogging.orders) * (high - low) / cogging.period)
    stiffness = -cogging.slope(np.linspace(low, high, steps + 1))
    return min(0.0, float(stiffness.min())), max(0.0, float(stiffness.max()))


def _stiffer(continuous: StateSpace, stiffness: float) -> StateSpace:
    """Return the state space of a rig with an additional spring of `stiffness` (N·m/rad or N/m) at its motor."""
    if stiffness == 0.0:
        return continuous
    a, motor = continuous.a.copy(), continuous.sensed_position
    a[:, motor] -= stiffness * continuous.b[:, continuous.friction_inputs.start]
    return replace(continuous, a=a)


def _hand(operator: str | Operator | None, model: RigModel) -> Operator | None:
    if operator is None:
        return model.operator
    if not isinstance(operator, str):
        return operator
    if operator == NO_OPERATOR:
        return None
    if operator not in GRIPS:
        raise ConfigError(
            f"unknown grip {operator!r}", remedy=f"choose one of: {', '.join((NO_OPERATOR, *GRIPS))}"
        )
    return GRIPS[operator]


def _controller(subject: Subject, scheme: Scheme | None) -> Controller:
    if subject.experiment is not None:
        experiment = subject.experiment
        return (experiment if scheme is None else scheme.applied(experiment)).controller
    if scheme is None:
        raise ConfigError(
            "no sampling scheme is given, and this rig has no experiment that contains one",
            remedy="give a sampling scheme, such as dual:20k/2k",
        )
    if scheme.position_rate % scheme.velocity_rate:
        raise ConfigError(
            f"scheme {scheme.text}: {scheme.position_rate} Hz is not a multiple of {scheme.velocity_rate} Hz",
            remedy=f"choose a position rate that is a multiple of the velocity rate, {scheme.velocity_rate} Hz",
        )
    estimator = scheme.estimator or "fdm-butterworth"
    return Controller(
        position_rate=scheme.position_rate,
        velocity_rate=scheme.velocity_rate,
        estimator=estimator,
        parameters={**usual_settings(estimator, scheme.velocity_rate), **scheme.parameters},
        prediction=scheme.prediction or "hold",
        slow_velocity_rate=scheme.slow_velocity_rate,
        slow_below=scheme.slow_below or 0.0,
    )


def with_linear_wall(experiment: Experiment) -> Experiment:
    """Return the experiment with the nonlinear options of its wall removed, so that linear theory can estimate it."""
    wall = replace(experiment.wall, passive_damping=0.0, position_from="encoder")
    return replace(experiment, wall=wall)


def _check_wall(wall: Wall) -> None:
    if wall.passive_damping > 0.0:
        raise NotLinearError(
            f"a passivity controller (wall.passive_damping = {wall.passive_damping:g}) is not linear",
            reason="its wall has a passivity controller",
            remedy="set wall.passive_damping = 0, or simulate",
        )
    if wall.position_from == "estimator":
        raise NotLinearError(
            'theory covers walls that use the encoder\'s position, not wall.position_from = "estimator"',
            reason="its wall uses the estimated position",
            remedy='set wall.position_from = "encoder", or simulate',
        )


def _check_fixed_rates(controller: Controller) -> None:
    slow = controller.slow_velocity_rate
    if controller.slow_below > 0.0 and slow is not None and slow != controller.velocity_rate:
        raise NotLinearError(
            f"a velocity rate that drops to {slow} Hz below {controller.slow_below:g} rad/s or m/s is not linear",
            reason=f"its velocity rate is {slow} Hz below {controller.slow_below:g} rad/s or m/s",
            remedy=f"analyse the two rates separately: {controller.velocity_rate} and {slow} Hz; or simulate",
        )


def _over_tick(continuous: StateSpace, tick_s: float) -> tuple[Matrix, Vector]:
    """Return the exact transition matrix and input vector of a plant over a tick (s), with the command held."""
    order = continuous.order
    whole = np.zeros((order + 1, order + 1))
    whole[:order, :order], whole[:order, order] = continuous.a, continuous.b[:, 0]
    if not math.isfinite(np.abs(whole).max()):
        raise ConfigError(
            "the rig's state-space matrices contain infinity or NaN",
            remedy="check that inertias are above 0, and that lag and stiffness are finite",
        )
    exact = expm(whole * tick_s)
    phi, gamma = exact[:order, :order], exact[:order, order]
    e = continuous.effort
    if not continuous.a[e].any():  # no lag: the effort state stands alone and nothing reads it
        phi[e, e] = 0.0
    return np.ascontiguousarray(phi), np.ascontiguousarray(gamma)
