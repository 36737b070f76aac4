"""The law in the instruction-set simulator, with the runner of golden vectors."""

from pathlib import Path

from tests.firmware import cortex
from tests.firmware.cortex import RAM, CortexCore, Image
from tests.firmware.law.law_library import SOURCES

PARAMETERS, WORK, TABLE = (RAM + offset for offset in (0x9000, 0x9800, 0xA000))
ENTRIES = ("law_excitation_begin", "law_excitation_continue", "golden_run")
RUNNER = Path(__file__).parents[1] / "golden.c"


def build(core: CortexCore) -> Image:
    """Compile and link the law for a core; the test is skipped where there is no compiler for it."""
    image = cortex.build(core, [*sorted(SOURCES.glob("*.c")), RUNNER], ENTRIES)
    held = [name for name, at in image.symbols.items() if at >= RAM and "law" in name]
    assert not held, f"globals: {held}"
    return image
