"""The parameter block has one canonical encoding, values out of range are rejected, and PROTOCOL.md lists both."""

import math
import struct
from zlib import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codegen
from firmware_protocol.faults import Status
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import (
    BY_NAME,
    DEFAULTS,
    PARAMETERS,
    ParameterError,
    block_crc,
    check_together,
    decode_block,
    encode_block,
)
from tests.conformance.wire_strategies import parameter_sets


@given(parameter_sets())
def test_block_returns_its_values_whatever_their_order(values: dict[str, Value]) -> None:
    block = encode_block(values)
    assert decode_block(block) == values
    assert encode_block(dict(reversed(values.items()))) == block


@pytest.mark.parametrize(
    ("values", "message"),
    [({"wall_side": 0}, "not 0"), ({"reference_count": 0.5}, "whole"), ({"stifness": 1.0}, "stifness")],
)
def test_a_value_without_meaning_is_refused(values: dict[str, Value], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        encode_block(values)


@given(st.floats(0.0, 1e6, allow_subnormal=False))
def test_a_float_becomes_the_float32_that_the_device_holds(stiffness: float) -> None:
    (nearest,) = struct.unpack("<f", struct.pack("<f", stiffness))
    assert decode_block(encode_block({"float_stiffness": stiffness}))["float_stiffness"] == nearest
    assert encode_block({"float_damping": -0.0}) == encode_block({"float_damping": 0.0})


entries = st.tuples(st.integers(1, 50), st.integers(0, 2) | st.integers(0, 2**32 - 1))


@given(
    st.binary(max_size=200)
    | st.lists(entries, max_size=8).map(lambda rows: b"".join(struct.pack("<HI", *row) for row in rows))
)
def test_any_bytes_give_values_or_a_typed_refusal(block: bytes) -> None:
    # Few random blocks are good ones; entries with known ids make more of them.
    refusal = None
    try:
        values = decode_block(block)
    except ParameterError as error:
        refusal = error
    if refusal is None:
        assert all(BY_NAME[name].accepts(value) for name, value in values.items())
    else:
        assert refusal.status is not Status.OK
        assert 0 <= refusal.detail <= 0xFFFF


def test_the_ends_of_a_range_are_in_it_and_what_lies_beyond_is_not() -> None:
    for parameter in PARAMETERS:
        for value in (parameter.minimum, parameter.maximum, parameter.default):
            assert decode_block(encode_block({parameter.name: value})) == {parameter.name: value}
        for value in (parameter.minimum - 1, parameter.maximum + 1, math.inf, -math.inf, math.nan):
            with pytest.raises(ParameterError) as caught:
                encode_block({parameter.name: value})
            assert (caught.value.status, caught.value.detail) == (Status.OUT_OF_RANGE, parameter.id)
            assert caught.value.name == parameter.name
        if parameter.ctype != "f32":
            signed, bits = parameter.ctype[0] == "i", int(parameter.ctype[1:])
            assert -(signed << bits - 1) <= parameter.minimum <= parameter.maximum < 1 << bits - signed
            continue
        for value in (math.inf, -math.inf, math.nan):
            with pytest.raises(ParameterError) as caught:
                decode_block(struct.pack("<Hf", parameter.id, value))
            assert (caught.value.status, caught.value.detail) == (Status.OUT_OF_RANGE, parameter.id)


@pytest.mark.parametrize(
    ("block", "status", "detail"),
    [
        (b"\0" * 5, Status.BAD_LENGTH, 0),
        (b"\0" * 6 * 1000, Status.BAD_LENGTH, 0),
        (struct.pack("<HI", 999, 0), Status.UNKNOWN_PARAMETER, 999),
        (struct.pack("<HI", 1, 0) * 2, Status.BAD_ORDER, 1),
        (struct.pack("<HIHI", 3, 1, 2, 1000), Status.BAD_ORDER, 2),
        (struct.pack("<Hi", 4, 2), Status.OUT_OF_RANGE, 4),
    ],
)
def test_each_refusal_names_its_status_and_parameter(block: bytes, status: Status, detail: int) -> None:
    with pytest.raises(ParameterError) as caught:
        decode_block(block)
    assert (caught.value.status, caught.value.detail) == (status, detail)


def test_a_window_must_not_be_inside_out() -> None:
    check_together(DEFAULTS)
    check_together({"window_minimum": -5, "window_maximum": 5})
    with pytest.raises(ParameterError) as caught:
        check_together({"window_minimum": 5, "window_maximum": -5})
    assert caught.value.status is Status.INCONSISTENT


def test_the_crc_is_that_of_zlib_and_sees_every_value() -> None:
    block = encode_block(DEFAULTS)
    assert block_crc(block) == crc32(block)
    for parameter in PARAMETERS:
        value = parameter.maximum if parameter.default != parameter.maximum else parameter.minimum
        assert block_crc(encode_block({**DEFAULTS, parameter.name: value})) != block_crc(block)


def test_a_device_that_was_never_configured_gives_no_current() -> None:
    assert DEFAULTS["current_limit"] == DEFAULTS["continuous_current"] == DEFAULTS["verified"] == 0


def test_the_generated_tables_are_fresh() -> None:
    assert codegen.main(["--check"]) == 0, "run python -m firmware_protocol.codegen"
    text = "".join(page.read_text(encoding="utf-8") for page in codegen.PAGES)
    assert {text.count(f"<!-- generated: {section} -->") for section in codegen.SECTIONS} == {1}


def test_stale_table_is_detected_and_rewritten() -> None:
    fresh = codegen.PROTOCOL.read_text(encoding="utf-8")
    stale = fresh.replace("| `float_stiffness` | f32 |", "| `float_stiffness` | f64 |")
    assert stale != fresh
    assert codegen.render(stale) == fresh
