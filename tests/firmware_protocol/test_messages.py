"""Every message survives encoding and decoding; ids, sizes and unknown tails follow the rules of PROTOCOL.md."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.errors import LocalProtocolError, RemoteProtocolError
from firmware_protocol.faults import Fault, Input, LimitFlag, Status
from firmware_protocol.framing import CRC_BYTES, HEADER_BYTES, SHORT_RAW_LIMIT
from firmware_protocol.packing import (
    FAULT_ENTRY_BYTES,
    HEADER,
    LAYOUTS,
    data_limit,
    pack,
    pack_fault_entries,
    type_id_of,
    unpack,
    unpack_fault_entries,
)
from tests.conformance.wire_strategies import any_message, messages_of


@given(any_message(), st.integers(0, 255), st.integers(0, 65535))
def test_a_message_comes_back(message: m.Message, session: int, sequence: int) -> None:
    header, back = unpack(pack(message, session=session, sequence=sequence))
    assert back == message
    assert header == (m.MAJOR, type_id_of(type(message)), 0, session, sequence)


@given(any_message(), st.binary(min_size=1, max_size=8))
def test_the_tail_of_a_newer_minor_version_is_ignored(message: m.Message, tail: bytes) -> None:
    layout = LAYOUTS[type_id_of(type(message))]
    raw = pack(message) + tail
    if layout.tail or len(raw) > SHORT_RAW_LIMIT - CRC_BYTES:
        return
    assert unpack(raw)[1] == message


def test_a_frame_that_is_cut_or_of_an_unknown_type_is_the_peers_fault() -> None:
    for type_id in m.MESSAGES:
        raw = HEADER.pack(m.MAJOR, type_id, 0, 0, 0) + bytes(LAYOUTS[type_id].size)
        assert unpack(raw)
        for length in range(len(raw)):
            with pytest.raises(RemoteProtocolError):
                unpack(raw[:length])
    with pytest.raises(RemoteProtocolError, match="0x7E"):
        unpack(HEADER.pack(m.MAJOR, 0x7E, 0, 0, 0))


def test_only_a_batch_may_be_long() -> None:
    payload = bytes(SHORT_RAW_LIMIT - CRC_BYTES - HEADER_BYTES + 1)
    for type_id, cls in m.MESSAGES.items():
        if cls is not m.Batch:
            with pytest.raises(RemoteProtocolError, match="payload"):
                unpack(HEADER.pack(m.MAJOR, type_id, 0, 0, 0) + payload)


def test_identify_and_identity_are_fixed_for_ever() -> None:
    # If this test fails the change is wrong, not the test: any host can ask any device, whose major is the first byte.
    assert pack(m.Identify(0x1234, 0x5678)) == bytes([m.MAJOR]) + bytes.fromhex("0000000000 3412 7856")
    identity = m.Identity(0x1234, 7, 2, 0x1122334455667788, 0x0203, 0x0405, b"xyz")
    expected = bytes.fromhex("0100000000 3412 07 02 8877665544332211 0302 0504") + b"xyz"
    assert pack(identity) == bytes([m.MAJOR]) + expected


def test_a_value_that_does_not_fit_is_our_fault() -> None:
    with pytest.raises(LocalProtocolError):
        pack(m.Command(0, 3000, 0, 0, 40_000))
    with pytest.raises(LocalProtocolError):
        pack(m.Command(0, 3000, 0, 0, 1.5))  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError):
        pack(m.Command(0, 3000, 0, 0, 0), session=256)


def test_data_fills_a_frame_and_no_more() -> None:
    limit = data_limit(m.SetChunk)
    assert len(pack(m.SetChunk(1, 2, bytes(limit)))) == SHORT_RAW_LIMIT - CRC_BYTES
    with pytest.raises(LocalProtocolError, match=str(limit)):
        pack(m.SetChunk(1, 2, bytes(limit + 1)))


@settings(max_examples=20)
@given(st.lists(messages_of(m.FaultEntry), max_size=5))  # type: ignore[arg-type]
def test_fault_entries_come_back(entries: list[m.FaultEntry]) -> None:
    data = pack_fault_entries(entries)
    assert len(data) == FAULT_ENTRY_BYTES * len(entries)
    assert unpack_fault_entries(data) == entries


def test_a_broken_fault_log_is_the_peers_fault() -> None:
    with pytest.raises(RemoteProtocolError):
        unpack_fault_entries(bytes(FAULT_ENTRY_BYTES + 1))


def test_every_code_says_what_and_what_to_do() -> None:
    for code in (*Fault, *LimitFlag, *Status):
        assert code.text
        assert code.remedy or code in {Fault.NONE, Status.OK}
    assert max(Fault) < 32, "later faults are bits of a 32-bit mask"
    assert LimitFlag(0b101 | 1 << 12).texts() == [LimitFlag.CURRENT.text, LimitFlag.SPEED.text]
    assert (Input.EMERGENCY_STOP, Input.HOLD_TO_RUN) == (1, 2)
