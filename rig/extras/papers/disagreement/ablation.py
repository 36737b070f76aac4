"""Find why hits and linear theory judge a wall differently: remove non-linearities until both agree.

The same wall is hit on the same rig without these non-linearities:

* **friction**: no Coulomb friction on either side;
* **quantum**: an encoder with `FINER` times as many counts;
* **saturation**: effort limits of motor and safety guard as large as the protocol allows (32767 steps), no slew limit;
* **contact**: a spring and damper that holds the handle from its first contact on, so that it cannot leave the wall.

**The rule.** For every wall that differs, each of the four is removed alone; if theory and hits agree in no case, all
pairs are removed, then all triples, then all four. A *cure* is a set whose removal makes theory and hits agree; only
the cures of the smallest size count.

* One cure with one element: this element is the cause.
* Several cures with one element: an interaction, in which each of these elements is needed (`EACH`).
* Cures with two or more elements: no element alone is needed, because others have the same effect (`OTHERS`).
* No cure: `NONE`. The cause is another difference between hit and theory: an end of the travel, the hand's own motion,
  thresholds, the quantum of the current.

An invalid hit does not count as agreement.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

from rig import config
from rig.analysis.theory import Lifted, linear_loop
from rig.config import Experiment, controller
from rig.control.bilateral import clinging_law
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.experiments.mapping.interface import StiffnessSearch

FRICTION, QUANTUM, SATURATION, CONTACT = FOUR = ("friction", "quantum", "saturation", "contact")
EACH, OTHERS, NONE = "each of several", "any of several", "none of the four"
CAUSES = (*FOUR, EACH, OTHERS, NONE)
# Counts for one count: the finer quantum is below a thousandth of the thresholds on every preset.
FINER = 256
UNBOUND = 1e9  # factor that makes the slew limit so high that it never acts

Cure = tuple[str, ...]
Holds = bool | None  # None: invalid hit


def cures(agrees: Callable[[Cure], bool]) -> tuple[Cure, ...]:
    """Return the smallest sets of non-linearities whose removal makes theory and hits agree; empty if no set does.

    `agrees` must return True if linear theory and the simulated hit agree without the non-linearities of a set.
    """
    for size in range(1, len(FOUR) + 1):
        # All sets of one first, then of two: a larger set that contains a cure cures, too, and would name too much.
        found = tuple(taken for taken in combinations(FOUR, size) if agrees(taken))
        if found:
            return found
    return ()


def cause_of(found: Sequence[Cure]) -> str:
    """Return the cause (one of `CAUSES`) why linear theory and simulated hits disagree on a wall.

    `found` has the smallest sets of non-linearities without which they agree (cures).
    """
    if not found:
        return NONE
    # None of them is needed by itself.
    if len(found[0]) > 1:
        return OTHERS
    # Several single cures: an interaction, each of them is needed.
    return found[0][0] if len(found) == 1 else EACH


def without(experiment: Experiment, taken: Iterable[str]) -> Experiment:
    """Return the experiment without the non-linearities `taken`; for `CONTACT` the wall's law must be replaced, too."""
    rig, homing = experiment.rig, experiment.homing
    for one in taken:
        if one == FRICTION:
            rig = replace(rig, mechanics=replace(rig.mechanics, motor_coulomb=0.0, link_coulomb=0.0))
        elif one == QUANTUM:
            encoder = rig.encoder
            finer = (
                replace(encoder, quantum=encoder.resolution / FINER)
                if encoder.counts_per_revolution is None
                else replace(encoder, counts_per_revolution=encoder.counts_per_revolution * FINER)
            )
            rig = replace(rig, encoder=finer)
            homing = replace(homing, tolerance_counts=homing.tolerance_counts * FINER)
        elif one == SATURATION:
            most = controller.I16_MAXIMUM * rig.amplifier.effort_quantum
            lifted = replace(rig.amplifier, effort_limit=max(most, rig.amplifier.effort_limit))
            free = replace(rig.limits, effort=max(most, rig.limits.effort), slew=rig.limits.slew * UNBOUND)
            rig = replace(rig, amplifier=lifted, limits=free)
    return replace(experiment, rig=rig, homing=homing)


class _Column:
    """Simulator for the walls of one sampling scheme and damping, on rigs with and without some non-linearities."""

    def __init__(self, experiments: Sequence[Experiment], judged: str) -> None:
        self._experiments, self._judged = experiments, judged
        self._rigs: dict[tuple[Cure, int], HitSimulator] = {}
        self.hits = self.ticks = 0

    def passes(self, stiffness: float, number: int, taken: Cure = ()) -> Holds:
        """Hit a wall on the rig without the non-linearities `taken`; return True if it is stable, None if invalid.

        `number` is the index of the experiment, which has its own encoder offset and repeat.
        """
        experiment = self._experiments[number]
        if (taken, number) not in self._rigs:
            law = clinging_law() if CONTACT in taken else None
            self._rigs[taken, number] = HitSimulator(without(experiment, taken), law=law)
        hit = self._rigs[taken, number].hit(stiffness, experiment.wall.damping)
        self.hits += 1
        self.ticks += hit.ticks
        return (hit.true if self._judged == "true" else hit.recorded).passes("any")

    def holds(self, stiffness: float, taken: Cure = ()) -> Holds:
        """Return True if a wall without the non-linearities `taken` is stable in all hits; None if one is invalid."""
        unknown = False
        for number in range(len(self._experiments)):
            passes = self.passes(stiffness, number, taken)
            if passes is False:
                return False
            unknown |= passes is None
        return None if unknown else True


def hit_column(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Hit all walls of one sampling scheme and damping, softest first; return for each what theory and hits call it.

    `payload` has the experiments, the stiffness search and the criterion; `ComparedWall.of` reads the dicts.
    """
    experiments = [config.restore_experiment(one) for one in payload["experiments"]]
    column, first = _Column(experiments, payload["judged"]), experiments[0]
    rungs = StiffnessSearch(**payload["search"]).rungs
    radii = Lifted.of(linear_loop(first)).radius(rungs, first.wall.damping)
    rows: list[dict[str, Any]] = []
    for stiffness, radius in zip(rungs, radii.tolist(), strict=True):
        hits, ticks = column.hits, column.ticks
        linear, holds = radius < 1.0, column.holds(stiffness)
        found: tuple[Cure, ...] | None = None
        if holds is (not linear):
            found = cures(lambda taken, k=stiffness, says=linear: column.holds(k, taken) is says)  # type: ignore[misc]
        rows.append(
            {
                "stiffness": stiffness,
                "radius": radius,
                "holds": holds,
                "cures": found,
                "holds_without": column.passes(stiffness, 0, FOUR),
                "hits": column.hits - hits,
                "ticks": column.ticks - ticks,
            }
        )
    return rows
