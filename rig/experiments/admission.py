"""Whether a wall may run at its rate, with its loop, on a device: one answer for `rig doctor`, gate and `rig hit`."""

from __future__ import annotations

from rig import config
from rig.config.controller import PreparedRun
from rig.core.check import Check, refused
from rig.core.same_rig import check_rig
from rig.devices.framed import FramedDevice
from rig.experiments.plan import device_checks, human_limit_checks, link_checks, plan_of


def admission_checks(run: PreparedRun, device: FramedDevice) -> list[Check]:
    """Return what decides whether a run may start on an open device, before its link is measured.

    The wall behind the measured link is judged by `rig.doctor.gate.gate`, which `rig doctor` and `rig hit` both
    call with these checks done.
    """
    x, dictionary = run.experiment, device.dictionary
    return [
        check_rig(config.rig_model(x), dictionary),
        *plan_of(run).checks,
        *device_checks(run, dictionary),
        *link_checks(x, dictionary.position_rate_maximum, device.link.bytes_per_second),
        *refused(human_limit_checks(x, real=not dictionary.simulated)),
    ]
