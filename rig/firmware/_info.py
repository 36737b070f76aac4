"""What an image or a connected device is, and whether this package can run it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.dictionary import Dictionary, ParameterInfo
from firmware_protocol.messages import MAJOR, MINOR
from firmware_protocol.parameter import Parameter
from firmware_protocol.parameters import PARAMETERS
from rig.core.check import Check, Outcome, refused
from rig.core.present import Item, Row, reported
from rig.devices import open_device
from rig.devices.device_facts import FirmwareFacts, stated
from rig.firmware._flash import read_image
from rig.firmware._record import ImageFacts

FLASH = "flash the firmware of this package"


@dataclass(frozen=True, kw_only=True)
class FirmwareInfo(FirmwareFacts):
    """What is known of a firmware.

    Attributes
    ----------
    source
        The file or the device's URL.
    facts
        What its build knew; None of a connected device, which does not report them.
    checks
        What differs from this package; one that refuses keeps this package from running it.
    """

    source: str
    facts: ImageFacts | None
    checks: tuple[Check, ...]

    @reported
    def compatible(self) -> bool:
        """Return True if this package can run it."""
        return not refused(self.checks)

    def items(self) -> list[Item]:
        """Return the facts and checks of the firmware as items to print."""
        board = [Row("board", self.facts.board)] if self.facts else []
        return [*board, *self.rows(), Row("compatible", self.compatible), *self.checks]


def info(source: str) -> FirmwareInfo:
    """Read an image (a file) or ask a device (a URL).

    Raises
    ------
    ConfigError
        The file is no image of this project, or a damaged one.
    DeviceNotFoundError, LinkLostError, IncompatibleDeviceError
        As opening and asking a device does.
    """
    if "://" not in source:
        record = read_image(Path(source))[1]
        return about(source, record.dictionary, record.dictionary_hash, record.facts)
    with open_device(source) as device:
        return about(source, device.dictionary, device.dictionary_hash, None)


def about(source: str, dictionary: Dictionary, hash_: int, facts: ImageFacts | None) -> FirmwareInfo:
    """Compare a dictionary with this package."""
    checks = tuple(compatibility(dictionary))
    return FirmwareInfo(**stated(dictionary, hash_), source=source, facts=facts, checks=checks)


def compatibility(dictionary: Dictionary) -> Iterator[Check]:
    """Yield why this package cannot run a firmware, and what else differs; nothing where all is equal."""
    theirs, ours = f"{dictionary.major}.{dictionary.minor}", f"{MAJOR}.{MINOR}"
    versions = f"the firmware uses protocol {theirs}, this package {ours}"
    if dictionary.major != MAJOR:
        yield Check("protocol", Outcome.REFUSED, versions, FLASH)
    elif dictionary.minor != MINOR:
        text = f"{versions}: features of only one of them are not used"
        yield Check("protocol", Outcome.WARNING, text, FLASH)
    known = {info.id: info for info in dictionary.parameters}
    for parameter in PARAMETERS:
        if mismatch := _mismatch(parameter, known.pop(parameter.id, None)):
            yield Check("parameters", Outcome.REFUSED, mismatch, FLASH)
    if known:
        text = f"the firmware has {len(known)} parameters unknown to this package: {_list_names(list(known.values()))}"
        yield Check("parameters", Outcome.WARNING, text)


def _mismatch(ours: Parameter, theirs: ParameterInfo | None) -> str:
    if theirs is None:
        return f"the firmware lacks parameter {ours.id}, {ours.name}"
    if (theirs.name, theirs.ctype, theirs.unit) != (ours.name, ours.ctype, ours.unit):
        return (
            f"parameter {ours.id} of the firmware is {theirs.name} ({theirs.ctype} {theirs.unit}), in this package "
            f"{ours.name} ({ours.ctype} {ours.unit})"
        )
    return ""


def _list_names(parameters: list[ParameterInfo]) -> str:
    return ", ".join(info.name for info in parameters[:5]) + ("" if len(parameters) <= 5 else ", …")
