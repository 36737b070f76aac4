"""The firmware reads every parameter that a host can send."""

import re

from firmware_protocol.parameters import PARAMETERS
from tests.firmware.build import CORE

JUDGED = {"motion", "encoder_sign"}  # by their range, which is one value: a device takes no other


def test_the_firmware_reads_every_parameter() -> None:
    read = set()
    for source in CORE:
        if source.name != "protocol.c":
            read |= set(re.findall(r"HR_PARAMETER_(\w+)", source.read_text(encoding="utf-8")))
    sections = {f"{name[:-1]}{n}" for name in read if name.endswith("_1") for n in range(2, 5)}
    named = {parameter.name.upper() for parameter in PARAMETERS}
    assert named - read - sections == {name.upper() for name in JUDGED}
