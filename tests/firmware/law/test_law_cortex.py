"""The law on Cortex-M0+, M4F and M7: the bits of the host's build, within a budget of instructions and of stack."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from rig.control.excitation_table import PHASES, ExcitationTable
from rig.core.sample import Phase
from tests.firmware.law.law_cases import excited
from tests.firmware.law.law_cortex import CORES, PARAMETERS, TABLE, WORK, Simulator, build
from tests.firmware.law.law_design import FIXED, FLOAT, parameters_of
from tests.firmware.law.law_library import Parameters, inputs
from tests.firmware.law.law_rigs import DUAL, SHORT, UNIFORM, controller_of, experiment_of, on_the_host

pytestmark = pytest.mark.exhaustive("tests/firmware/law/test_law_fixed.py::test_a_whole_run_is_exact")

SCHEMES = {"dual": DUAL, "uniform": UNIFORM}
LAWS = {
    "fixed": (FIXED, "fdm-butterworth-fixed", {}),
    "butterworth": (FLOAT, "fdm-butterworth", {}),
    "foaw-end": (FLOAT, "foaw-end", {}),
    "foaw-best": (FLOAT, "foaw-best", {}),
    "levant": (FLOAT, "levant", {}),
    "kalman": (FLOAT, "kalman", {"gain": "steady"}),
}
# Instructions of the worst tick, either scheme: what was measured with gcc 12.2 -O2, and a tenth more.
BUDGETS = {
    "M0+": {
        "fixed": 630,
        "butterworth": 3720,
        "foaw-end": 9320,
        "foaw-best": 37_100,
        "levant": 4820,
        "kalman": 3800,
    },
    "M4F": {
        "fixed": 340,
        "butterworth": 360,
        "foaw-end": 2310,
        "foaw-best": 7700,
        "levant": 375,
        "kalman": 350,
    },
    "M7": {
        "fixed": 330,
        "butterworth": 350,
        "foaw-end": 2110,
        "foaw-best": 7950,
        "levant": 360,
        "kalman": 340,
    },
}
IMAGE_BYTES = 23_700  # 700 of them for the runner
STACK_BYTES = 512
EXCITATIONS = [ExcitationTable(250, 1, 1, 20_000, 2**16, phases=phases) for phases in PHASES]
COSINE_CYCLES = 86  # of one line at one tick, when the excitation is worked out


@pytest.fixture(scope="module", params=CORES)
def image(request: pytest.FixtureRequest) -> Any:
    pytest.importorskip("unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)")
    return build(CORES[request.param])


@cache
def hits(scheme: str) -> Any:
    """For each law parameters, and inputs of a hit around its contact: they fill every window at the full rate."""

    def hit(arithmetic: Any, estimator: Any, settings: Any) -> Any:
        experiment = experiment_of(estimator, settings, SCHEMES[scheme], SHORT)
        counts = on_the_host(experiment).counts
        contact = np.flatnonzero(counts > 0)[0]
        parameters = parameters_of(controller_of(experiment), arithmetic)
        return parameters, inputs(counts[contact - 50 : contact + 200])

    return {name: hit(*law) for name, law in LAWS.items()}


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_tick_has_the_bits_of_the_host_within_its_budget(law: Any, image: Any, scheme: str) -> None:
    assert len(image.code) <= IMAGE_BYTES
    for name, (parameters, table) in hits(scheme).items():
        simulator = Simulator(image)
        rows, spent, cycles = simulator.run(parameters, table, Phase.TRIAL)
        state = law.reset(parameters)
        state.phase = Phase.TRIAL
        assert rows.tobytes() == law.run(parameters, table, state).tobytes(), name
        print(
            f"{image.core.name} {name}: {np.median(spent):.0f} instructions, "
            f"at most {spent.max()}, {cycles.max()} cycles"
        )
        assert spent.max() <= BUDGETS[image.core.name][name], name
        assert simulator.stack <= STACK_BYTES, name


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_excitation_is_ready_in_seconds(image: Any) -> None:
    """250 lines over a second at 20 kHz, from the cost of a piece; both kinds of phases."""
    for excitation in EXCITATIONS:
        simulator = Simulator(image)
        simulator.uc.mem_write(PARAMETERS, bytes(excited(FIXED, excitation)))
        simulator.call("law_excitation_begin", WORK, PARAMETERS + Parameters.excitation.offset, TABLE)
        cosines = 2 * excitation.lines
        simulator.call("law_excitation_continue", WORK, cosines)
        table = np.frombuffer(bytes(simulator.uc.mem_read(TABLE, 4)), np.int16)
        assert (table == excitation.table[:2]).all()
        each = simulator.cycles / cosines
        seconds = each * excitation.lines * excitation.period / image.core.clock_hz
        print(f"{image.core.name} {excitation.phases}: {each:.0f} cycles a cosine, {seconds:.1f} s of work")
        assert each <= COSINE_CYCLES
