"""One motion of a rig that nobody holds, as a recorded trial on an open device: its rows, every sample of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.analysis.identification.quality import IdentificationError
from rig.config import Experiment, controller
from rig.core.errors import PlanError
from rig.core.sample import Phase, RowFlag, unit_of
from rig.devices.framed import FramedDevice
from rig.experiments.identify_motions import Motion
from rig.experiments.trial import TrialRequest, prepared_on, run_trial
from rig.recording.data import Recording

LATE_SHARE = 0.01


def position_now(device: FramedDevice, x: Experiment, reference_count: int) -> float:
    """Where the handle is (rad or m); raises `PlanError` outside of its window."""
    at = controller.resolution(x) * (device.count() - reference_count)
    limits = x.rig.limits
    if not limits.position_minimum < at < limits.position_maximum:
        raise PlanError(
            f"the handle stands at {at:.4g} {unit_of('position', x.rig.motion)}, outside of its window",
            remedy="move it inside by hand",
        )
    return at


def run_motion(
    device: FramedDevice,
    motion: Motion,
    recording: Path,
    *,
    verified: bool,
    reference_count: int,
    extra: Mapping[str, Any],
) -> tuple[NDArray[np.void], Path]:
    """Run a motion, and return the rows of the trial proper, without a gap, and the sealed recording.

    Parameters
    ----------
    device
        Open, at rest.
    motion
        What moves, and under which limits.
    recording
        The capture to write; a file that does not exist.
    verified, reference_count
        As in `rig.experiments.hit.HitRequest`.
    extra
        For the recording's header.

    Raises
    ------
    IdentificationError
        Samples were lost or late, or the device overruled the law.
    RigError
        Whatever ended the trial early; the effort is zero.
    """
    x = motion.experiment
    run = prepared_on(
        device,
        x,
        verified=verified or device.dictionary.simulated,
        reference_count=reference_count,
        law=motion.law,
    )
    end = run_trial(device, TrialRequest(run=run, recording=recording, seed=x.trial.seed, extra=dict(extra)))
    assert end.sealed is not None
    return trial_rows(end.sealed), end.recording


def trial_rows(recording: Recording) -> NDArray[np.void]:
    """Rows of the trial proper.

    Raises `IdentificationError` when a tick is missing, too many were late, or the device overruled the law.
    """
    rows: NDArray[np.void] = recording.rows[recording.rows["phase"] == Phase.TRIAL]
    if len(rows) < 2 or np.any(np.diff(rows["sample_index"]) != 1):
        raise IdentificationError(
            f"{recording.path}: samples are missing in the motion",
            remedy="lower the rate, or use a better link: a fit needs every sample",
        )
    late = float(np.mean((rows["flags"] & RowFlag.LATE) != 0))
    if late > LATE_SHARE:
        raise IdentificationError(
            f"{recording.path}: {100 * late:.1f} % of the ticks were late",
            remedy="lower the rate, or free the computer of other work",
        )
    return rows
