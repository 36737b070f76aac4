"""Everything about this computer that decides how well the loop runs; the link is another matter."""

from __future__ import annotations

from collections.abc import Callable

from rig.doctor import access, kernel, limits
from rig.doctor.finding import Finding
from rig.doctor.subject import Machine

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


def machine_checks(machine: Machine | None = None, *, seconds: float = 1.0) -> list[Finding]:
    """Look at everything, and measure wake-ups.

    Parameters
    ----------
    machine
        What to look at, with what ``experiment.host`` asks; left out: this machine, asked as by default.
    seconds
        How long wake-ups are measured; 0: not at all.
    """
    machine = machine or Machine()
    findings = [check(machine) for check in CHECKS]
    if seconds > 0:
        from rig.doctor import wake_up  # noqa: PLC0415  (numba only when something is measured)

        findings.append(wake_up.finding_of(wake_up.measure(machine.request, seconds)))
    return findings
