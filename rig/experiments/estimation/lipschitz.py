"""From the recording of a hit to the constant C of Levant's differentiator."""

from __future__ import annotations

import numpy as np

from rig.control.estimators.lipschitz import DEFAULT_SINES, LipschitzFit, identify_lipschitz
from rig.core.errors import RecordingError
from rig.core.sample import Phase
from rig.recording.data import Recording

BEFORE_CONTACT_S, AFTER_CONTACT_S = 0.02, 0.06  # impact and first rebound: a long record drowns them


def lipschitz_of(
    recording: Recording,
    *,
    sines: int = DEFAULT_SINES,
    before_s: float = BEFORE_CONTACT_S,
    after_s: float = AFTER_CONTACT_S,
) -> LipschitzFit:
    """Fit a sum of sines to the measured position around the first contact (`rig.control.estimators.lipschitz`).

    Parameters
    ----------
    recording
        Recording of a hit. Only its measured position is used, so it may come from a real rig.
    sines
        How many; one more should change C little.
    before_s, after_s
        The stretch, from first contact (s); it ends where the trial ends.

    Raises
    ------
    RecordingError
        The handle never met the wall in a trial.
    ConfigError
        Too few samples for that many sines.
    """
    rows, time_s = recording.rows, recording.time_s
    trial = rows["phase"] == Phase.TRIAL
    contact = np.flatnonzero(trial & (rows["penetration"] > 0.0))
    if not len(contact):
        raise RecordingError("the recording has no contact", remedy="record a hit: `rig hit`")
    since_contact = time_s - time_s[contact[0]]
    chosen = trial & (since_contact >= -before_s) & (since_contact <= after_s)
    return identify_lipschitz(time_s[chosen], rows["position"][chosen].astype(np.float64), sines=sines)
