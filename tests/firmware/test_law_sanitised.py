"""The law under the sanitisers, with parameters and counts from all over: no undefined behaviour, the same answers."""

from __future__ import annotations

import ctypes as ct
import re
import subprocess

import numpy as np
import pytest

from tests.conformance.fixed_law import golden_vectors
from tests.firmware.law_design import ESTIMATORS, FLOAT, parameters_of
from tests.firmware.law_library import SOURCES, TICKS, Parameters, case_bytes, compile_law, inputs
from tests.firmware.law_rigs import DUAL, SHORT, controller_of, experiment_of
from tests.firmware.test_law_fixed import golden_parameters

EDGES = np.array([0, 1, -1, 2**31 - 1, -(2**31), 2**30, -(2**30), 255, 2**15])
LEAST_BRANCHES = 90.0  # percent of the branches that the cases below must take


def cases():
    """Good parameters with wild inputs, then parameters that are noise: what the check lets pass must be sound."""
    random = np.random.default_rng(9)

    def wild(ticks):
        counts = np.where(random.random(ticks) < 0.3, random.choice(EDGES, ticks), random.integers(-400, 400, ticks))
        gaps = random.choice([1, 1, 1, 2, 7, 1500, 2**32 - 1, 0], ticks)
        return inputs(counts, gaps)

    for seed in range(30):
        p = golden_parameters(golden_vectors(seed))
        yield p, inputs(golden_vectors(seed).counts)
        p.bilateral, p.slow_multiple = seed % 2, 1 + seed % 3
        yield p, wild(200)
    for name in ESTIMATORS:
        given = {"gain": "steady"} if name == "kalman" else {}
        p = parameters_of(controller_of(experiment_of(name, given, DUAL, SHORT)))
        p.settle_ticks, p.trial_ticks, p.release_ticks, p.home_step = 2, 20, 7, 2**34
        p.window_minimum, p.window_maximum = -(2**31), 2**31 - 1
        for divider in (1, 10):
            p.velocity_divider = divider
            p.wall.speed_limit = p.wall.home_effort = 3e38
            p.home_minimum, p.home_maximum = p.window_minimum, p.window_maximum
            for stop, scheme in ((0, 0), (1, 1), (1, 2)):
                p.foaw.stop_first = p.foaw.least_squares = stop
                p.levant.discretisation = scheme
                p.extrapolate = stop
                yield Parameters.from_buffer_copy(p), wild(400)
    good = bytes(golden_parameters(golden_vectors(5)))
    for _ in range(400):
        noise = bytearray(good)
        for _ in range(random.integers(1, 6)):
            at = 4 * int(random.integers(0, 70)) if random.random() < 0.7 else 4 * int(random.integers(0, len(noise) // 4))
            noise[at : at + 4] = int(random.choice([*EDGES, 2, 3, 40, 16, *random.integers(-(2**31), 2**31, 4)])).to_bytes(4, "little", signed=True)
        yield Parameters.from_buffer_copy(noise), wild(30)


def run_program(program, data):
    run = subprocess.run([program], input=data, capture_output=True, check=False, timeout=60)
    assert run.returncode == 0, run.stderr.decode()[-4000:]
    return run.stdout


def test_no_undefined_behaviour_and_the_answers_of_the_library(law, tmp_path):
    options = ["-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    program = compile_law(tmp_path / "sanitised", *options)
    listed = list(cases())
    answer = run_program(program, case_bytes(listed))
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
    assert 100 < refused < 400, "the noise must be refused often, and often not"


def test_the_cases_reach_nearly_every_branch(tmp_path, law):
    program = compile_law(tmp_path / "covered", "-O0", "--coverage")
    run_program(program, case_bytes(cases()))
    notes = [str(path) for path in tmp_path.glob("*.gcno") if "law_driver" not in path.name]
    try:
        gcov = subprocess.run(["gcov", "-b", *notes], cwd=tmp_path, capture_output=True, text=True, check=True)
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


def test_the_state_is_small():
    from tests.firmware.law_library import State  # noqa: PLC0415

    assert ct.sizeof(State) < 2600
    assert ct.sizeof(Parameters) < 1000
    assert FLOAT == 1
