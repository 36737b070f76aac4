"""Checks of a computer without Linux, on which a real-time law must run on the device."""

from __future__ import annotations

from rig.core.answers import question, warning
from rig.core.check import Check
from rig.core.this_system import ON_THE_BOARD
from rig.realtime.scheduling import RealtimeRequest


def machine_checks(host: RealtimeRequest | None = None) -> list[Check]:
    """Return the checks of a machine without Linux; counterpart of `rig.doctor._machine.machine_checks`."""
    return [_real_time()]


@question("real time", "other programs can interrupt a loop on this computer for any time")
def _real_time() -> Check:
    return warning("no real-time loop on this computer: its system is not Linux", ON_THE_BOARD)
