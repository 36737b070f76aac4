"""The experiment that is in effect on a device: the user's changes, then those of real time, then the file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rig import config
from rig.config import Experiment
from rig.devices.framed import FramedDevice

RATES = ("controller.position_rate", "controller.velocity_rate")


def in_effect(experiment: Experiment, device: FramedDevice, changes: Mapping[str, Any]) -> Experiment:
    """Return the experiment as it runs on this device: in real time its gentler variant at the device's own rate.

    `changes` are the keys that the user set by hand; they win over everything else. Where the law runs on the device
    itself, rates and wall are the experiment's.
    """
    if device.link.clock.virtual:
        return config.override(experiment, changes)
    wanted = config.realtime_changes(experiment, changes)
    on_the_host = wanted.get("controller.loop", experiment.controller.loop) == "host"
    if on_the_host and not any(key in changes for key in RATES):
        wanted |= dict.fromkeys(RATES, device.dictionary.position_rate_default)
    return config.override(experiment, wanted, "real time and command line")
