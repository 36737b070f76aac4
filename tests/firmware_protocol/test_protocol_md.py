"""The tables and statements of PROTOCOL.md agree with the code."""

import re

import pytest

from firmware_protocol import codegen


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
