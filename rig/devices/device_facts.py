"""Facts about a device: from its dictionary (its description of itself), and from the open device.

`rig device`, `rig firmware` and the examination before a hit use it. It only reads: it must not set a parameter or arm
a device.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from firmware_protocol.connection import State
from firmware_protocol.dictionary import Dictionary, SettingValue
from firmware_protocol.messages import MAJOR, MINOR
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME, block_crc, encode_block
from rig.core.present import Row
from rig.devices.framed import FramedDevice

OUR_PROTOCOL = f"{MAJOR}.{MINOR}"


@dataclass(frozen=True, kw_only=True)
class FirmwareFacts:
    """Facts about a firmware, from its dictionary (its description of itself).

    Attributes
    ----------
    device, firmware, simulated
        Name of the rig, version of the firmware, and True if the device is simulated.
    protocol, our_protocol
        Protocol version of the device, and that of this package.
    dictionary_hash
        Hash of the device's dictionary, as in the messages IDENTITY and ARM: 16 hexadecimal digits.
    position_rate_default, position_rate_maximum
        Default and highest tick rate (Hz).
    current_quantum_a
        One step of a current on the wire (A).
    law
        Highest value of the parameter ``law``: 0 no law on the device, 1 in integers, 2 also in float32.
    settings
        Pins, scales and amplifier for which the firmware was built.
    """

    device: str
    firmware: str
    simulated: bool
    protocol: str
    our_protocol: str
    dictionary_hash: str
    position_rate_default: int
    position_rate_maximum: int
    current_quantum_a: float
    law: int
    settings: Mapping[str, SettingValue]

    def rows(self) -> list[Row]:
        """Return the facts about the firmware as rows (label, value, unit, note) to print."""
        kind = "simulated" if self.simulated else ""
        law = {0: "none: the law runs on the host", 1: "in integers", 2: "in integers and in float32"}
        return [
            Row("firmware", self.firmware),
            Row("rig", self.device, note=kind),
            Row(
                "protocol",
                self.protocol,
                note=f"dictionary {self.dictionary_hash}; this package: {self.our_protocol}",
            ),
            Row("rates", self.position_rate_default, "Hz", f"up to {self.position_rate_maximum} Hz"),
            Row("law on the device", law.get(self.law, f"up to kind {self.law}")),
            Row("current quantum", self.current_quantum_a, "A"),
            *(Row(name, value) for name, value in self.settings.items()),
        ]


def stated(dictionary: Dictionary, fingerprint: int) -> dict[str, Any]:
    """Return the fields of `FirmwareFacts` from a device's dictionary and the dictionary's 64-bit hash."""
    law = dictionary.parameter("law")
    return {
        "device": dictionary.device,
        "firmware": dictionary.firmware,
        "simulated": dictionary.simulated,
        "protocol": f"{dictionary.major}.{dictionary.minor}",
        "our_protocol": OUR_PROTOCOL,
        "dictionary_hash": f"{fingerprint:016x}",
        "position_rate_default": dictionary.position_rate_default,
        "position_rate_maximum": dictionary.position_rate_maximum,
        "current_quantum_a": dictionary.current_quantum_a,
        "law": 0 if law is None else int(law.maximum),
        "settings": {info.name: info.value for info in dictionary.settings},
    }


@dataclass(frozen=True, slots=True)
class ActiveParameter:
    """One active parameter of a device; `meaning` is empty if this package does not know the parameter."""

    name: str
    value: Value
    unit: str
    default: Value
    meaning: str


@dataclass(frozen=True, slots=True)
class ActiveParameters:
    """All active parameters of a device, in the order of their ids, with the CRC that the message ARM repeats."""

    url: str
    state: str
    crc: int
    parameters: tuple[ActiveParameter, ...]

    def rows(self) -> list[Row]:
        """Return rows to print: each active parameter with its meaning, and with its default if it was changed."""

        def note(one: ActiveParameter) -> str:
            default = f"default {one.default:g}" if one.value != one.default else ""
            return "; ".join(part for part in (default, one.meaning) if part)

        return [
            Row("url", self.url),
            Row("state", self.state),
            Row("CRC", f"{self.crc:08x}"),
            *(Row(one.name, one.value, one.unit, note(one)) for one in self.parameters),
        ]


def active_parameters(device: FramedDevice) -> ActiveParameters:
    """Return the active parameters of an open device without changing them; `LinkLostError` without a reply."""
    values = device.active_parameters()
    known = {info.name: info for info in device.dictionary.parameters}
    found = [
        ActiveParameter(
            name,
            value,
            known[name].unit if name in known else "",
            known[name].default if name in known else value,
            BY_NAME[name].meaning if name in BY_NAME else "",
        )
        for name, value in values.items()
    ]
    return ActiveParameters(
        device.link.url.text, device.connection.state.name, block_crc(encode_block(values)), tuple(found)
    )


@dataclass(frozen=True, kw_only=True)
class DeviceFacts(FirmwareFacts):
    """Facts about an open device: those of its firmware, its state and its fault.

    Attributes
    ----------
    url
        URL of the device.
    state, fault
        State of the device, and its stored fault with the remedy, None without a fault.
    messages
        Settings that the link could not set when it was opened, with remedies.
    """

    url: str
    state: str
    fault: str | None
    messages: Sequence[str]

    @classmethod
    def of(cls, device: FramedDevice) -> DeviceFacts:
        """Read the facts about an open device; raise `LinkLostError` if the device does not reply."""
        dictionary = device.dictionary
        faulty = device.connection.state is State.FAULT
        report = device.fault_report() if faulty else None
        return cls(
            **stated(dictionary, device.dictionary_hash),
            url=device.link.url.text,
            state=device.connection.state.name,
            fault=None if report is None else f"{report.text}; {report.remedy}",
            messages=tuple(device.link.messages),
        )

    def rows(self) -> list[Row]:
        """Return the facts about the open device as rows (label, value, unit, note) to print."""
        return [
            Row("url", self.url),
            *super().rows(),
            Row("state", self.state, note=self.fault or ""),
            *(Row("setting not made", message) for message in self.messages),
        ]
