"""The Lipschitz constant C of a simulated wall hit: the fitted value against the motion of the plant."""

from typing import Any

import numpy as np
import pytest

from rig.config import presets
from rig.core.errors import RecordingError
from rig.core.sample import Phase
from rig.experiments.estimation.lipschitz import lipschitz_of
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Record hits of chawda-linear at 0.10 and 0.16 m/s, 1 kHz."""
    found = []
    for effort, start in ((5.0, -0.0007), (8.0, -0.001)):
        changes = {"trial.effort": effort, "trial.start": start}
        request = HitRequest(
            experiment=presets.load("chawda-linear"), changes=changes, output=tmp_path_factory.mktemp("hits")
        )
        found += [result.recording for result in hit(request, admit)]
    return found


def test_the_constant_is_the_acceleration_of_the_plant_within_a_tenth(recordings: Any) -> None:
    for recording in recordings:
        rows, time_s = recording.rows, recording.time_s
        fit = lipschitz_of(recording)
        shown = (time_s >= fit.time_s[0]) & (time_s <= fit.time_s[-1])
        true = np.abs(np.gradient(rows["velocity_true"], time_s))[shown].max()
        assert fit.lipschitz == pytest.approx(true, rel=0.1)


def test_a_recording_without_contact_has_no_hit_to_fit(recordings: Any) -> None:
    recording = recordings[0]
    homing = recording.rows["phase"] != Phase.TRIAL
    before = type(recording)(recording.header, recording.rows[homing])
    with pytest.raises(RecordingError, match="no contact"):
        lipschitz_of(before)
