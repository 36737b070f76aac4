"""Checks of a computer that does not run Linux: it has no real-time loop, so the control law must run on the device."""

from rig.core.answers import question, warning
from rig.core.check import Check
from rig.core.this_system import ON_THE_BOARD
from rig.realtime.scheduling import RealtimeRequest


def machine_checks(host: RealtimeRequest | None = None) -> list[Check]:
    """Return one check, a warning that this computer has no real-time loop; `host` (scheduling) has no effect."""
    return [_real_time()]


@question("real time", "other programs can interrupt a loop on this computer for any time")
def _real_time() -> Check:
    return warning("no real-time loop on this computer: its system is not Linux", ON_THE_BOARD)
