"""Run a few cases of each attack area from one seed, in virtual time; `python -m tests.attack` runs more."""

from pathlib import Path

import pytest

from tests.attack.__main__ import attack
from tests.attack.area import AreaReport, Outcome, chance_of
from tests.attack.worker import answer, area_of

SEED = 1
CASES = 66  # of which every second is a contradiction: each once


def test_no_device_that_sends_false_values_moves_or_renders_a_stable_wall(tmp_path: Path) -> None:
    area, report = area_of("liars", tmp_path), AreaReport()
    for case in range(CASES):
        report.add(answer(area, "liars", SEED, case))
    assert not report.failures
    assert report.tries == report.figures["runs"] == CASES


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


def test_a_failure_is_reported_with_what_repeats_it() -> None:
    report = AreaReport()
    for case in range(3):
        report.add(answer(Broken(), "liars", SEED, case))
    assert report.failures == {1: "ZeroDivisionError: here"}
    assert any("--only liars --seed 1 --case 1" in line for line in report.lines("liars", SEED))
    first, again, other = (chance_of(SEED, "liars", case).random() for case in (5, 5, 6))
    assert first == again != other
