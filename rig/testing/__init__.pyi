"""What a lab's own tests use; the module's own text explains it."""

from rig.testing.asserts import assert_limit as assert_limit
from rig.testing.asserts import assert_passive as assert_passive
from rig.testing.asserts import assert_safe as assert_safe
from rig.testing.asserts import assert_stable as assert_stable
from rig.testing.estimators import check_estimator as check_estimator
from rig.testing.estimators import velocities as velocities
from rig.testing.every_frame import with_every_frame as with_every_frame
from rig.testing.experiments import Experiments as Experiments
from rig.testing.fault_words import FaultWords as FaultWords
from rig.testing.golden import Golden as Golden
from rig.testing.hits import Hit as Hit
from rig.testing.hits import Hits as Hits
from rig.testing.hits import Rigs as Rigs
from rig.testing.kept import Kept as Kept
from rig.testing.kept import tidy as tidy
from rig.testing.laws import check_law as check_law
from rig.testing.laws import reactions as reactions
from rig.testing.maps import Maps as Maps
from rig.testing.served import SerialRig as SerialRig
from rig.testing.served import serve_rig as serve_rig
