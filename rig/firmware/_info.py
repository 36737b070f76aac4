"""Identify the firmware in an image or on a connected device, and check whether this package can run it.

`rig firmware info` and the self test call it. It only reads: it must not configure or arm a device.
"""

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
    """Facts about a firmware, and its differences from this package.

    Attributes
    ----------
    source
        Path of the image file, or URL of the device.
    facts
        Facts from the build (package, sources, board, rig, settings); None for a device, which does not report them.
    checks
        One check for each difference from this package; with the outcome "refused", this package cannot run the
        firmware.
    """

    source: str
    facts: ImageFacts | None
    checks: tuple[Check, ...]

    @reported
    def compatible(self) -> bool:
        """Return True if this package can run the firmware."""
        return not refused(self.checks)

    def items(self) -> list[Item]:
        """Return the facts about the firmware as rows, and the checks, for printing."""
        board = [Row("board", self.facts.board)] if self.facts else []
        return [*board, *self.rows(), Row("compatible", self.compatible), *self.checks]


def info(source: str) -> FirmwareInfo:
    """Return the facts about the firmware in an image (path) or on a device (URL), compared with this package.

    Raises
    ------
    ConfigError
        The file is damaged, or not an image of this project.
    DeviceNotFoundError, LinkLostError, IncompatibleDeviceError
        The device is not found, does not reply, or has another version of the protocol.
    """
    if "://" not in source:
        record = read_image(Path(source))[1]
        return about(source, record.dictionary, record.dictionary_hash, record.facts)
    with open_device(source) as device:
        return about(source, device.dictionary, device.dictionary_hash, None)


def about(source: str, dictionary: Dictionary, hash_: int, facts: ImageFacts | None) -> FirmwareInfo:
    """Return the facts about the firmware with the given dictionary and hash, compared with this package.

    `facts` is known from the build of an image (board, rig, settings); None for a connected device.
    """
    checks = tuple(compatibility(dictionary))
    return FirmwareInfo(**stated(dictionary, hash_), source=source, facts=facts, checks=checks)


def compatibility(dictionary: Dictionary) -> Iterator[Check]:
    """Yield a check for each difference between a firmware and this package.

    Its outcome is "refused" if this package cannot use the firmware because of the difference, else "warning".
    """
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
