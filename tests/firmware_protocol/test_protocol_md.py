"""The tables and statements of PROTOCOL.md agree with the code."""

import re

import pytest

from firmware_protocol import codegen
from firmware_protocol.connection import State
from firmware_protocol.messages import MESSAGES
from firmware_protocol.parameters import PARAMETERS


def test_the_generated_tables_are_fresh() -> None:
    assert codegen.main(["--check"]) == 0, "run python -m firmware_protocol.codegen"


def test_every_section_is_in_one_page_once() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in codegen.PAGES)
    assert sorted(re.findall(r"<!-- generated: (\w+) -->", text)) == sorted(codegen.SECTIONS)
    assert text.count("<!-- end -->") == len(codegen.SECTIONS)


def test_stale_table_is_detected_and_rewritten() -> None:
    fresh = codegen.PROTOCOL.read_text(encoding="utf-8")
    stale = fresh.replace("| `float_stiffness` | f32 |", "| `float_stiffness` | f64 |")
    assert stale != fresh
    assert codegen.render(stale) == fresh


def test_a_misspelt_section_is_an_error() -> None:
    with pytest.raises(KeyError, match="massages"):
        codegen.render("<!-- generated: massages -->\n<!-- end -->")


def test_nothing_is_left_out() -> None:
    text = codegen.PROTOCOL.read_text(encoding="utf-8")
    for cls in MESSAGES.values():
        assert f" {codegen.title(cls)}\n" in text
    for name in [parameter.name for parameter in PARAMETERS] + [state.name for state in State]:
        assert name in text
