"""Which experiment is in effect on a device: what the user says, then what real time asks for, then the file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rig import config
from rig.config import Experiment
from rig.devices.framed import FramedDevice

RATES = ("controller.position_rate", "controller.velocity_rate")


def in_effect(experiment: Experiment, device: FramedDevice, changes: Mapping[str, Any]) -> Experiment:
    """Return the experiment as it runs on this device: in real time its gentler variant at the device's own rate.

    `changes` are the keys that the user set by hand; they win over everything else.
    """
    if device.link.clock.virtual:
        return config.override(experiment, changes)
    gentler: dict[str, Any] = dict(experiment.realtime)
    if not any(key in changes for key in RATES):
        gentler.update(dict.fromkeys(RATES, device.dictionary.position_rate_default))
    return config.override(experiment, {**gentler, **changes}, "real time and command line")
