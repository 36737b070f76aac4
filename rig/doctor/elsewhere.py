"""Doctor's report on a computer without Linux: a law in real time must run on the device there."""

from __future__ import annotations

from rig.core.answers import question, warning
from rig.core.check import Check
from rig.core.this_system import ON_THE_BOARD
from rig.realtime.scheduling import RealtimeRequest


def machine_checks(host: RealtimeRequest | None = None) -> list[Check]:
    """As `rig.doctor.machine.machine_checks`."""
    return [_real_time()]


@question("real time", "other programs may stop a loop of this computer for as long as they like")
def _real_time() -> Check:
    return warning("no loop of this computer runs in real time: it is not Linux", ON_THE_BOARD)
