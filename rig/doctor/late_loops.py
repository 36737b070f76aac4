"""Linear theory of an experiment whose commands act a number of ticks late, in every hand that may hold the handle.

Theory covers the spring and damper of the built-in walls with linear estimators. For an estimator that is not linear
the usual filtered difference at the same rates is used, and every result with it is marked. Two velocity rates that
alternate are computed one by one.

The gate, the examination of a machine, sessions and the console call it. It must not measure a link, nor decide whether
a wall may be armed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from rig.analysis.theory import Lifted, LinearLoop, NotLinearError, k_max_curve, linear_loop
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.core.model import Operator
from rig.core.operators import GRIPS, NO_OPERATOR

if TYPE_CHECKING:
    from rig.doctor._round_trip import LinkMeasurement

LARGEST_DELAY = 40  # ticks: at a longer delay a command's lifetime has ended
# In place of an estimator that is not linear: without damping an estimator has no effect, and with damping an adaptive
# one has at best a little less lag than this filter, which was designed for the same noise.
STAND_IN = "fdm-butterworth"
SPRING_AND_DAMPER = ("spring-damper", "bilateral", "excited")  # laws whose wall is K and B, excitation aside


def hands_of(experiment: Experiment) -> dict[str, str | Operator]:
    """Return no hand, every preset of a hand, and the experiment's own hand if it differs from the presets."""
    hands: dict[str, str | Operator] = {name: name for name in (NO_OPERATOR, *GRIPS)}
    own = experiment.operator
    if experiment.trial.kind == "human" and GRIPS.get(own.grip) != own:
        hands["the experiment's own"] = own
    return hands


def late_by(experiment: Experiment, ticks: int) -> Experiment:
    """Return the experiment on a rig whose commands act so many ticks late."""
    simulation = replace(experiment.rig.simulation, computation_delay_ticks=ticks)
    return replace(experiment, rig=replace(experiment.rig, simulation=simulation))


def loop_delay_ticks(experiment: Experiment, measurement: LinkMeasurement, rate: int) -> int:
    """Return whole ticks from a sample to its effort: the link's, or none where the device itself runs the law."""
    if experiment.controller.loop == "device":
        return 0
    return measurement.delay_ticks(rate, experiment.host.pacing)


@dataclass(frozen=True)
class LateLoops:
    """The linear loops of one experiment at one delay: by hand, and by velocity rate where there are two.

    Attributes
    ----------
    experiment
        As it is, its rig late by the delay.
    stand_in
        Why the usual filter stands in for the estimator; empty if it does not.
    """

    experiment: Experiment
    stand_in: str
    _free: tuple[tuple[Scheme, LinearLoop], ...]  # in no hand, for each velocity rate

    @classmethod
    def of(cls, experiment: Experiment, delay_ticks: int) -> LateLoops:
        """Find what is linear about an experiment.

        Raises `ConfigError` for a law or a delay that theory does not cover.
        """
        law = experiment.wall.law
        if law not in SPRING_AND_DAMPER:
            raise ConfigError(
                f"the law {law} is not a spring and damper, so its stability cannot be computed",
                remedy="begin with little effort",
            )
        if experiment.controller.wall_is_elsewhere:
            raise ConfigError(
                "the drive renders the wall itself, with filters that linear theory here does not model",
                remedy="begin with little effort",
            )
        if delay_ticks > LARGEST_DELAY:
            raise ConfigError(
                f"stability with a delay of {delay_ticks} ticks cannot be computed (at most {LARGEST_DELAY})",
                remedy=f"choose a rate of {experiment.controller.position_rate * LARGEST_DELAY // delay_ticks} Hz or "
                "less, or a faster link",
            )
        late = late_by(experiment, delay_ticks)
        schemes, reason = _linear_schemes(late)
        free = tuple((scheme, linear_loop(late, scheme, operator=NO_OPERATOR)) for scheme in schemes)
        return cls(late, reason, free)

    @cached_property
    def by_hand(self) -> Mapping[str, tuple[Lifted, ...]]:
        """Return the loops for each hand, one for each velocity rate."""
        return {
            name: tuple(
                Lifted.of(linear_loop(self.experiment, scheme, operator=hand, estimator=free.estimator))
                for scheme, free in self._free
            )
            for name, hand in hands_of(self.experiment).items()
        }

    def radius(self, stiffness: float, damping: float) -> dict[str, float]:
        """Return the spectral radius for each hand, the larger of the rates: below 1 the wall is linearly stable."""
        return {
            name: max(float(loop.radius(stiffness, damping)) for loop in loops)
            for name, loops in self.by_hand.items()
        }

    def k_max(self, dampings: Sequence[float]) -> list[dict[str, float]]:
        """Return the largest stable stiffness for each hand, the smaller of the rates, at each damping."""
        curves = {
            hand: [k_max_curve(loop, None, dampings) for loop in loops]
            for hand, loops in self.by_hand.items()
        }
        return [
            {hand: min(curve[i].stiffness for curve in of_hand) for hand, of_hand in curves.items()}
            for i in range(len(dampings))
        ]


def unstable_hands(radius: Mapping[str, float], stiffness: float) -> list[str]:
    """Return the hands in which a wall of this stiffness is unstable, by its spectral radius in each."""
    # Without stiffness the handle is free to stay anywhere: an eigenvalue of 1, which rounding may lift.
    return [hand for hand, value in radius.items() if value >= (1.0 if stiffness > 0.0 else 1.0 + 1e-9)]


def _linear_schemes(experiment: Experiment) -> tuple[tuple[Scheme, ...], str]:
    """Return the schemes to look at, and why the usual filter stands in for the estimator (empty: it does not)."""
    own = replace(Scheme.of(experiment), slow_velocity_rate=None, slow_below=0.0)
    slow = experiment.controller.slow_velocity_rate if experiment.controller.slow_below else None
    rates = [own.velocity_rate] if slow in (None, own.velocity_rate) else [own.velocity_rate, slow]
    # at the slow rate the same coefficients run more rarely: without settings a cut-off keeps its share of the rate
    schemes = [own, *(replace(own, velocity_rate=rate, parameters={}) for rate in rates[1:])]
    try:
        linear_loop(experiment, own, operator=NO_OPERATOR)
    except NotLinearError as error:
        usual = [replace(scheme, estimator=STAND_IN, parameters=_cutoff_of(scheme)) for scheme in schemes]
        return tuple(usual), f"{own.estimator} is not linear ({error.reason}): theory uses {STAND_IN} instead"
    return tuple(schemes), ""


def _cutoff_of(scheme: Scheme) -> dict[str, float | str]:
    return {key: value for key, value in scheme.parameters.items() if key == "cutoff_hz"}
