"""Everything about this computer that decides how well the loop runs; the link is another matter."""

from __future__ import annotations

from collections.abc import Callable

from rig.bench.doctor import access, kernel, limits, wake_up
from rig.bench.doctor.finding import Finding
from rig.bench.doctor.subject import Machine
from rig.bench.doctor.udev import udev_rules
from rig.config.sections import Host
from rig.realtime.scheduling import Request

__all__ = ["CHECKS", "machine_checks", "udev_rules"]

CHECKS: tuple[Callable[[Machine], Finding], ...] = (
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
    host: Request | None = None, *, machine: Machine | None = None, seconds: float = 1.0
) -> list[Finding]:
    """Look at everything, and measure wake-ups.

    Parameters
    ----------
    host
        What an experiment asks for (``experiment.host``); left out: the defaults.
    machine
        What to look at instead of this machine; it brings its own `host`.
    seconds
        How long wake-ups are measured; 0: not at all.
    """
    machine = machine or Machine(request=host or Host())
    findings = [check(machine) for check in CHECKS]
    if seconds > 0:
        findings.append(wake_up.finding_of(wake_up.measure(machine.request, seconds)))
    return findings
