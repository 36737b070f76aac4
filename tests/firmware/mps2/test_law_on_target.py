"""The law as a unit test on emulated processors: golden vectors go in, an exit code comes out."""

from __future__ import annotations

import ctypes as ct
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rig.bench.firmware.build import BuildResult
from rig.control.excitation_table import ExcitationTable
from rig.core.sample import Phase
from tests.conformance.fixed_law import golden_vectors
from tests.firmware import cross
from tests.firmware.law.law_cases import excited, golden_parameters
from tests.firmware.law.law_design import FIXED, FLOAT, parameters_of
from tests.firmware.law.law_library import INPUTS, TICKS, LawLibrary, Parameters, inputs
from tests.firmware.law.law_rigs import DUAL, SHORT, UNIFORM, controller_of, experiment_of, on_the_host
from tests.firmware.mps2.lockstep import emulator

BOARDS = ["mps2-m0plus", "mps2-an385", "mps2-an386", "mps2-an500"]
LAWS = {
    "fixed": (FIXED, "fdm-butterworth-fixed", {}),
    "butterworth": (FLOAT, "fdm-butterworth", {}),
    "foaw-end": (FLOAT, "foaw-end", {}),
    "foaw-best": (FLOAT, "foaw-best", {}),
    "levant": (FLOAT, "levant", {}),
    "kalman": (FLOAT, "kalman", {"gain": "steady"}),
}
GOLDEN_SEEDS = 40
RUN_S = 60.0
LINE = np.dtype([("in", INPUTS), ("left", TICKS)])
ANOTHER_ANSWER, BAD_FILE = 5, 3


@pytest.fixture(scope="module")
def vectors(law: LawLibrary) -> bytes:
    """All cases as a file (`boards/mps2/law_vectors.c`); `tests/firmware/law` holds the law against the Python law."""
    cases = [*golden(law), *hits(law), multisine(law)]
    return b"HRGOLD01" + struct.pack("<II", len(cases), ct.sizeof(Parameters)) + b"".join(cases)


def case(parameters: ct.Structure, phase: Phase, table: np.ndarray, left: np.ndarray) -> bytes:
    lines = np.zeros(len(table), LINE)
    lines["in"], lines["left"] = table, left
    return bytes(parameters) + struct.pack("<II", phase, len(lines)) + lines.tobytes()


def by_this_computer(
    law: LawLibrary, parameters: ct.Structure, phase: Phase, table: np.ndarray
) -> np.ndarray:
    """What the ticks leave in the build for this computer."""
    state = law.reset(parameters)
    state.phase = phase
    return law.run(parameters, table, state)


def golden(law: LawLibrary) -> Iterator[bytes]:
    """The vectors of the law in integers that Python computes without any rounding."""
    for seed in range(GOLDEN_SEEDS):
        vector = golden_vectors(seed)
        parameters, table = golden_parameters(vector), inputs(vector.counts)
        left = by_this_computer(law, parameters, Phase.TRIAL, table)
        left["current"], left["velocity_fixed"] = vector.quanta, vector.velocities
        yield case(parameters, Phase.TRIAL, table, left)


def hits(law: LawLibrary) -> Iterator[bytes]:
    """Every estimator under both schemes: the start of a hit, and its contact."""
    for scheme in (DUAL, UNIFORM):
        for arithmetic, estimator, settings in LAWS.values():
            experiment = experiment_of(estimator, settings, scheme, SHORT)
            counts = on_the_host(experiment).counts
            contact = int(np.flatnonzero(counts > 0)[0])
            parameters = parameters_of(controller_of(experiment), arithmetic)
            for phase, piece in (
                (Phase.HOMING, inputs(counts[:200])),
                (Phase.TRIAL, inputs(counts[contact - 100 : contact + 300])),
            ):
                yield case(parameters, phase, piece, by_this_computer(law, parameters, phase, piece))


def multisine(law: LawLibrary) -> bytes:
    """An excitation of the rig's own motor, whose table Python knows to the bit."""
    excitation = ExcitationTable(12, 3, 7, 500, 40 << 16, ramp=60, phases="hashed", seed=5).with_most_bits()
    parameters, table = excited(FIXED, excitation), inputs(np.zeros(600, np.int64))
    return case(parameters, Phase.TRIAL, table, by_this_computer(law, parameters, Phase.TRIAL, table))


def run(built: BuildResult, vectors: bytes, directory: Path) -> int:
    (directory / "vectors").write_bytes(vectors)
    command = [*emulator(built.board), "-kernel", str(built.elf)]
    return subprocess.run(
        command, cwd=directory, stdin=subprocess.DEVNULL, timeout=RUN_S, check=False
    ).returncode


@pytest.mark.parametrize("board", BOARDS)
def test_every_vector_comes_out_of_the_processor(board: str, vectors: bytes, tmp_path: Path) -> None:
    cross.need_qemu()
    code = run(cross.image(board, "tests"), vectors, tmp_path)
    failure = tmp_path / "failure"
    assert code == 0, failure.read_bytes().hex(" ") if failure.exists() else code


def test_a_vector_that_is_wrong_is_found(vectors: bytes, tmp_path: Path) -> None:
    cross.need_qemu()
    spoilt = bytearray(vectors)
    spoilt[-TICKS.itemsize] ^= 1  # the current of the last tick
    built = cross.image(BOARDS[0], "tests")
    assert run(built, bytes(spoilt), tmp_path) == ANOTHER_ANSWER
    number, tick = struct.unpack_from("<II", (tmp_path / "failure").read_bytes())
    assert (number, tick) == (GOLDEN_SEEDS + 4 * len(LAWS), 599)
    assert run(built, vectors[:-1], tmp_path) == BAD_FILE
