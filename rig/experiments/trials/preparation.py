"""Prepare a run for an open device, for every trial: hits, motions, searches for a reference."""

from __future__ import annotations

from rig.config import Experiment, controller
from rig.config.prepared_run import PreparedRun
from rig.control.law import Law
from rig.core.this_system import refuse_real_time
from rig.devices.framed import FramedDevice


def prepared_on(
    device: FramedDevice,
    experiment: Experiment,
    *,
    verified: bool = False,
    reference_count: int = 0,
    law: Law | None = None,
) -> PreparedRun:
    """Prepare a run; see `rig.config.controller.prepared`.

    A reference count that is the device's own (`rig.experiments.motion.reference`) is marked as referenced. Raises
    `PlanError` for a law that this computer would have to run in real time, and cannot.
    """
    if experiment.controller.loop == "host" and not device.link.clock.virtual:
        if law is None:
            refuse_real_time('controller.loop = "host"')
        else:
            refuse_real_time("a motion or law that boards do not have", "do this on a Linux computer")
    return controller.prepared(
        experiment,
        current_quantum_a=device.dictionary.current_quantum_a,
        verified=verified,
        reference_count=reference_count,
        referenced=device.reference_count == reference_count,
        law=law,
    )
