"""What a device says of a protocol before a session: whether it fits, arms these walls, and keeps up."""

from __future__ import annotations

from contextlib import closing

from rig.core.check import Check, refused
from rig.session.engine._arming import arming_checks
from rig.session.engine._fitting import fit_checks
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._pace import pace_checks
from rig.session.planning._conditions import Walls


def device_checks(url: str, walls: Walls) -> list[Check]:
    """Ask the device behind a URL, as a session with a person has it; nothing moves on it.

    Raises `rig.core.errors.RigError` for one that does not open.
    """
    with closing(DeviceRunner(url=url, realtime=True, verified=True)) as runner:
        fits = fit_checks(walls, runner)
        checks = [*fits, *arming_checks(walls, runner)]
        return checks if refused(fits) else [*checks, *pace_checks(walls, runner)]
