"""A million random steps of the core under the address and undefined-behaviour sanitizers."""

import os
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from firmware_protocol.messages import BATCH_LAYOUTS
from rig.core.sample import Phase
from tests.firmware import build

pytestmark = pytest.mark.exhaustive(
    "tests/firmware/test_core_equals_the_simulated_device.py::test_the_same_is_counted_in_any_bytes"
)

STEPS = int(os.environ.get("HAPTIC_RIG_FUZZ_STEPS", "500000"))
FUZZ_S = 100.0
SEEDS = (1, 2)
# What must have happened: numbers of each.
WANTED = [
    *(("state", str(int(state))) for state in State),
    *(("fault", str(int(fault))) for fault in Fault),
    *(("phase", str(int(phase))) for phase in Phase),
    *(("law", law) for law in "12"),
    *(("layout", str(layout)) for layout in BATCH_LAYOUTS),
    ("live", "0"),
    ("sum", "silences"),
]


@pytest.fixture(scope="module")
def program() -> Path:
    flags = [*build.ADDRESS, f"-I{build.FIRMWARE / 'host'}"]
    return build.kept_c("fuzz", [Path(__file__).with_name("fuzz.c"), *build.SOURCES], flags)


def test_nothing_breaks_the_core_or_makes_it_move(program: Path) -> None:
    reached: Counter[tuple[str, str]] = Counter()
    for seed in SEEDS:
        done = subprocess.run(
            [program, str(seed), str(STEPS)], capture_output=True, text=True, timeout=FUZZ_S, check=False
        )
        assert done.returncode == 0, f"seed {seed}: {done.stderr}"
        for what, which, times in (line.split() for line in done.stdout.splitlines()):
            reached[what, which] += int(times)
    assert not [case for case in WANTED if not reached[case]]
    assert reached["sum", "ticks_armed"] >= reached["sum", "ticks"] / 2
