"""The law under the sanitizers with extreme parameters and counts: no undefined behaviour, and the same outputs."""

import ctypes as ct
import re
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.firmware.law import law_cases
from tests.firmware.law.law_library import SOURCES, TICKS, case_bytes, compile_law, kept_law

LEAST_BRANCHES = 90.0  # percent of the branches that the cases must take


@cache
def cases() -> tuple[list[tuple[ct.Structure, Any]], bytes]:
    """Return copies of the cases, because some are changed after they are yielded, and the program's input bytes."""
    listed = [(type(p).from_buffer_copy(p), table) for p, table in law_cases.cases()]
    return listed, case_bytes(listed)


def run_program(program: Any, data: Any) -> Any:
    run = subprocess.run([program], input=data, capture_output=True, check=False, timeout=60)
    assert run.returncode == 0, run.stderr.decode()[-4000:]
    return run.stdout


@pytest.mark.parametrize("multiplier", [(), ("-DLAW_SHORT_MULTIPLIER",)], ids=["long", "short"])
@pytest.mark.exhaustive("tests/firmware/law/test_law_fixed.py::test_a_whole_run_is_exact")
def test_no_undefined_behaviour_and_the_answers_of_the_library(law: Any, multiplier: Any) -> None:
    options = ["-O1", "-g1", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    program = kept_law("sanitised", *options, *multiplier)
    listed, given = cases()
    answer = run_program(program, given)
    refused, at = 0, 0
    for p, table in listed:
        verdict = int.from_bytes(answer[at : at + 4], "little")
        assert verdict == law.check(p)
        size = len(table) * TICKS.itemsize
        if verdict == 0:
            assert answer[at + 4 : at + 4 + size] == law.run(p, table).tobytes()
        refused += verdict != 0
        at += 4 + size
    assert at == len(answer)
    assert 100 < refused < 500, "the noise must be refused often, and often not"


@pytest.mark.exhaustive("tests/firmware/law/test_law_fixed.py::test_a_whole_run_is_exact")
def test_the_cases_reach_nearly_every_branch(tmp_path: Path, law: Any) -> None:
    program = compile_law(tmp_path / "covered", "-O0", "--coverage")
    run_program(program, cases()[1])
    notes = [str(path) for path in tmp_path.glob("*.gcno") if "law_driver" not in path.name]
    try:
        gcov = subprocess.run(
            ["gcov", "-b", *notes], cwd=tmp_path, capture_output=True, text=True, check=True
        )
    except FileNotFoundError:
        pytest.skip("gcov is not installed (package gcc)")
    whole = re.compile(r"File '(.*/law/\w+\.c)'\nLines executed:([\d.]+)% of (\d+)\nBranches executed:[^\n]*\n"
                       r"Taken at least once:([\d.]+)% of (\d+)")  # fmt: skip
    found = whole.findall(gcov.stdout)
    assert len(found) == len(list(SOURCES.glob("*.c"))), gcov.stdout
    for name, lines, _, taken, _ in found:
        print(f"{name.rpartition('/')[2]}: {lines} % of lines, {taken} % of branches")
    assert all(float(lines) == 100.0 for _, lines, *_ in found), found
    branches = sum(float(taken) * int(of) for *_, taken, of in found) / sum(int(of) for *_, of in found)
    assert branches >= LEAST_BRANCHES, found
