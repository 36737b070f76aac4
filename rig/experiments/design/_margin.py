"""Compute the fraction of the recommended stiffness that remains on rigs and in hands other than described.

`_search` calls this module. Simulated hits at one damping find the limit with each identified parameter changed alone
by 20 %, with each modelled hand alone, and on 16 rigs with all parameters drawn at random. A parameter is identified if
`rig identify` measures it and its value is not zero.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rig import config
from rig.analysis import theory
from rig.config import Experiment
from rig.core.errors import ConfigError
from rig.core.operators import GRIPS
from rig.core.present import reported
from rig.experiments.design._listing import Candidate
from rig.experiments.design._rounds import Sweeper, WallGrid
from rig.experiments.mapping._ranges import search_for
from rig.experiments.mapping.zwidth import ZWidth

SHARE = 0.2
SAMPLES = 16
SEED = 20_260  # of the random rigs
# Ratio of two tested stiffnesses; highest tested stiffness over the limit on the described rig.
RATIO, BEYOND = 1.1, 1.2
OFFSETS = (0.1, 0.6)
# The delay is identified in whole ticks, so that it is not changed by 20 % but by one tick.
DELAY = "rig.simulation.computation_delay_ticks"
# Keys that `rig.experiments.identification._identified_values` sets.
IDENTIFIED = (
    *(
        f"rig.mechanics.{name}"
        for name in (
            "motor_inertia",
            "link_inertia",
            "motor_damping",
            "link_damping",
            "motor_coulomb",
            "link_coulomb",
            "transmission_stiffness",
            "transmission_damping_ratio",
        )
    ),
    "rig.amplifier.lag_s",
)


@dataclass(frozen=True, slots=True)
class Left:
    """Fraction of a wall's stiffness limit that is left after one change of the rig.

    Attributes
    ----------
    change
        Description of the change, like "mechanics.motor_inertia +20%".
    share
        Limit on the changed rig divided by the limit on the described rig; not exact if `capped`.
    capped
        True if the search on the changed or on the described rig ended before a wall failed.
    theory
        The same ratio by linear theory; None if not `capped`, for a nonlinear estimator, or for a limit of zero.
    """

    change: str
    share: float
    capped: bool
    theory: float | None

    @property
    def expected(self) -> float:
        """Return the fraction to sort by: from simulated hits, or from theory if no tested wall failed in these."""
        return self.share if not self.capped or self.theory is None else self.theory


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """Robustness of a sampling scheme: the fraction of its stiffness limit at one damping that is left on other rigs.

    Attributes
    ----------
    damping, stiffness
        Damping (N·m·s/rad or N·s/m), and limit of K on the described rig (N·m/rad or N/m).
    capped
        True if `stiffness` is only a lower bound, because the search ended before a wall failed.
    worst
        Lowest remaining fraction over all sampled rigs and modelled hands.
    alone
        Remaining fraction for each single change, the lowest first.
    samples
        Number of sampled rigs, each tested with every modelled hand.
    """

    damping: float
    stiffness: float
    capped: bool
    worst: Left
    alone: tuple[Left, ...]
    samples: int

    @reported
    def spoils_first(self) -> Left:
        """Return the single change of the rig that leaves the smallest fraction of the stiffness limit."""
        return self.alone[0]

    @reported
    def secured(self) -> float:
        """Return the stiffness limit on the worst sampled rig (N·m/rad or N/m); a lower bound if `worst.capped`."""
        return self.worst.share * self.stiffness


def identified(experiment: Experiment) -> dict[str, float]:
    """Return the values of a rig's parameters that `rig identify` measures and that are not zero, by dotted key."""
    values = {}
    for key in IDENTIFIED:
        _, section, name = key.split(".")
        value = float(getattr(getattr(experiment.rig, section), name))
        if value > 0.0:
            values[key] = value
    return values


