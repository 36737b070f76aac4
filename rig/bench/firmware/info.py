"""What an image or a connected device says of itself, and whether this package can speak to it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from firmware_protocol.dictionary import Dictionary, ParameterInfo
from firmware_protocol.messages import MAJOR, MINOR
from firmware_protocol.parameter import Parameter
from firmware_protocol.parameters import PARAMETERS
from rig.bench.firmware.flash import read_image
from rig.devices import open_device

LAWS = {0: "none: the law runs on the host", 1: "in integers", 2: "in integers and in float32"}


@dataclass(frozen=True, slots=True, kw_only=True)
class FirmwareInfo:
    """What is known of a firmware.

    Attributes
    ----------
    source
        The file or the device's URL.
    facts
        What its build knew (`rig.bench.firmware.record.ImageFacts`); None of a connected device, which does not tell.
    law
        Laws that it runs itself: highest value of parameter ``law``.
    problems
        Why this package cannot run it as it is; empty when it can.
    notes
        What differs without harm.
    """

    source: str
    device: str
    firmware: str
    simulated: bool
    protocol: str
    dictionary_hash: str
    position_rate_default: int
    position_rate_maximum: int
    current_quantum_a: float
    law: int
    facts: dict[str, Any] | None
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def compatible(self) -> bool:
        """Whether this package can run it."""
        return not self.problems

    def as_mapping(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**asdict(self), "compatible": self.compatible}


def info(source: str) -> FirmwareInfo:
    """Look at an image (a file) or ask a device (a URL).

    Raises
    ------
    ConfigError
        The file is no image of this project, or a damaged one.
    DeviceNotFoundError, LinkLostError, IncompatibleDeviceError
        As opening and asking a device does.
    """
    if "://" not in source:
        record = read_image(Path(source))[1]
        return about(source, record.dictionary, record.dictionary_hash, asdict(record.facts))
    with open_device(source) as device:
        return about(source, device.dictionary, device.dictionary_hash, None)


def about(source: str, dictionary: Dictionary, hash_: int, facts: dict[str, Any] | None) -> FirmwareInfo:
    """Judge what a dictionary says against this package."""
    problems, notes = compatibility(dictionary)
    law = dictionary.parameter("law")
    return FirmwareInfo(
        source=source,
        device=dictionary.device,
        firmware=dictionary.firmware,
        simulated=dictionary.simulated,
        protocol=f"{dictionary.major}.{dictionary.minor}",
        dictionary_hash=f"{hash_:016x}",
        position_rate_default=dictionary.position_rate_default,
        position_rate_maximum=dictionary.position_rate_maximum,
        current_quantum_a=dictionary.current_quantum_a,
        law=0 if law is None else int(law.maximum),
        facts=facts,
        problems=tuple(problems),
        notes=tuple(notes),
    )


def compatibility(dictionary: Dictionary) -> tuple[list[str], list[str]]:
    """Say why this package cannot run a firmware, and what else differs."""
    problems, notes = [], []
    theirs, ours = f"{dictionary.major}.{dictionary.minor}", f"{MAJOR}.{MINOR}"
    if dictionary.major != MAJOR:
        problems.append(
            f"it speaks protocol {theirs}, this package {ours}: flash the firmware of this package"
        )
    elif dictionary.minor != MINOR:
        notes.append(
            f"it speaks protocol {theirs}, this package {ours}: what only one of them knows stays unused"
        )
    known = {info.id: info for info in dictionary.parameters}
    for parameter in PARAMETERS:
        mismatch = _mismatch(parameter, known.pop(parameter.id, None))
        if mismatch:
            problems.append(mismatch)
    if known:
        notes.append(
            f"it has {len(known)} parameters that this package does not know: {_listed(list(known.values()))}"
        )
    return problems, notes


def _mismatch(ours: Parameter, theirs: ParameterInfo | None) -> str:
    if theirs is None:
        return f"it does not know parameter {ours.id}, {ours.name}: flash the firmware of this package"
    if (theirs.name, theirs.ctype, theirs.unit) != (ours.name, ours.ctype, ours.unit):
        return (
            f"its parameter {ours.id} is {theirs.name} ({theirs.ctype} {theirs.unit}), here it is {ours.name} "
            f"({ours.ctype} {ours.unit}): flash the firmware of this package"
        )
    return ""


def _listed(parameters: list[ParameterInfo]) -> str:
    return ", ".join(info.name for info in parameters[:5]) + ("" if len(parameters) <= 5 else ", …")
