"""Firmware images identify themselves in any file format, and the package checks their compatibility."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import dictionary as dictionaries
from firmware_protocol.messages import MAJOR, MINOR
from firmware_protocol.parameters import PARAMETERS
from rig.core.check import Outcome
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.firmware._flash import read_image
from rig.firmware._info import about, compatibility, info
from rig.firmware._record import MAGIC, ImageFacts, Record, find, pack
from rig.firmware._uf2 import RP2040, Piece, write_uf2

DICTIONARY = dictionaries.build(device="mine", firmware="1", simulated=False, current_quantum_a=0.001)
PACKED = dictionaries.encode(DICTIONARY)
FACTS = ImageFacts(
    package="0.1", sources="abc", board="rp2040", rig="mine", settings={"pin": 3, "scale": 0.5}
)


@given(st.binary(max_size=300), st.binary(max_size=300))
def test_a_record_is_found_wherever_it_stands(before: bytes, behind: bytes) -> None:
    record = find(before + MAGIC[:7] + pack(Record(FACTS, PACKED)) + behind, "x")
    assert record == Record(FACTS, PACKED)
    assert record.dictionary == DICTIONARY
    assert record.dictionary_hash == dictionaries.dictionary_hash(PACKED)


@given(st.data())
def test_a_damaged_record_is_refused(data: st.DataObject) -> None:
    content = bytearray(pack(Record(FACTS, PACKED)))
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    with pytest.raises(ConfigError, match=r"damaged|not firmware of this project"):
        find(bytes(content), "x")


def test_a_damaged_record_does_not_hide_a_good_one() -> None:
    good = pack(Record(FACTS, PACKED))
    assert find(good[:-1] + b"\0" + good, "x").facts == FACTS


@pytest.mark.parametrize("kind", ["bin", "uf2"])
def test_a_file_of_any_format_has_the_facts_that_a_device_reports(tmp_path: Path, kind: str) -> None:
    image = b"\0" * 500 + pack(Record(FACTS, PACKED))
    path = tmp_path / f"a.{kind}"
    path.write_bytes(image if kind == "bin" else write_uf2([Piece(0x1000_0000, image)], RP2040))
    found = info(str(path))
    assert found.compatible
    law = DICTIONARY.parameter("law")
    assert law is not None
    assert (found.device, found.firmware, found.law) == ("mine", "1", law.maximum)
    assert found.dictionary_hash == f"{dictionaries.dictionary_hash(PACKED):016x}"
    assert found.facts is not None
    assert found.facts.settings == FACTS.settings


def test_a_file_that_is_no_image_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_image(tmp_path / "none.uf2")
    (tmp_path / "text.bin").write_text("hello")
    with pytest.raises(ConfigError, match="not firmware of this project"):
        read_image(tmp_path / "text.bin")


def outcomes(dictionary: Any) -> Any:
    return [(check.name, check.outcome) for check in compatibility(dictionary)]


def texts(dictionary: Any) -> Any:
    return [check.text for check in compatibility(dictionary)]


def test_another_major_version_is_refused_and_another_minor_is_a_warning() -> None:
    assert outcomes(DICTIONARY) == []
    other = replace(DICTIONARY, major=MAJOR + 1)
    assert outcomes(other) == [("protocol", Outcome.REFUSED)]
    assert str(MAJOR + 1) in texts(other)[0]
    assert outcomes(replace(DICTIONARY, minor=MINOR + 1)) == [("protocol", Outcome.WARNING)]


def test_parameters_that_are_missing_or_others_are_refused_and_more_of_them_are_a_warning() -> None:
    first, second, *others = DICTIONARY.parameters
    missing = replace(DICTIONARY, parameters=(second, *others))
    assert outcomes(missing) == [("parameters", Outcome.REFUSED)]
    assert PARAMETERS[0].name in texts(missing)[0]
    assert "mile" in texts(replace(DICTIONARY, parameters=(replace(first, unit="mile"), second, *others)))[0]
    more = replace(DICTIONARY, parameters=(*DICTIONARY.parameters, replace(first, id=60_000, name="later")))
    assert outcomes(more) == [("parameters", Outcome.WARNING)]
    assert "later" in texts(more)[0]


def test_a_firmware_that_this_package_cannot_run_is_incompatible() -> None:
    found = about("x", replace(DICTIONARY, major=MAJOR + 1), 1, None)
    assert not found.compatible
    assert plain(found)["compatible"] is False
