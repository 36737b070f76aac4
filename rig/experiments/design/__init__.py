"""Find rates, estimator and filter for a rig: search a set of sampling schemes for the one that best meets wishes.

Stages: linear theory with delay for the whole set (`_linear`); rounds of simulated hits on the wall, each with fewer
schemes and finer steps (`_rounds`); hits of the recommended scheme on encoder offsets and seeds that the search did not
use, and on rigs that differ from the described rig (`_margin`). The measures and the criteria "best", "no worse" and
"margin" were defined before any result was computed (`_rules`).

`rig design` and ``rig.design`` call this package, and plots draw the result. It must not move a rig; of a given device
it only measures the link.
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
