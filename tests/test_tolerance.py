"""A real-time test of an emulated system that lost its device on a busy machine says where it did."""

import numpy as np
import pytest

from rig.core.sample import Phase
from rig.recording.data import Recording
from tests.conformance.tolerance import reason_of


def test_a_lost_device_is_reported_with_its_place_in_the_run() -> None:
    rows = np.zeros(3, [("phase", "u1"), ("device_time", "<i8")])
    rows["device_time"] = [0, 1_000_000, 42_000_000]
    rows["phase"] = Phase.HOMING
    trailer = {"reason": "link_silent", "error": "no valid command arrived"}
    with pytest.raises(
        pytest.skip.Exception, match=r"arrived; after 3 rows, in homing; at most 41\.0 ms .* row 1"
    ):
        reason_of(Recording({}, rows, trailer, complete=True))
