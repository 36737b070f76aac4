"""A trial on an open device from an experiment, the usual start of a test."""

from pathlib import Path
from typing import Any

from rig.config import Experiment
from rig.control.law import Law
from rig.core.sample import RowFlag
from rig.devices.framed import FramedDevice
from rig.experiments.trials._trial import TrialEnd, TrialRequest, run_trial
from rig.experiments.trials.preparation import prepared_on

# Flags that a sensor of the current sets: a trial without bytes has none.
CURRENTS = int(RowFlag.CURRENT_FOLLOWS | RowFlag.CURRENT_DIFFERS | RowFlag.OTHER_CURRENT)


def trial_on(
    device: FramedDevice,
    experiment: Experiment,
    recording: Path,
    *,
    verified: bool = True,
    reference_count: int = 0,
    law: Law | None = None,
    seed: int = 0,
    **options: Any,
) -> TrialEnd:
    """Prepare a run of this experiment and run it as one trial; `options` are those of `TrialRequest`."""
    run = prepared_on(device, experiment, verified=verified, reference_count=reference_count, law=law)
    return run_trial(device, TrialRequest(run=run, recording=recording, seed=seed, **options))
