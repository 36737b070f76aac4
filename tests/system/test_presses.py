"""No check of the device takes a person who presses on a stiff wall, still or trembling, for a fault."""

import itertools

import pytest

from firmware_protocol.faults import LimitFlag
from rig import config
from rig.analysis import theory
from rig.config import presets
from rig.core.errors import GuardError
from rig.core.operators import GRIPS
from rig.testing import Hits
from tests.conformance.tiers import first_by_default

PERSON = config.override(
    presets.load("koul-compliant"),
    {
        "trial.kind": "human",
        "rig.limits.human": True,
        "rig.limits.effort": 0.28,
        "operator.press": 2.0,
        "controller.position_rate": 2_000,
        "controller.velocity_rate": 2_000,
        "trial.duration_s": 1.2,
        "trial.release_s": 0.05,
    },
)
MODULATIONS = (0.0, 0.01, 0.2)
TREMORS = (0.0, GRIPS["firm"].tremor)  # m rms: none, and most of a hand


@pytest.fixture(scope="module")
def limit() -> float:
    """Return the stiffness at which linear theory predicts that the wall is unstable in this hand (N·m/rad)."""
    return float(theory.k_max(PERSON, operator=PERSON.operator.grip).stiffness)


@pytest.mark.parametrize("share", first_by_default([0.3, 1.0]))
def test_a_still_press_is_no_fault(share: float, limit: float, rig_hit: Hits) -> None:
    for modulation, tremor in itertools.product(MODULATIONS, TREMORS):
        changes = {
            "wall.stiffness": share * limit,
            "operator.press_modulation": modulation,
            "operator.tremor": tremor,
        }
        hit = rig_hit(PERSON, changes, may_end=True)  # a wall at its limit may oscillate
        assert hit.error is None or isinstance(hit.error, GuardError), "a fault of the device would be none"
        rows = hit.recording.rows
        assert not rows["fault"].any(), (modulation, tremor)
        assert not (rows["limits"] & LimitFlag.NOT_CONFIRMED).any(), (modulation, tremor)
        assert (rows["penetration"] > 0.0).any(), "it pressed"
