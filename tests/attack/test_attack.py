"""Run a few cases of each attack area from one seed, in virtual time; `python -m tests.attack` runs more.

The core is fuzzed by `tests/firmware/test_core_fuzz.py`.
"""

import shutil
from pathlib import Path

import pytest

from tests.attack.__main__ import attack
from tests.attack.area import Outcome, chance_of
from tests.attack.report import AreaReport
from tests.attack.worker import AREAS, answer, area_of
from tests.conformance.tiers import first_by_default

SEED = 1
CASES = {"protocol": 4, "devices": 2, "liars": 66}  # of which every second is a contradiction: each once


@pytest.mark.parametrize("name", first_by_default(CASES))
def test_a_little_of_an_area_finds_nothing(name: str, tmp_path: Path) -> None:
    if name == "devices" and shutil.which("gcc") is None:
        pytest.skip("gcc is not installed (package gcc)")
    area, report = area_of(name, tmp_path), AreaReport()
    for case in range(CASES[name]):
        report.add(answer(area, name, SEED, case))
    assert not report.failures
    assert report.tries == CASES[name]
    assert report.shares().get("share of ticks armed", 1.0) > 0.5


@pytest.mark.exhaustive(
    "tests/system/test_commands.py::test_a_refusal_is_one_line_with_its_exit_code_and_leaves_nothing"
)
def test_a_little_of_the_options_in_a_process_of_its_own_finds_nothing() -> None:
    report = AreaReport()
    attack("options", SEED, report, range(17, 32), float("inf"))
    assert not report.failures
    assert report.figures["runs"] == 15


class Broken:
    """An area whose second case fails."""

    def attack(self, case: int, chance: object) -> Outcome:
        if case == 1:
            raise ZeroDivisionError("here")
        return Outcome()


def test_a_failure_names_what_repeats_it() -> None:
    report = AreaReport()
    for case in range(3):
        report.add(answer(Broken(), "liars", SEED, case))
    assert report.failures == {1: "ZeroDivisionError: here"}
    assert any("--only liars --seed 1 --case 1" in line for line in report.lines("liars", SEED))


def test_a_case_is_the_same_each_time_and_unlike_the_others() -> None:
    assert set(CASES) < set(AREAS)
    assert chance_of(3, "liars", 5).random() == chance_of(3, "liars", 5).random()
    assert chance_of(3, "liars", 5).random() != chance_of(3, "liars", 6).random()
