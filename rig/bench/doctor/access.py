"""Ports: who may open them, and which other programs do."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rig.bench.doctor.finding import Finding
from rig.bench.doctor.subject import Machine, ok, problem, warning
from rig.realtime.scheduling.facts import text_of
from rig.realtime.scheduling.refusals import RULES_COMMAND, RULES_FILE
from rig.realtime.scheduling.rights import name_of_group

PORTS = ("ttyACM*", "ttyUSB*", "ttyAMA*")
GROUPS = ("dialout", "uucp")  # Debian and Fedora, Arch
RULES_PLACES = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")


def serial_ports(machine: Machine) -> Finding:
    """Whether this user may open the serial ports that are here, or those that will be."""
    name, why = "serial ports", "without permission to open its port there is no rig"
    ports = sorted(path for pattern in PORTS for path in (machine.root / "dev").glob(pattern))
    closed = [path for path in ports if not machine.openable(path)]
    if not ports:
        return _future_ports(machine, name, why)
    if not closed:
        return ok(name, f"{', '.join(path.name for path in ports)} may be opened", why)
    group = name_of_group(closed[0].stat().st_gid)
    text = f"{', '.join(path.name for path in closed)} may not be opened by {machine.rights.user}"
    if group == "root":
        return problem(name, f"{text}: they belong to root alone", why, RULES_COMMAND)
    return _group_missing(machine, group, f"{text}, who is not in group {group}", name, why)


def _future_ports(machine: Machine, name: str, why: str) -> Finding:
    group = next((group for group in GROUPS if group in _groups(machine)), None)
    if group is None or machine.rights.user == "root" or group in machine.rights.groups:
        return ok(name, "none are here", why)
    text = f"none are here, and {machine.rights.user} is not in group {group}, which will own them"
    found = _group_missing(machine, group, text, name, why)
    return warning(name, found.text, why, found.command)


def _group_missing(machine: Machine, group: str, text: str, name: str, why: str) -> Finding:
    user = machine.rights.user
    if user in _groups(machine).get(group, ()):
        return problem(name, f"{text} in this session, but will be: log in again", why)
    return problem(name, f"{text} (after the command: log in again)", why, f"sudo usermod -aG {group} {user}")


def _groups(machine: Machine) -> dict[str, list[str]]:
    """Return the members of each group of /etc/group."""
    lines = (line.split(":") for line in text_of(machine.root / "etc/group").splitlines())
    return {parts[0]: parts[3].split(",") for parts in lines if len(parts) > 3}


def udev_rules_present(machine: Machine) -> Finding:
    """Whether the rules for rigs are installed."""
    why = "they name the rig's port after its serial number, give it to you, and keep other programs from it"
    path = machine.root / RULES_FILE.lstrip("/")
    if path.exists() or any("haptic-rig" in rules.name for rules in _rules(machine)):
        return ok("udev rules", "they are installed", why)
    return warning("udev rules", f"there is no {RULES_FILE}", why, RULES_COMMAND)


def modem_manager(machine: Machine) -> Finding:
    """Whether a program that looks for modems would open the port first."""
    name, why = (
        "ModemManager",
        "it opens every new serial port and sends modem commands for up to half a minute",
    )
    if not running(machine.root, "ModemManager"):
        return ok(name, "it does not run", why)
    ignoring = (rules for rules in _rules(machine) if "haptic-rig" in rules.name)
    if any("ID_MM_DEVICE_IGNORE" in text_of(rules) for rules in ignoring):
        return ok(name, "it runs, and is told to leave rigs alone", why)
    return warning(name, "it runs, and nothing tells it to leave rigs alone", why, RULES_COMMAND)


def brltty(machine: Machine) -> Finding:
    """Whether a program for braille displays would take the adapter."""
    name, why = (
        "brltty",
        "it takes some serial adapters (CH340, CP210x, FTDI) for braille displays and keeps them",
    )
    rules = [rules.name for rules in _rules(machine) if "brltty" in rules.name]
    if not running(machine.root, "brltty") and not rules:
        return ok(name, "it is not here", why)
    text = "it is here, and not needed unless a braille display is in use"
    return warning(name, text, why, "sudo systemctl mask --now brltty.service brltty-udev.service")


def running(root: Path, program: str) -> bool:
    """Whether a program runs, by the name that the kernel keeps of it."""
    return any(text_of(path) == program for path in (root / "proc").glob("[0-9]*/comm"))


def _rules(machine: Machine) -> Iterator[Path]:
    """Each file of udev rules; a mask (a link to /dev/null) is none."""
    for place in RULES_PLACES:
        for path in (machine.root / place).glob("*.rules"):
            if path.resolve() != Path("/dev/null"):
                yield path
