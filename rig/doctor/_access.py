"""Check whether this user may open serial ports, and whether other programs would open a rig's port."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from rig.core.answers import ok, question, refused, warning
from rig.core.check import Check, Outcome
from rig.realtime.scheduling.facts import text_of
from rig.realtime.scheduling.refusals import LOG_IN_AGAIN, RULES_COMMAND, RULES_FILE

if sys.platform == "linux":
    from rig.doctor._subject import Machine
    from rig.realtime.scheduling import name_of_group

# `rig.doctor.interface` imports this file on Linux only; elsewhere mypy skips it from here on.
assert sys.platform == "linux"

PORTS = ("ttyACM*", "ttyUSB*", "ttyAMA*")
GROUPS = ("dialout", "uucp")  # Debian and Fedora, Arch
RULES_PLACES = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")


@question("serial ports", "the user must be allowed to open the rig's port")
def serial_ports(machine: Machine) -> Check:
    """Check that this user may open each serial port; without a port, that the user is in the group that owns ports."""
    ports = sorted(path for pattern in PORTS for path in (machine.root / "dev").glob(pattern))
    closed = [path for path in ports if not machine.openable(path)]
    if not ports:
        return _future_ports(machine)
    if not closed:
        return ok(f"{', '.join(path.name for path in ports)} can be opened")
    group = name_of_group(closed[0].stat().st_gid)
    text = f"{', '.join(path.name for path in closed)} cannot be opened by {machine.rights.user}"
    if group == "root":
        return refused(f"{text}: they belong to root", RULES_COMMAND)
    return _group_missing(machine, group, f"{text}, who is not in group {group}")


def _future_ports(machine: Machine) -> Check:
    group = next((group for group in GROUPS if group in _groups(machine)), None)
    if group is None or machine.rights.user == "root" or group in machine.rights.groups:
        return ok("none connected")
    text = f"none connected; {machine.rights.user} is not in group {group}, which owns serial ports"
    return replace(_group_missing(machine, group, text), outcome=Outcome.WARNING)


def _group_missing(machine: Machine, group: str, text: str) -> Check:
    user = machine.rights.user
    if user in _groups(machine).get(group, ()):
        return refused(f"{text} in this login session", "log in again")
    return refused(text, f"{LOG_IN_AGAIN}sudo usermod -aG {group} {user}")


def _groups(machine: Machine) -> dict[str, list[str]]:
    lines = (line.split(":") for line in text_of(machine.root / "etc/group").splitlines())
    return {parts[0]: parts[3].split(",") for parts in lines if len(parts) > 3}


@question(
    "udev rules",
    "they name the rig's port after its serial number, grant access to it, and keep other programs away",
)
def udev_rules_present(machine: Machine) -> Check:
    """Check whether the udev rules for rigs are installed."""
    path = machine.root / RULES_FILE.lstrip("/")
    if path.exists() or any("haptic-rig" in rules.name for rules in _rules(machine)):
        return ok("installed")
    return warning(f"{RULES_FILE} is missing", RULES_COMMAND)


@question("ModemManager", "it opens every new serial port and sends modem commands for up to half a minute")
def modem_manager(machine: Machine) -> Check:
    """Warn if ModemManager, which probes new serial ports for modems, runs and would open the rig's port."""
    if not running(machine.root, "ModemManager"):
        return ok("not running")
    ignoring = (rules for rules in _rules(machine) if "haptic-rig" in rules.name)
    if any("ID_MM_DEVICE_IGNORE" in text_of(rules) for rules in ignoring):
        return ok("running; a udev rule makes it ignore rigs")
    return warning("running, and no udev rule makes it ignore rigs", RULES_COMMAND)


@question("brltty", "it takes some serial adapters (CH340, CP210x, FTDI) for braille displays and keeps them")
def brltty(machine: Machine) -> Check:
    """Warn if brltty, a driver of braille displays that takes over serial adapters, is installed or runs."""
    rules = [rules.name for rules in _rules(machine) if "brltty" in rules.name]
    if not running(machine.root, "brltty") and not rules:
        return ok("not installed")
    return warning(
        "installed, but needed only for a braille display",
        "sudo systemctl mask --now brltty.service brltty-udev.service",
    )


def running(root: Path, program: str) -> bool:
    """Return True if a process whose name is `program` is listed below /proc of the file tree `root`."""
    return any(text_of(path) == program for path in (root / "proc").glob("[0-9]*/comm"))


def _rules(machine: Machine) -> Iterator[Path]:
    """Yield the path of each file with udev rules, except links to /dev/null, which disable a file."""
    for place in RULES_PLACES:
        for path in (machine.root / place).glob("*.rules"):
            if path.resolve() != Path("/dev/null"):
                yield path
