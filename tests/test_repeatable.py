"""Property tests draw the same inputs in each run and in any worker, which has loaded other modules."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conformance.tiers import first_by_default

ROOT = Path(__file__).parents[1]
DRAW = """
import importlib, sys
import tests.conftest
from hypothesis import given, settings, strategies as st

@settings(max_examples=300)
@given(st.floats(), st.integers(), st.text(), st.binary())
def draw(real, integer, text, data):
    print(ascii((real, integer, text, data)))

draw()
print("loading")
importlib.import_module(sys.argv[1])
draw()
"""


@pytest.mark.parametrize("module", first_by_default(["rig.control.excitation", "firmware_protocol.framing"]))
def test_inputs_do_not_depend_on_loaded_modules(module: str) -> None:
    command = [sys.executable, "-c", DRAW, module]
    printed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    alone, beside = (part.splitlines() for part in printed.split("loading\n"))
    assert len(alone) >= 300
    assert beside == alone
