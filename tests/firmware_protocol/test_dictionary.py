"""The dictionary of a device: decoding returns what was encoded, and reports anything else as the device's error."""

import hashlib
import json
import zlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.dictionary import (
    PLAIN_LIMIT,
    ConstantInfo,
    Dictionary,
    build,
    decode,
    dictionary_hash,
    encode,
)
from firmware_protocol.errors import RemoteProtocolError
from firmware_protocol.faults import Fault, Status

DICTIONARY = build(
    device="koul-compliant",
    firmware="0.1.0",
    simulated=True,
    current_quantum_a=0.001,
    position_rate_default=1000,
    position_rate_maximum=20_000,
    ranges={"current_limit": (0, 1240)},
    constants=(ConstantInfo("inertia", "kg·m²", 2e-4),),
)
PACKED = encode(DICTIONARY)
CONTENT = json.loads(zlib.decompress(PACKED))


def repack(**changes: Any) -> bytes:
    return zlib.compress(json.dumps({**CONTENT, **changes}).encode(), 1)


def test_a_dictionary_comes_back() -> None:
    assert decode(PACKED) == DICTIONARY
    assert encode(decode(PACKED)) == PACKED


def test_the_hash_is_the_head_of_sha_256() -> None:
    assert dictionary_hash(PACKED).to_bytes(8, "little") == hashlib.sha256(PACKED).digest()[:8]
    assert dictionary_hash(PACKED) != dictionary_hash(repack(device="another"))


def test_a_device_may_be_narrower_than_the_table() -> None:
    rate, limit = DICTIONARY.parameter("position_rate"), DICTIONARY.parameter("current_limit")
    assert rate is not None
    assert rate.maximum == 20_000
    assert limit is not None
    assert (limit.minimum, limit.maximum) == (0, 1240)
    assert DICTIONARY.parameter("no such thing") is None


def test_unknown_keys_of_a_newer_device_are_ignored() -> None:
    assert decode(repack(colour="red")) == DICTIONARY


def test_the_devices_own_text_comes_first_then_ours_then_a_placeholder() -> None:
    own = {"code": 200, "name": "LASER", "text": "laser hot", "remedy": "wait"}
    dictionary = decode(repack(faults=[own]))
    assert dictionary.explain_fault(200).text == "fault 200 (unknown to this version): laser hot"
    assert dictionary.explain_fault(Fault.ENCODER).text == Fault.ENCODER.text
    assert dictionary.explain_fault(999).name == "code 999"
    assert dictionary.explain_fault(37).text == "fault 37 (unknown to this version)"
    assert DICTIONARY.explain_status(Status.NOT_HOMED).remedy == Status.NOT_HOMED.remedy


@pytest.mark.parametrize(
    "changes",
    [
        {"major": "1"},
        {"major": True},
        {"minor": 256},
        {"device": None},
        {"simulated": 1},
        {"current_quantum_a": 0.0},
        {"current_quantum_a": 10**400},
        {"time_unit_ns": "62.5"},
        {"position_rate_maximum": 1e4},
        {"parameters": {}},
        {"parameters": [1]},
        {"parameters": [{"id": 1}]},
        {"faults": ["LINK_LOST"]},
        {"statuses": [{"code": -1, "name": "", "text": "", "remedy": ""}]},
    ],
)
def test_invalid_values_are_a_remote_protocol_error(changes: dict[str, Any]) -> None:
    with pytest.raises(RemoteProtocolError):
        decode(repack(**changes))


@pytest.mark.parametrize(
    "packed",
    [
        b"",
        b"not zlib",
        PACKED[:-1],
        PACKED + b"x",
        zlib.compress(b"[]"),
        zlib.compress(b"{}"),
        zlib.compress(b"\xff"),
        zlib.compress(b'{"major": NaN}'),
        zlib.compress(b"[" * 100_000),
        zlib.compress(b" " * (PLAIN_LIMIT + 1)),
    ],
    ids=["empty", "noise", "cut", "longer", "list", "object", "no text", "nan", "deep", "bomb"],
)
def test_invalid_bytes_are_a_remote_protocol_error(packed: bytes) -> None:
    with pytest.raises(RemoteProtocolError):
        decode(packed)


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), st.lists, max_leaves=5))
def test_arbitrary_value_is_accepted_or_a_remote_protocol_error(value: object) -> None:
    for key in ("parameters", "faults", "current_quantum_a", "device"):
        try:
            assert isinstance(decode(repack(**{key: value})), Dictionary)
        except RemoteProtocolError:
            continue
