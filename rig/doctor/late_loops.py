"""Compute by linear theory the stability of a wall whose commands act some ticks late, for each modelled hand.

Theory covers the spring and damper of the built-in walls with linear velocity estimators. A nonlinear estimator is
replaced by the filter `STAND_IN` at the same rates, and each result with this filter is marked. If the velocity rate
alternates between two rates, each rate is computed separately.

The arming gate, the examination of a computer, sessions and the console call this file. It must not measure a link, nor
decide whether a wall may be armed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from rig.analysis.theory import Lifted, LinearLoop, NotLinearError, k_max_curve, linear_loop
from rig.config import Experiment
from rig.config.schemes import STAND_IN, Scheme
from rig.core.errors import ConfigError
from rig.core.model import Operator
from rig.core.operators import GRIPS, NO_OPERATOR

if TYPE_CHECKING:
    from rig.doctor._round_trip import LinkMeasurement

# In ticks: after a longer delay a command's lifetime has ended, so the device has dropped the command.
LARGEST_DELAY = 40
# Laws whose wall is the spring K and the damper B that linear theory covers; an excitation is added to them.
SPRING_AND_DAMPER = ("spring-damper", "bilateral", "excited")


def hands_of(experiment: Experiment) -> dict[str, str | Operator]:
    """Return the hand models to compute with, by name: no hand, the built-in hands, and the experiment's own hand."""
    hands: dict[str, str | Operator] = {name: name for name in (NO_OPERATOR, *GRIPS)}
    own = experiment.operator
    if experiment.trial.kind == "human" and GRIPS.get(own.grip) != own:
        hands["the experiment's own"] = own
    return hands


def late_by(experiment: Experiment, ticks: int) -> Experiment:
    """Return a copy of the experiment in which each command acts `ticks` ticks after its sample."""
    simulation = replace(experiment.rig.simulation, computation_delay_ticks=ticks)
    return replace(experiment, rig=replace(experiment.rig, simulation=simulation))


def loop_delay_ticks(experiment: Experiment, measurement: LinkMeasurement, rate: int) -> int:
    """Return the delay from a sample to its effort in ticks of `rate` (Hz); 0 if the device runs the control law."""
    if experiment.controller.loop == "device":
        return 0
    return measurement.delay_ticks(rate, experiment.host.pacing)


@dataclass(frozen=True)
class LateLoops:
    """Linear models of an experiment's closed loop with a delay: one for each modelled hand and each velocity rate.

    Attributes
    ----------
    experiment
        The experiment, changed so that its commands act late by the delay.
    stand_in
        Sentence that says which filter replaces a nonlinear estimator and why; empty if the estimator is linear.
    """

    experiment: Experiment
    stand_in: str
    # The experiment's own loop for each velocity rate. It holds the estimator: the device runs this one, with the
    # inertia of the experiment's trial, whichever hand is on the handle.
    _own: tuple[tuple[Scheme, LinearLoop], ...]

    @classmethod
    def of(cls, experiment: Experiment, delay_ticks: int) -> LateLoops:
        """Return the closed loop's linear models with a delay of `delay_ticks` periods of the position samples.

        Raise `ConfigError` for a law or a delay that theory does not cover.
        """
        law = experiment.wall.law
        if law not in SPRING_AND_DAMPER:
            raise ConfigError(
                f"the control law {law} is not a spring and damper ({', '.join(SPRING_AND_DAMPER)}), so its "
                "stability cannot be computed",
                remedy="reduce rig.limits.effort for the first trials, then raise it step by step",
            )
        if experiment.controller.wall_is_elsewhere:
            raise ConfigError(
                "the motor drive renders the wall itself, with filters that linear theory does not model",
                remedy="reduce rig.limits.effort for the first trials, then raise it step by step",
            )
        if delay_ticks > LARGEST_DELAY:
            raise ConfigError(
                f"stability cannot be computed for a delay of {delay_ticks} ticks; allowed are {LARGEST_DELAY} at most",
                remedy=f"choose a rate of {experiment.controller.position_rate * LARGEST_DELAY // delay_ticks} Hz or "
                "less, or a faster link",
            )
        late = late_by(experiment, delay_ticks)
        schemes, reason = _linear_schemes(late)
        return cls(late, reason, tuple((scheme, linear_loop(late, scheme)) for scheme in schemes))

    @cached_property
    def by_hand(self) -> Mapping[str, tuple[Lifted, ...]]:
        """Return the closed loop's linear models by name of the modelled hand: one for each velocity rate."""
        return {
            name: tuple(
                Lifted.of(linear_loop(self.experiment, scheme, operator=hand, estimator=own.estimator))
                for scheme, own in self._own
            )
            for name, hand in hands_of(self.experiment).items()
        }

    def radius(self, stiffness: float, damping: float) -> dict[str, float]:
        """Return the closed loop's spectral radius by name of the modelled hand, the largest over the velocity rates.

        Below 1 the wall is stable. `stiffness` and `damping` are in SI units (N/m and N·s/m, or N·m/rad and N·m·s/rad).
        """
        return {
            name: max(float(loop.radius(stiffness, damping)) for loop in loops)
            for name, loops in self.by_hand.items()
        }

    def k_max(self, dampings: Sequence[float]) -> list[dict[str, float]]:
        """Return per damping (N·s/m or N·m·s/rad) the largest stable stiffness (N/m or N·m/rad) by modelled hand."""
        curves = {
            hand: [k_max_curve(loop, None, dampings) for loop in loops]
            for hand, loops in self.by_hand.items()
        }
        return [
            {hand: min(curve[i].stiffness for curve in of_hand) for hand, of_hand in curves.items()}
            for i in range(len(dampings))
        ]


def unstable_hands(radius: Mapping[str, float], stiffness: float) -> list[str]:
    """Return the names of the modelled hands with which a wall is unstable; `radius` is the spectral radius by name."""
    # Without stiffness the handle is free to stay anywhere: an eigenvalue of 1, which rounding may lift.
    return [hand for hand, value in radius.items() if value >= (1.0 if stiffness > 0.0 else 1.0 + 1e-9)]


def _linear_schemes(experiment: Experiment) -> tuple[tuple[Scheme, ...], str]:
    """Return a sampling scheme for each velocity rate, and why the estimator was replaced ("" if it is linear)."""
    own = replace(Scheme.of(experiment), slow_velocity_rate=None, slow_below=0.0)
    slow = experiment.controller.slow_velocity_rate if experiment.controller.slow_below else None
    rates = [own.velocity_rate] if slow in (None, own.velocity_rate) else [own.velocity_rate, slow]
    # at the slow rate the same coefficients run more rarely: without settings a cut-off keeps its share of the rate
    schemes = [own, *(replace(own, velocity_rate=rate, parameters={}) for rate in rates[1:])]
    try:
        linear_loop(experiment, own)
    except NotLinearError as error:
        usual = [replace(scheme, estimator=STAND_IN, parameters=_cutoff_of(scheme)) for scheme in schemes]
        return tuple(usual), f"{own.estimator} is not linear ({error.reason}): theory uses {STAND_IN} instead"
    return tuple(schemes), ""


def _cutoff_of(scheme: Scheme) -> dict[str, float | str]:
    return {key: value for key, value in scheme.parameters.items() if key == "cutoff_hz"}
