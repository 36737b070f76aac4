"""Everything about this computer that decides how well the loop runs."""

from __future__ import annotations

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
    """Run all checks, and measure wake-ups.

    Parameters
    ----------
    host
        What an experiment requests (``experiment.host``); the defaults when left out.
    machine
        What to examine instead of this machine; it brings its own `host`.
    seconds
        How long wake-ups are measured; not at all when 0.
    """
    machine = machine or Machine(request=host or Host())
    checks = [check(machine) for check in CHECKS]
    if seconds > 0:
        checks.append(wake_up.judge(wake_up.measure(machine.request, seconds)))
    return checks
