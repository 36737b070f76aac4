"""What a lab's own tests call: conformance of laws and estimators, and hits with faults in pytest."""

from rig.testing.estimators import check_estimator as check_estimator
from rig.testing.estimators import velocities as velocities
from rig.testing.laws import check_law as check_law
from rig.testing.laws import reactions as reactions
