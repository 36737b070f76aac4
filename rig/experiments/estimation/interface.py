"""Re-export the public names of this package: compare, score and tune velocity estimators, and export them as C.

Commands, plots and papers import this module. It defines nothing, and no file of this package imports it, so that a
Lipschitz constant alone (`rig.lipschitz_of`) does not import the export of estimators.
"""

from rig.experiments.estimation._estimator_export import export_estimator
from rig.experiments.estimation._signals import SIGNALS
from rig.experiments.estimation.cases import Case, recording_case, signal_case
from rig.experiments.estimation.estimators import (
    EstimatorComparison,
    Score,
    Variant,
    compare_estimators,
    delay,
    estimates,
    rest_noise,
    score,
)
from rig.experiments.estimation.lipschitz import (
    AFTER_CONTACT_S,
    BEFORE_CONTACT_S,
    identify_lipschitz,
    lipschitz_of,
)
from rig.experiments.estimation.tuning import Tuning, shown_range, tune_estimator

__all__ = [
    "AFTER_CONTACT_S",
    "BEFORE_CONTACT_S",
    "SIGNALS",
    "Case",
    "EstimatorComparison",
    "Score",
    "Tuning",
    "Variant",
    "compare_estimators",
    "delay",
    "estimates",
    "export_estimator",
    "identify_lipschitz",
    "lipschitz_of",
    "recording_case",
    "rest_noise",
    "score",
    "shown_range",
    "signal_case",
    "tune_estimator",
]
