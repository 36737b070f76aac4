"""Check a protocol on a device before a session: the device can run the conditions and walls, and loses few samples.

`rig session check` with a device calls it. It must not move the motor.
"""

from contextlib import closing

from rig.core.check import Check, refused
from rig.session.engine._arming import arming_checks
from rig.session.engine._fitting import fit_checks
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._pace import pace_checks
from rig.session.planning._conditions import Walls


def device_checks(url: str, walls: Walls) -> list[Check]:
    """Return checks that the device at `url` can run all walls of a study, without motion, and loses few samples.

    Raise `RigError` if it cannot be opened.
    """
    with closing(DeviceRunner(url=url, realtime=True, verified=True)) as runner:
        fits = fit_checks(walls, runner)
        checks = [*fits, *arming_checks(walls, runner)]
        return checks if refused(fits) else [*checks, *pace_checks(walls, runner)]