def margin_of(
    candidate: Candidate, experiment: Experiment, damping: float, limit: float, run: Sweeper
) -> Margin:
    """Find by simulated hits how much of a candidate's stiffness limit is left on other rigs than described.

    `damping` is that of the walls (N·m·s/rad or N·s/m); `limit`, an estimate (N·m/rad or N/m), sets the range to test.
    """
    described = candidate.condition(experiment)
    single, joint = dict(_vary_singly(described)), dict(_vary_jointly(described))
    variants = {"": described, **single, **joint}
    scheme, rigs = candidate.scheme, variants.values()
    work = [(variant, scheme, _grid(variant, candidate, damping, limit)) for variant in rigs]
    maps = dict(zip(variants, run.map_each("margin", work), strict=True))
    nominal, capped = _limit(maps[""])
    left = {}
    for name, found in maps.items():
        there, ends_early = _limit(found)
        share = there / nominal if nominal > 0.0 else 0.0
        by_theory = (
            # If the push is too weak to make a wall fail, the fraction is only a lower bound; theory has no such bound.
            _share_by_theory(candidate, variants[name], described, damping) if capped or ends_early else None
        )
        left[name] = Left(name, share, capped=capped or ends_early, theory=by_theory)
    return Margin(
        damping=damping,
        stiffness=nominal,
        capped=capped,
        worst=min((left[name] for name in joint), key=lambda one: one.expected),
        alone=tuple(sorted((left[name] for name in single), key=lambda one: one.expected)),
        samples=SAMPLES,
    )


def _vary_singly(described: Experiment) -> Iterator[tuple[str, Experiment]]:
    for key, value in identified(described).items():
        for sign in (1.0, -1.0):
            name = f"{key.removeprefix('rig.')} {sign * SHARE:+.0%}"
            yield name, config.override(described, {key: value * (1.0 + sign * SHARE)}, "the margin")
    delay = described.rig.simulation.computation_delay_ticks + 1
    yield "a tick more of delay", config.override(described, {DELAY: delay}, "the margin")
    for hand, changes in _other_hands(described).items():
        yield hand, config.override(described, changes, "the margin")


def _vary_jointly(described: Experiment) -> Iterator[tuple[str, Experiment]]:
    """Yield name and experiment of rigs with all parameters drawn at random, each with all valid hand models."""
    random, values = np.random.default_rng(SEED), identified(described)
    for number in range(1, SAMPLES + 1):
        factors = random.uniform(1.0 - SHARE, 1.0 + SHARE, len(values)).tolist()
        drawn = {key: value * factor for (key, value), factor in zip(values.items(), factors, strict=True)}
        for hand, changes in {"": {}, **_other_hands(described)}.items():
            name = f"sample {number}{f' in a {hand}' if hand else ''}"
            yield name, config.override(described, {**drawn, **changes}, "the margin")


def _other_hands(described: Experiment) -> dict[str, dict[str, str]]:
    """Return, by name, the keys that put another modelled hand on the handle, if the experiment is valid with it."""
    own = described.operator.grip if described.trial.kind == "human" else ""

    def may_hold(changes: dict[str, str]) -> bool:
        try:
            config.override(described, changes, "the margin")
        except ConfigError:
            return False
        return True

    others = {f"{grip} hand": {"trial.kind": "human", "operator.grip": grip} for grip in GRIPS if grip != own}
    return {hand: changes for hand, changes in others.items() if may_hold(changes)}


def _grid(experiment: Experiment, candidate: Candidate, damping: float, limit: float) -> WallGrid:
    # Test upwards from the softest wall: near the largest damping a soft wall may fail although stiffer walls pass, and
    # a bisection would miss this failure.
    search = search_for(experiment, "ladder", ratio=RATIO, schemes=[candidate.scheme])
    if 0.0 < BEYOND * limit < search.highest:
        search = replace(search, highest=BEYOND * limit, lowest=min(search.lowest, limit / RATIO))
    return WallGrid(dampings=(damping,), search=search, offsets=OFFSETS)


def _limit(found: ZWidth) -> tuple[float, bool]:
    (boundary,) = found.curve(0, "any")
    return boundary.lowest, boundary.capped == len(boundary.limits)


def _share_by_theory(
    candidate: Candidate, changed: Experiment, described: Experiment, damping: float
) -> float | None:
    try:
        limits = [theory.k_max(x, candidate.scheme, damping).stiffness for x in (changed, described)]
    except ConfigError:  # an estimator that is not linear
        return None
    return limits[0] / limits[1] if limits[1] > 0.0 else None
