"""Read the address of a drive from a URL, find the drive on its bus, and compare it with a rig.

`serve`, `link` and `describe` use it. It must not command a motion: it only reads what the drive reports.
"""

import sys
from dataclasses import dataclass
from typing import Protocol, Self

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.devices.device import DeviceUrl
from rig.extras.drives.fitting import Output
from rig.extras.drives.library import FittedDrive, Switches

if sys.platform == "linux":
    from rig.extras.drives import moteus, odrive
    from rig.extras.drives.bus import OPTIONS, Bus

assert sys.platform == "linux"

SWITCHES = ("hold", "stop")
_LARGEST_ID, _LARGEST_PREFIX, _LARGEST_NODE = 127, 0x1FFF, 62


class DriveFacts(Protocol):
    """Interface (`typing.Protocol`) of the facts that a drive of any kind reports about itself."""

    @property
    def id(self) -> int:
        """Id of the drive on its bus."""
        ...

    @property
    def firmware(self) -> str:
        """Version of the drive's firmware, such as "1.1.0"."""
        ...

    @property
    def output(self) -> Output:
        """Encoder, torque constant and limits at the drive's output shaft."""
        ...


class Address(Protocol):
    """Interface (`typing.Protocol`) of a drive's address, with the settings that the URL contains."""

    def look(self, bus: Bus) -> DriveFacts:
        """Identify the drive without changing it; raise `RigError` if it would not execute commands as sent."""
        ...

    def find(self, bus: Bus, model: RigModel) -> FittedDrive:
        """Return what firmware in front of the drive needs; raise `RigError` if the drive does not match `model`."""
        ...


def number(url: DeviceUrl, name: str, default: int, largest: int) -> int:
    """Return the URL option `name` as a whole number; raise `ConfigError` if it is not from 0 to `largest`."""
    text = url.options.get(name, str(default))
    try:
        value = int(text, 0)
    except ValueError:
        value = -1
    if not 0 <= value <= largest:
        raise ConfigError(
            f"{url.text}: {name} = {text!r} is not valid", remedy=f"give a whole number from 0 to {largest}"
        )
    return value


@dataclass(frozen=True, slots=True)
class MoteusAddress:
    """Address of a moteus: its id, the prefix of its CAN ids, and the switches on its pins."""

    drive: int
    prefix: int
    switches: Switches

    @classmethod
    def of(cls, url: DeviceUrl) -> Self:
        """Read the address of a moteus from a URL; raise `ConfigError` if an option is not valid."""
        url.allow((*OPTIONS, "id", "prefix", *SWITCHES))
        return cls(
            number(url, "id", 1, _LARGEST_ID),
            number(url, "prefix", 0, _LARGEST_PREFIX),
            moteus.switches_of({name: url.options[name] for name in SWITCHES if name in url.options}),
        )

    def look(self, bus: Bus) -> moteus.MoteusFacts:
        """Read the moteus's facts without changing it; raise `RigError` if it would not execute commands as sent."""
        return moteus.find(moteus.MoteusConversation(bus, self.drive, self.prefix), self.drive)

    def find(self, bus: Bus, model: RigModel) -> FittedDrive:
        """Return what firmware in front of the moteus needs; raise `RigError` if it does not match the rig `model`."""
        return moteus.fit(self.look(bus), model, prefix=self.prefix, switches=self.switches)


@dataclass(frozen=True, slots=True)
class OdriveAddress:
    """Address of an ODrive: its node id on the CAN bus, and the parameter numbers (endpoints) of its firmware."""

    node: int
    endpoints: odrive.Endpoints

    @classmethod
    def of(cls, url: DeviceUrl) -> Self:
        """Read the address of an ODrive from a URL; raise `ConfigError` if an option is missing or not valid."""
        url.allow(("id", "endpoints"))
        place = url.options.get("endpoints")
        if place is None:
            raise ConfigError(
                f"{url.text}: the URL has no endpoints file, which is needed to read the ODrive's limits",
                remedy=odrive.WHERE_TO_GET,
            )
        return cls(number(url, "id", 0, _LARGEST_NODE), odrive.Endpoints.load(place))

    def look(self, bus: Bus) -> odrive.OdriveFacts:
        """Read the ODrive's facts without changing it; raise `RigError` if it would not execute commands as sent."""
        return odrive.find(odrive.OdriveConversation(bus, self.node, self.endpoints))

    def find(self, bus: Bus, model: RigModel) -> FittedDrive:
        """Return what firmware in front of the ODrive needs; raise `RigError` if it does not match the rig `model`."""
        return odrive.fit(self.look(bus), model)


def address_of(url: DeviceUrl) -> Address:
    """Return the address of the drive in a URL; raise `ConfigError` for an invalid URL."""
    return OdriveAddress.of(url) if url.scheme == "odrive" else MoteusAddress.of(url)
