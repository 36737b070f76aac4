"""The golden vectors on this computer and on the simulated processors."""

import ctypes as ct

import numpy as np
import pytest

from rig.control.excitation_table import PHASES, ExcitationTable
from rig.core.sample import Phase, RowFlag
from tests.firmware import cortex, golden
from tests.firmware.build import kept_c
from tests.firmware.law.law_cases import excited
from tests.firmware.law.law_cortex import PARAMETERS, RUNNER, TABLE, WORK, build
from tests.firmware.law.law_design import FIXED
from tests.firmware.law.law_library import SOURCES, LawLibrary, Parameters

MET, BAD_FILE, REFUSED, DIFFERENT, OTHER_BITS = range(5)
IMAGE_BYTES, STACK_BYTES = 27_900, 600  # with the runner; 520 of stack were measured on M0+
COSINE_CYCLES = 86  # of one line at one tick, when the excitation is worked out
RESULT, STATE, FILE = cortex.RAM, cortex.RAM + 0x100, cortex.RAM + 0x2000


class Result(ct.Structure):
    """The struct golden_result."""

    _fields_ = [
        *((name, ct.c_uint32) for name in ("verdict", "ticks", "wrong", "first")),
        ("worst", ct.c_int32),
        ("crc", ct.c_uint32),
    ]

    def __repr__(self) -> str:
        return " ".join(f"{name}={getattr(self, name)}" for name, _ in self._fields_)


@pytest.fixture(scope="module")
def vectors(law: LawLibrary) -> list[golden.Vector]:
    return list(golden.vectors(law))


@pytest.fixture(scope="module")
def runner() -> ct.CDLL:
    """The runner and the law for this computer, without optimisation and under the sanitizer."""
    options = ["-fPIC", "-shared", "-fsanitize=undefined", "-fno-sanitize-recover=all", f"-I{SOURCES}"]
    sources = [*sorted(SOURCES.glob("*.c")), RUNNER]
    library = ct.CDLL(str(kept_c("golden.so", sources, options)))
    library.golden_run.restype = Result
    return library


def run_here(runner: ct.CDLL, file: bytes) -> Result:
    memory = ct.create_string_buffer(8192)
    return runner.golden_run(memory, ct.create_string_buffer(file, len(file)), ct.c_size_t(len(file)))


@pytest.mark.exhaustive("::test_runner_accepts_a_vector_and_rejects_each_change")
def test_the_vectors_are_whole_runs_that_hit_the_wall(vectors: list[golden.Vector]) -> None:
    assert len(vectors) == len(golden.SCHEMES) * len(golden.SIDES) * (len(golden.ESTIMATORS) + 1)
    assert len({v.name for v in vectors}) == len(vectors)
    for v in vectors:
        assert set(v.records["phase"].tolist()) == set(Phase) - {Phase.WAIT, Phase.FREE}, v.name
        assert np.count_nonzero(v.records["flags"] & RowFlag.INSIDE) > 50, v.name
        side = -1 if "/-/" in v.name else 1
        assert (side * v.records["current"]).min() < -500, "the wall answers against its side"


@pytest.mark.exhaustive("::test_runner_accepts_a_vector_and_rejects_each_change")
def test_this_computer_meets_them(runner: ct.CDLL, vectors: list[golden.Vector]) -> None:
    for v in vectors:
        result = run_here(runner, v.to_bytes())
        assert (result.verdict, result.ticks) == (MET, len(v.records)), f"{v.name}: {result}"


def test_runner_accepts_a_vector_and_rejects_each_change(law: LawLibrary, runner: ct.CDLL) -> None:
    vector = golden.vector(law, "fdm-butterworth-fixed", "dual", 1, FIXED)
    file = vector.to_bytes()
    at = file.index(vector.records.tobytes())

    def with_byte(position: int, value: int) -> Result:
        return run_here(runner, file[:position] + bytes([value]) + file[position + 1 :])

    assert run_here(runner, file).verdict == MET
    assert run_here(runner, file[:-1]).verdict == BAD_FILE
    assert with_byte(4, 2).verdict == BAD_FILE
    assert with_byte(64 + 16, 9).verdict == REFUSED
    assert with_byte(24, file[24] ^ 1).verdict == OTHER_BITS
    wrong = with_byte(at + 20 * 7 + 8, file[at + 20 * 7 + 8] ^ 1)
    assert (wrong.verdict, wrong.wrong, wrong.first, wrong.worst) == (DIFFERENT, 1, 7, 1)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("core", cortex.CORES.values(), ids=lambda core: core.name)
@pytest.mark.exhaustive("::test_runner_accepts_a_vector_and_rejects_each_change")
def test_a_processor_meets_them(core: cortex.CortexCore, vectors: list[golden.Vector]) -> None:
    pytest.importorskip("unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)")
    image = build(core)
    assert len(image.code) <= IMAGE_BYTES
    simulator = cortex.Simulator(image, counts=False)
    for v in vectors:
        file = v.to_bytes()
        simulator.uc.mem_write(FILE, file)
        simulator.call("golden_run", RESULT, STATE, FILE, len(file))
        result = Result.from_buffer_copy(bytes(simulator.uc.mem_read(RESULT, ct.sizeof(Result))))
        assert (result.verdict, result.ticks) == (MET, len(v.records)), f"{v.name}: {result}"
    assert simulator.stack <= STACK_BYTES


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("core", cortex.CORES.values(), ids=lambda core: core.name)
@pytest.mark.exhaustive("tests/firmware/law/test_law_excitation.py::test_large_tables_are_pythons_too")
def test_an_excitation_is_ready_in_seconds(core: cortex.CortexCore) -> None:
    # 250 lines over a second at 20 kHz, from the cost of a piece; both kinds of phases.
    for phases in PHASES:
        excitation = ExcitationTable(250, 1, 1, 20_000, 2**16, phases=phases)
        simulator = cortex.Simulator(build(core))
        simulator.uc.mem_write(PARAMETERS, bytes(excited(FIXED, excitation)))
        simulator.call("law_excitation_begin", WORK, PARAMETERS + Parameters.excitation.offset, TABLE)
        cosines = 2 * excitation.lines
        simulator.call("law_excitation_continue", WORK, cosines)
        table = np.frombuffer(bytes(simulator.uc.mem_read(TABLE, 4)), np.int16)
        assert (table == excitation.table[:2]).all()
        each = simulator.cycles / cosines
        seconds = each * excitation.lines * excitation.period / core.clock_hz
        print(f"{core.name} {phases}: {each:.0f} cycles a cosine, {seconds:.1f} s of work")
        assert each <= COSINE_CYCLES
