"""The tables and statements of PROTOCOL.md agree with the code."""

from firmware_protocol import codegen


def test_the_generated_tables_are_fresh() -> None:
    assert codegen.main(["--check"]) == 0, "run python -m firmware_protocol.codegen"


def test_stale_table_is_detected_and_rewritten() -> None:
    fresh = codegen.PROTOCOL.read_text(encoding="utf-8")
    stale = fresh.replace("| `float_stiffness` | f32 |", "| `float_stiffness` | f64 |")
    assert stale != fresh
    assert codegen.render(stale) == fresh
