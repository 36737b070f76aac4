"""The whole tick of a device that runs its law, on Cortex-M0+, M4F and M7: the currents of this computer, in budgets.

The functions of the hardware are those of the host port, which cost next to nothing; cycles are estimates of
`tests.firmware.cortex_library`.
"""

from ctypes import CDLL

import numpy as np
import pytest

from rig import config
from rig.control.excitation_table import PHASES, ExcitationTable
from rig.firmware.tick_budget import INTEGERS, TICKS
from tests.firmware import cortex_library as cortex
from tests.firmware.cortex_library import CortexLibrary, build
from tests.firmware.law.law_cases import excited
from tests.firmware.law.law_design import FIXED, FLOAT, values_of
from tests.firmware.law.law_library import SOURCES, Parameters
from tests.firmware.law.law_rigs import DUAL, SHORT, UNIFORM, controller_of, experiment_of
from tests.firmware.supervised import Board
from tests.firmware.test_core_law import run_values

pytestmark = pytest.mark.exhaustive(
    "tests/firmware/test_core_law.py::test_the_fault_log_has_each_tick_with_its_own_limits"
)

SCHEMES = {
    "20k/2k": DUAL,
    "20k/20k": UNIFORM,
    "50k/5k": {"controller.position_rate": 50_000, "controller.velocity_rate": 5_000},
}
WINDOW: dict[str, float | str] = {"window_limit": 16.0}
SETTINGS: dict[str, dict[str, float | str]]
SETTINGS = {"foaw-end": WINDOW, "foaw-best": WINDOW, "kalman": {"gain": "steady"}}
OPTIONS = ("-flto", "-fira-region=one")
# Cycles of the worst tick: those measured with gcc 12.2 (2026-11-30), plus at most a fifth.
BUDGETS = {
    ("M0+", INTEGERS, "20k/2k"): 3_000,
    ("M0+", INTEGERS, "50k/5k"): 3_000,
    ("M4F", INTEGERS, "20k/2k"): 1_900,
    ("M4F", INTEGERS, "50k/5k"): 1_700,
    ("M4F", "kalman", "50k/5k"): 1_750,
    ("M7", INTEGERS, "50k/5k"): 1_750,  # 1,707 since the list of parameters grew by eight
    ("M7", "kalman", "20k/20k"): 1_800,
}
# A design and a build go by them.
UNIFORM_TICKS = {(core, name, "20k/20k"): n for core, ticks in TICKS.items() for name, n in ticks.items()}
BUDGETS |= {key: round(1.1 * cycles) for key, cycles in UNIFORM_TICKS.items()}
STACK_BYTES = 2_500  # of the 8 KiB of a Pico; 2,056 were measured on M0+ on 2026-11-30
COSINE_CYCLES = 86  # of one line at one tick, when the excitation is worked out
PARAMETERS, WORK, TABLE = (cortex.RAM + offset for offset in (0x9000, 0x9800, 0xA000))


@pytest.fixture(scope="module", params=cortex.CORES)
def image(request: pytest.FixtureRequest) -> cortex.Image:
    pytest.importorskip("unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)")
    return build(cortex.CORES[request.param], *OPTIONS)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_tick_has_this_computer_s_currents_within_its_budget(image: cortex.Image, library: CDLL) -> None:
    for (core, law, scheme), budget in BUDGETS.items():
        if core != image.core.name:
            continue
        arithmetic = FIXED if law == INTEGERS else FLOAT
        experiment = experiment_of(law, SETTINGS.get(law, {}), SCHEMES[scheme], SHORT)
        values = values_of(controller_of(experiment), arithmetic) | {
            "home_minimum": -100, "home_maximum": 100, "home_target": -20, "home_target_fraction": 0,
            "settle_ticks": 5, "trial_ticks": 150, "release_ticks": 40,
        }  # fmt: skip
        values |= {"fixed_speed_limit": 2**31 - 1} if arithmetic == FIXED else {"float_speed_limit": 1e9}
        counts = np.concatenate(
            [np.full(30, -20), np.arange(-20, 40), np.arange(40, -20, -1), np.full(60, 9)]
        )
        there = CortexLibrary(image)
        board, here = (Board(one, config.rig_model(experiment)) for one in (there, library))
        for each in (board, here):
            each.begin(**run_values(values, position_rate=int(experiment.controller.position_rate)))
            each.run(counts.tolist())
            assert each.core.status.fault == 0
        assert board.fed == here.fed, (core, law, scheme)
        assert there.simulator.stack <= STACK_BYTES
        currents = [sample.commanded for sample in board.fed]
        assert max(map(abs, currents)) > 100, "it must hit"
        assert currents[-1] == 0, "and be done"
        worst, poll = max(there.cycles), max(there.polls)
        rate = 0.4 * image.core.clock_hz / worst
        print(
            f"{core} {law} {scheme}: {np.median(there.cycles):.0f} cycles, {worst} at most; poll {poll}; "
            f"40 % of the period at {rate / 1000:.1f} kHz"
        )
        assert 0.9 * UNIFORM_TICKS.get((core, law, scheme), 0) <= worst <= budget, (core, law, scheme)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_excitation_is_ready_in_seconds() -> None:
    core = cortex.CORES["M0+"]  # the slowest clock, and no instruction for a long product
    # 250 lines over a second at 20 kHz, from the cost of a piece; both kinds of phases.
    entries = ("law_excitation_begin", "law_excitation_continue")
    for phases in PHASES:
        excitation = ExcitationTable(250, 1, 1, 20_000, 2**16, phases=phases)
        simulator = cortex.Simulator(cortex.link(core, sorted(SOURCES.glob("*.c")), entries))
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
