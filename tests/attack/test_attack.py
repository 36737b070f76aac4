"""A little of each area that needs no process, from one seed, in virtual time; `python -m tests.attack` has more."""

from __future__ import annotations

import shutil
from pathlib import Path

import numba
import pytest

from tests.attack.area import chance_of
from tests.attack.report import AreaReport
from tests.attack.worker import AREAS, answer, area_of

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

SEED = 1
CASES = {"protocol": 4, "devices": 1, "core": 1, "liars": 30}


@pytest.mark.parametrize("name", CASES)
def test_a_little_of_an_area_finds_nothing(name: str, tmp_path: Path) -> None:
    if name in ("core", "devices") and shutil.which("gcc") is None:
        pytest.skip("gcc is not installed (package gcc)")
    area, report = area_of(name, tmp_path), AreaReport()
    for case in range(CASES[name]):
        report.add(answer(area, name, SEED, case))
    assert not report.failures
    assert not report.skipped


def test_every_area_is_there_and_a_case_is_the_same_each_time() -> None:
    assert set(CASES) < set(AREAS)
    assert chance_of(3, "liars", 5).random() == chance_of(3, "liars", 5).random()
    assert chance_of(3, "liars", 5).random() != chance_of(3, "liars", 6).random()
