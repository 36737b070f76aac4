"""Which rates, estimator and filter suit a rig: a search through a listed set of schemes, for stated wishes.

First all of the set by linear theory, with delay (`_linear`); then simulated hits of the best, on coarse rungs first,
halved from round to round (`_rounds`); then the one that is recommended again, on encoder offsets and seeds that the
search did not see, and on rigs that differ from the described one (`_margin`). What is measured, and what best, no
worse and margin mean, was written before any result (`_rules`).

`rig design` and ``rig.design`` call it, and pictures draw the result. It must not move a rig: of a device that is named
it measures the link alone.
"""

from rig.experiments.design import _rules as rules
from rig.experiments.design._device import places_of
from rig.experiments.design._linear import STAGE
from rig.experiments.design._listing import Candidate, LawPlace, listed, places_for
from rig.experiments.design._result import Design, Standing
from rig.experiments.design._rules import GOALS, Goal, Measures, UnmetError, Wishes
from rig.experiments.design._search import DesignRequest, design, directory_for
from rig.experiments.design._whole import Against

RULES = rules.__doc__ or ""

__all__ = [
    "GOALS",
    "RULES",
    "STAGE",
    "Against",
    "Candidate",
    "Design",
    "DesignRequest",
    "Goal",
    "LawPlace",
    "Measures",
    "Standing",
    "UnmetError",
    "Wishes",
    "design",
    "directory_for",
    "listed",
    "places_for",
    "places_of",
]
