"""The law under the sanitizers with extreme parameters and counts: no undefined behaviour, and the same outputs."""

import subprocess
from typing import Any

import pytest

from tests.firmware.law import law_cases
from tests.firmware.law.law_library import TICKS, case_bytes, kept_law


@pytest.mark.parametrize("multiplier", [(), ("-DLAW_SHORT_MULTIPLIER",)], ids=["long", "short"])
@pytest.mark.exhaustive("tests/firmware/law/test_law_fixed.py::test_a_whole_run_is_exact")
def test_no_undefined_behaviour_and_the_answers_of_the_library(law: Any, multiplier: Any) -> None:
    options = ["-O1", "-g1", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    program = kept_law("sanitised", *options, *multiplier)
    # Copies, because some are changed after they are yielded.
    listed = [(type(p).from_buffer_copy(p), table) for p, table in law_cases.cases()]
    run = subprocess.run([program], input=case_bytes(listed), capture_output=True, check=False, timeout=60)
    assert run.returncode == 0, run.stderr.decode()[-4000:]
    answer = run.stdout
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
