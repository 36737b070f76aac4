"""Result of a design: best sampling schemes, the recommended one with its margin, and its ``[controller]`` section.

`_search` creates the result; commands, plots and the console show it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rig.config import Experiment
from rig.core.present import Item, Row, Table, plain, written
from rig.core.sample import unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments.design import _rules as rules
from rig.experiments.design._listing import Candidate, LawPlace
from rig.experiments.design._margin import Margin
from rig.experiments.design._rules import Comparison, Measures, Wishes
from rig.experiments.design._whole import Against
from rig.experiments.mapping.zwidth import Boundary

FITTED = "FITTED"  # how a rig's source says that its numbers were fitted on a paper's limits


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """A sampling scheme with its results in one round of the search, by simulated hits on the wall.

    Attributes
    ----------
    label
        Text for the legend of a plot.
    measures, shares
        Measures of the scheme, and for each requirement the reached fraction, 1 or more if it is met (`_rules`).
    boundary
        Limits of K at the dampings of the round; a passed wall is stable and has no ripple above the verdict's limits.
    stands_in
        True if linear theory replaced the sampling scheme's nonlinear estimator by a linear filter.
    """

    candidate: Candidate
    label: str
    measures: Measures
    shares: Mapping[str, float]
    boundary: tuple[Boundary, ...] = field(repr=False)
    stands_in: bool = False

    @property
    def capped(self) -> bool:
        """Return True if a stiffness limit is only a lower bound, because the stiffest tested wall was stable."""
        return any(one.capped for one in self.boundary)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Design(Shown, Drawn):
    """A finished design: the recommended sampling scheme of a rig, and the results on which the choice is based.

    Attributes
    ----------
    experiment, wishes, places
        Rig and trial, requirements on the scheme, and where the law may run (host, device), as requested.
    listed, kept
        Number of sampling schemes in linear theory, and in the first round of simulated hits.
    standings
        Schemes of the second round, all tested at the same walls; Pareto front and comparisons are computed from them.
    finalists
        Schemes of the last round, the best first.
    recommended, own
        Recommended scheme and the experiment's own scheme, with results of the last round.
    held_out
        Comparison of `recommended` and `own` on offsets and seeds that the search did not use; None if they are equal.
    margin
        Fraction of the recommended scheme's stiffness that remains on rigs that differ from the description.
    step
        Ratio between two stiffnesses in the second round, which is the accuracy of its limits.
    hits
        Number of hits in each stage, by the stage's name.
    against
        Comparison of each scheme of the rig's paper with all listed schemes; empty if it was not requested.
    """

    experiment: Experiment
    wishes: Wishes
    places: tuple[LawPlace, ...]
    listed: int
    kept: int
    standings: tuple[Standing, ...]
    finalists: tuple[Standing, ...]
    recommended: Standing
    own: Standing
    held_out: Comparison | None
    margin: Margin
    step: float
    hits: Mapping[str, int]
    against: tuple[Against, ...] = ()

    @property
    def front(self) -> list[Standing]:
        """Return the sampling schemes of the second search round that no other one dominates, the stiffest first."""
        chosen = [self.standings[i] for i in rules.front([one.measures for one in self.standings])]
        return sorted(chosen, key=lambda one: -one.measures.stiffness)

    @property
    def as_good(self) -> list[Standing]:
        """Return schemes whose K at B = 0, peak K and range of B each reach those of the experiment's own scheme."""
        own = self._own_before.measures
        return [
            one
            for one in self.standings
            if one is not self._own_before and rules.as_good(one.measures, own, self.step)
        ]

    @property
    def _own_before(self) -> Standing:
        return next(one for one in self.standings if one.candidate.key == self.own.candidate.key)

    @property
    def fitted(self) -> bool:
        """Return True if the rig's parameters were fitted to stiffness limits that a paper reports."""
        return FITTED in self.experiment.rig.source

    def toml(self) -> str:
        """Return the recommended ``[controller]`` section as TOML text, with goal and margin as comments."""
        applied = self.recommended.candidate.applied(self.experiment).controller
        lines = [
            "# Found by rig design on simulated hits: " + self._goal_text(),
            f"# {self._margin_text()}",
            "[controller]",
            f"position_rate = {applied.position_rate}",
            f"velocity_rate = {applied.velocity_rate}",
            f'estimator = "{applied.estimator}"',
            f'prediction = "{applied.prediction}"',
            f'loop = "{applied.loop}"',
            "",
            "[controller.parameters]",
        ]
        for name, value in applied.parameters.items():
            lines.append(f"{name} = " + (f'"{value}"' if isinstance(value, str) else f"{float(value)!r}"))
        return "\n".join(lines) + "\n"

    def brief(self) -> list[Item]:
        """Return the lines of a short report: recommended scheme, gain over the experiment's scheme, and robustness."""
        return [
            f"design of {self.experiment.rig.name}: {self.recommended.label}",
            Row("goal", self._goal_text()),
            Row("on new seeds", self._held_out_text()),
            *([Row("as good", self._as_good_text())] if not self.against else []),
            *(Row("the paper's", one.text) for one in self.against),
            Row("margin", self._margin_text()),
            *([Row("fitted", self.experiment.rig.source)] if self.fitted else []),
            Row(
                "looked at",
                f"{self.listed} schemes by theory, {self.kept} by hits ({sum(self.hits.values())})",
            ),
        ]

    def detailed(self) -> list[Item]:
        """Return the lines of a full report: the short report, tables of the Pareto front and of the last schemes."""
        return [
            *self.brief(),
            *self.against_tables(),
            self.table("front", self.front),
            self.table("last round", self.finalists),
        ]

    def against_tables(self) -> list[Table]:
        """Return a table for each sampling scheme of the paper; it compares the best listed scheme with this scheme."""
        return [one.table(self.experiment.rig.motion) for one in self.against]

    def table(self, caption: str, standings: Sequence[Standing]) -> Table:
        """Return a table titled `caption` with a row per scheme: stiffness, damping, noise, fidelity and cost."""
        unit = self._unit
        head = (
            "scheme",
            f"K at B = 0 ({unit('stiffness')})",
            "K peak",
            f"B range ({unit('damping')})",
            "area",
            f"noise ({unit('velocity')})",
            "faithful to (Hz)",
            "cost",
        )
        rows = [
            (
                one.label + (", on the device" if one.candidate.loop == "device" else ""),
                *(
                    written(value, 3) if value is not None else "–"
                    for value in (
                        one.measures.undamped,
                        one.measures.stiffness,
                        one.measures.damping,
                        one.measures.area,
                        one.measures.noise,
                        one.measures.fidelity_hz,
                        one.measures.cost,
                    )
                ),
            )
            for one in standings
        ]
        return Table(head, rows, caption)

    def margin_table(self, most: int | None = None) -> Table:
        """Return a table of the stiffness left on the worst sampled rig, and after the `most` worst single changes."""
        margin = self.margin
        rows = [
            (
                left.change,
                f"{'≥ ' if left.capped else ''}{left.share:.0%}",
                "–" if left.theory is None else f"{left.theory:.0%}",
            )
            for left in (margin.worst, *margin.alone[:most])
        ]
        wall = f"K {'≥' if margin.capped else '='} {margin.stiffness:.4g} at B = {margin.damping:.3g}"
        caption = f"remaining margin of {wall}: in the worst sample, then with one change at a time"
        return Table(("change", "left", "by linear theory"), rows, caption)

    def as_mapping(self) -> dict[str, Any]:
        """Return all results of the search for a sampling scheme as JSON values by name."""

        def as_facts(one: Standing) -> dict[str, Any]:
            return {
                "scheme": one.candidate.scheme.text,
                "loop": one.candidate.loop,
                "delay_ticks": one.candidate.delay_ticks,
                "label": one.label,
                "measures": plain(one.measures),
                "shares": plain(one.shares),
                "capped": one.capped,
                "curve": [[b.damping, b.stiffness, b.lowest, b.highest] for b in one.boundary],
            }

        held_out = None
        if self.held_out is not None:
            mean, low, high = self.held_out.interval
            held_out = plain(self.held_out) | {
                "mean": mean,
                "low": low,
                "high": high,
                "no_worse": self.held_out.no_worse,
                "better": self.held_out.better,
            }
        return {
            "rig": self.experiment.rig.name,
            "fitted": self.fitted,
            "wishes": plain(self.wishes),
            "places": plain(self.places),
            "listed": self.listed,
            "kept": self.kept,
            "recommended": as_facts(self.recommended),
            "own": as_facts(self.own),
            "held_out": held_out,
            "margin": plain(self.margin),
            "front": [as_facts(one) for one in self.front],
            "as_good": [one.candidate.scheme.text for one in self.as_good],
            "standings": [as_facts(one) for one in self.standings],
            "finalists": [as_facts(one) for one in self.finalists],
            "hits": dict(self.hits),
            "against": [one.as_mapping() for one in self.against],
            "toml": self.toml(),
        }

    def _unit(self, quantity: str) -> str:
        return unit_of(quantity, self.experiment.rig.motion)

    def _goal_text(self) -> str:
        goal = self.wishes.goal
        if goal == "quiet":
            values = [one.measures.noise for one in (self.recommended, self.own)]
            name, unit = "noise at rest", self._unit("velocity")
        else:
            values = [getattr(one.measures, goal) for one in (self.recommended, self.own)]
            unit = {"stiffness": self._unit("stiffness"), "damping": self._unit("damping")}.get(goal, "")
            name = {
                "stiffness": "stiffest wall",
                "damping": "range of damping",
                "area": "area of the K–B plane",
            }[goal]
        found, own = (f"{written(value)} {unit}".rstrip() for value in values)
        return f"{name} {found}, the experiment's own scheme {own}"

    def _held_out_text(self) -> str:
        if self.held_out is None:
            return "the experiment's own scheme is the recommended one"
        mean, low, high = self.held_out.interval
        shown = (
            "better"
            if self.held_out.better
            else "no worse"
            if self.held_out.no_worse
            else "not shown to be no worse"
        )
        return f"{rules.measure_of(self.wishes.goal)} {mean:+.1%} ({low:+.1%} to {high:+.1%}): {shown}"

    def _as_good_text(self) -> str:
        others = f"{len(self.standings) - 1} others of the second round"
        measures = "the experiment's own scheme in K at B = 0, peak and range of B, each"
        if not self.as_good:
            return f"none of the {others} reaches {measures}, to a rung of {self.step - 1.0:.0%}"
        keys = {one.candidate.key for one in self.as_good}
        among = "" if self.recommended.candidate.key not in keys else ", the recommended one among them"
        return f"{len(keys)} of the {others} reach {measures}{among}"

    def _margin_text(self) -> str:
        margin = self.margin
        first = margin.spoils_first
        alone = f"{'≥ ' if first.capped else ''}{first.share:.0%}"
        if first.capped and first.theory is not None:
            alone += f" ({first.theory:.0%} by linear theory: the push is too weak to make a wall fail)"
        return (
            f"at B = {margin.damping:.3g} "
            f"{'≥ ' if margin.worst.capped else ''}{written(margin.secured, 3)} of "
            f"{'≥ ' if margin.capped else ''}{written(margin.stiffness, 3)} {self._unit('stiffness')} "
            f"remain on the worst of {margin.samples} rigs within 20 %, {margin.worst.change}; most "
            f"sensitive to {first.change}, which alone leaves {alone}"
        )
