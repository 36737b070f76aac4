"""Define the request of a map of hits: options of the command `rig zwidth` and fields of the console's page.

Texts are lists or ranges of numbers (`rig.experiments.mapping._searches.numbers_of`); an empty text selects the
default.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Le, MaxLen

from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.keyword import Keyword
from rig.experiments.mapping._ranges import hit_plan, schemes_for, search_for
from rig.experiments.mapping._searches import Way, bounds_of, numbers_of
from rig.experiments.mapping.zwidth import MapPlan

Text = Annotated[str, MaxLen(4096)]  # a page sends it


@dataclass(frozen=True, kw_only=True)  # without slots: a page's request inherits from another class, too
class MapRequest:
    """A request to find stable walls by hits: ranges of walls, sampling schemes, search method and judged signals."""

    stiffness: Annotated[
        Text,
        Keyword(
            "Range of stiffness. [up to where the push rests trial.minimum_rest_counts deep]",
            "",
            ("-K", "--stiffness"),
            "Experiment",
            metavar="FROM:TO",
        ),
    ] = ""
    damping: Annotated[
        Text,
        Keyword(
            "Dampings. [17, to beyond the limit of the linear theory]",
            "",
            ("-B", "--damping"),
            "Experiment",
            metavar="B,…|FROM:TO:N",
        ),
    ] = ""
    schemes: Annotated[
        tuple[Text, ...],
        MaxLen(32),
        Keyword(
            "dual:20k/2k; uniform:20k,cutoff_hz=1000; dual:20k/2k,estimator=kalman …; repeat it. [the experiment's "
            "and the uniform ones of its rates; at B = 0 uniform ones, 100 Hz to 50 kHz]",
            "",
            ("--scheme",),
            "Experiment",
            "scheme",
            "SCHEME",
        ),
    ] = ()
    way: Annotated[Way, Keyword("Method of the search for K.", names=("--search",))] = "ladder"
    ratio: Annotated[float, Keyword("Ratio between two stiffnesses.")] = 1.06
    offsets: Annotated[
        Text, Keyword("Offsets of position zero within an encoder count (count). [0.1,0.6; on a device one]")
    ] = ""
    repeats: Annotated[int, Ge(1), Le(10_000), Keyword("Repeats of each series.", group="Experiment")] = 1
    judged: Annotated[
        Literal["true", "recorded"] | None,
        Keyword(
            "Signals that are judged: those that a rig records, or the true ones of the simulation. "
            "[recorded]",
            names=("--judge",),
        ),
    ] = None

    def plan(self, experiment: Experiment, *, on_device: bool = False) -> MapPlan:
        """Return the plan of a map of stable walls for `experiment`; raise `PlanError` if a range is invalid."""
        dampings = numbers_of(self.damping, "`damping`") if self.damping else None
        parsed = [Scheme.parse(text) for text in self.schemes]
        schemes = schemes_for(experiment, parsed, dampings, on_device=on_device)
        low, high = bounds_of(self.stiffness, "`stiffness`") if self.stiffness else (None, None)
        search = search_for(
            experiment,
            self.way,
            ratio=self.ratio,
            lowest=low,
            highest=high,
            schemes=schemes,
            on_device=on_device,
        )
        return hit_plan(
            experiment,
            schemes,
            dampings=dampings,
            search=search,
            offsets=numbers_of(self.offsets, "`offsets`") if self.offsets else None,
            repeats=self.repeats,
            judged=self.judged,
            on_device=on_device,
        )
