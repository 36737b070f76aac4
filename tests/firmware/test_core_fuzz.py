"""Millions of steps of anything, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from tests.firmware import build

STEPS = int(os.environ.get("HAPTIC_RIG_FUZZ_STEPS", "1000000"))
FUZZ_S = 100.0
REACHED = {
    "law": (1, 3),
    "phase": (1, 6),
    "layout": (0, 3),
    "live": (0, 1),
}  # what must have happened: numbers of each


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    flags = [*build.ADDRESS, f"-I{build.FIRMWARE / 'host'}"]
    source = Path(__file__).with_name("fuzz.c")
    return build.compile_c(tmp_path_factory.mktemp("fuzz") / "fuzz", [source, *build.SOURCES], flags)


@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_breaks_the_core_or_makes_it_move(program: Path, seed: int) -> None:
    done = subprocess.run(
        [program, str(seed), str(STEPS)], capture_output=True, text=True, timeout=FUZZ_S, check=False
    )
    assert done.returncode == 0, done.stderr
    reached = {tuple(line.split()[:2]): int(line.split()[2]) for line in done.stdout.splitlines()}
    assert all(reached[what, str(n)] > 0 for what, ends in REACHED.items() for n in range(*ends)), done.stdout
    assert all(reached["state", str(int(state))] > 0 for state in State), done.stdout
    assert all(reached["fault", str(int(fault))] > 0 for fault in Fault), done.stdout
