"""Run all checks of this computer (Linux) that concern the real-time loop's timing or the access to ports."""

import sys
from collections.abc import Callable

from rig.config import Host
from rig.core.check import Check
from rig.doctor import _access as access
from rig.doctor import _kernel as kernel
from rig.doctor import _limits as limits
from rig.doctor import _wake_up as wake_up
from rig.realtime.scheduling import RealtimeRequest

if sys.platform == "linux":
    from rig.doctor._subject import Machine

# `rig.doctor.interface` imports this file on Linux only; elsewhere mypy skips it from here on.
assert sys.platform == "linux"

CHECKS: tuple[Callable[[Machine], Check], ...] = (
    limits.priority,
    limits.memory,
    limits.idle_states,
    limits.swap,
    limits.real_time_share,
    kernel.preemption,
    kernel.timer,
    kernel.clock,
    kernel.governor,
    kernel.isolation,
    kernel.virtual_machine,
    access.serial_ports,
    access.udev_rules_present,
    access.modem_manager,
    access.brltty,
)


def machine_checks(
    host: RealtimeRequest | None = None, *, machine: Machine | None = None, seconds: float = 1.0
) -> list[Check]:
    """Run all checks of a computer and measure the wake-up latency of its threads.

    Parameters
    ----------
    host
        Scheduling that an experiment requests (``experiment.host``); default settings if None.
    machine
        Computer to examine, for tests a directory tree with simulated /proc and /sys; None examines this computer. If
        given, `host` has no effect, because a machine contains its own request.
    seconds
        Duration of the wake-up measurement (s); 0 skips the measurement.
    """
    machine = machine or Machine(request=host or Host())
    checks = [check(machine) for check in CHECKS]
    if seconds > 0:
        checks.append(wake_up.judge(wake_up.measure(machine.request, seconds)))
    return checks
