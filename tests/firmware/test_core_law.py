"""The law on the device gives the currents of the law alone, and runs only while it is supervised."""

import ctypes
from collections.abc import Mapping
from ctypes import CDLL
from typing import Any

import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, LimitFlag, Status
from firmware_protocol.law_parameters import LAW_PARAMETERS
from firmware_protocol.messages import Mode
from firmware_protocol.packing import unpack_fault_entries
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_ID, BY_NAME, encode_block
from firmware_protocol.transfer import set_parameters
from rig import config
from rig.core.sample import Phase
from tests.conformance.host import RUN_PARAMETERS
from tests.conformance.tiers import first_by_default
from tests.firmware.law.law_design import ESTIMATORS, FIXED, FLOAT, OWN, structure_of, values_of
from tests.firmware.law.law_library import LawLibrary, Parameters
from tests.firmware.law.law_rigs import DUAL, SHORT, START, UNIFORM, controller_of, experiment_of
from tests.firmware.supervised import RATE, Board, Rig, Sample

TRIAL, INSIDE = 2, 4  # enum hr_sync
U32 = 2**32 - 1
MOST_TICKS = 10_000


def push(**changes: Value) -> dict[str, Value]:
    """Return a law in integers without homing: a constant push, a wall at count 100, no damping."""
    values: dict[str, Value] = {parameter.name: parameter.default for parameter in LAW_PARAMETERS} | {
        "law": 1, "reference_count": 0, "current_limit": 500, "wall_side": 1,
        "law_window_minimum": -(10**6), "law_window_maximum": 10**6,
        "home_minimum": -(10**6), "home_maximum": 10**6, "home_step": 2**30, "home_timeout_ticks": U32,
        "velocity_divider": 1, "slow_multiple": 1, "trial_ticks": U32, "release_ticks": 1,
        "biquad_b0": 1, "biquad_coefficient_bits": 0, "biquad_word_bits": 32, "biquad_state_bits": 0,
        "fixed_shift": 16, "fixed_home_shift": 1, "fixed_surface": 100 * 256,
        "fixed_stiffness": 10 * 2**16 // 256, "fixed_constant_low": 50 * 2**16,  # 10 quanta a count; 50 quanta
    }  # fmt: skip
    bounds = ("fixed_trial_slew", "fixed_homing_slew", "fixed_speed_limit", "fixed_slow_speed")
    return values | dict.fromkeys(bounds, 2**31 - 1) | changes


def run_values(values: Mapping[str, Value], **more: Value) -> dict[str, Value]:
    return {**RUN_PARAMETERS, "continuous_current": 500, **values, **more}


def expected(law: LawLibrary, values: Mapping[str, Value], samples: list[Sample]) -> list[int]:
    """Return the currents of the law alone for the counts of samples; gaps are missed ticks."""
    p = structure_of(values, 1)
    state, before, currents = law.reset(p), None, []
    for sample in samples:
        elapsed = 1 if before is None else (sample.index - before) & U32
        currents.append(law.tick(state, p, sample.count, elapsed, sample.commanded).current)
        before = sample.index
    return currents


def resulting_currents(samples: list[Sample]) -> list[int]:
    """Return the current after each sample but the last: the one that the next sample reports."""
    return [sample.commanded for sample in samples[1:]]


# ---------------------------------------------------------------------- from the wire to the law


def content(value: Any, name: str = "") -> dict[str, Any]:
    """Return the numbers in a structure by their names, as in ``low_pass.section.0.order``."""
    if isinstance(value, ctypes.Structure):
        parts: Any = ((field, getattr(value, field)) for field, _ in value._fields_)
    elif isinstance(value, ctypes.Array):
        parts = enumerate(value)
    else:
        return {name.removeprefix("."): value}
    return {leaf: number for key, part in parts for leaf, number in content(part, f"{name}.{key}").items()}


@pytest.mark.parametrize("estimator", [*ESTIMATORS[1:], "disturbance"])
@pytest.mark.parametrize("scheme", [DUAL, UNIFORM], ids=["dual", "uniform"])
def test_a_law_in_float_arrives_as_it_was_designed(library: CDLL, estimator: str, scheme: Any) -> None:
    values = values_of(controller_of(experiment_of(estimator, OWN.get(estimator, {}), scheme), -77))
    p = structure_of(values, 1)
    ours, theirs = content(law_of(Board(library).begin(**run_values(values)))), content(p)
    skipped = {name for name in theirs if name.startswith(("fixed_wall", "biquad", "excitation"))}
    skipped |= {name for name in theirs if name.startswith("low_pass.") and p.low_pass.sections == 0}
    skipped |= {f"low_pass.section.{n}.order" for n in range(p.low_pass.sections, 4)} | {"foaw.limit"}
    names = theirs.keys() - skipped
    assert {name: ours[name] for name in names} == {name: theirs[name] for name in names}


@pytest.mark.parametrize("sign", [1, -1])
def test_a_law_in_integers_arrives_as_it_was_designed(library: CDLL, sign: int) -> None:
    experiment = experiment_of("fdm-butterworth-fixed", {}, DUAL, {"rig.encoder.sign": sign})
    values = values_of(controller_of(experiment, reference_count=1234), FIXED)
    board = Board(library, config.rig_model(experiment)).begin(**run_values(values))
    ours, theirs = content(law_of(board)), content(structure_of(values, sign))
    of_others = {"low_pass", "foaw", "levant", "wall", "excitation"}
    names = [name for name in theirs if name.partition(".")[0] not in of_others]
    assert {name: ours[name] for name in names} == {name: theirs[name] for name in names}


def law_of(board: Board) -> Any:
    seen = Parameters()
    assert board.library.host_law(board.core.address, ctypes.byref(seen))
    return seen


REFUSED: list[tuple[str, dict[str, Value]]] = [
    ("foaw_band", {"foaw_band": 2**30}),
    ("estimator", {"extrapolate": 1}),
    ("estimator", {"estimator": 3}),
    ("law_window_maximum", {"law_window_minimum": 1, "law_window_maximum": 0}),
    ("home_maximum", {"home_minimum": 1, "home_maximum": 0}),
    ("biquad_b0", {"biquad_b0": 2**31 - 1, "biquad_b1": 2**31 - 1, "biquad_a1": -(2**31)}),
    ("fixed_stiffness", {"fixed_stiffness": -1}),
    ("fixed_stiffness", {"fixed_constant_high": 2**31 - 1, "fixed_stiffness": 2**31 - 1}),
    ("excitation_lines", {"excitation_lines": 1, "excitation_first": 3, "excitation_period": 6}),
]  # fmt: skip


@pytest.mark.parametrize(("about", "values"), REFUSED)
def test_a_law_that_cannot_run_is_refused_and_nothing_changes(library: CDLL, about: str, values: Any) -> None:
    foaw = values_of(controller_of(experiment_of("foaw-best", {}, DUAL)))
    board = Board(library).begin(**run_values(foaw if about == "foaw_band" else push()))
    board.disarm()
    before = bytes(law_of(board))
    ack = board.configure(**values)
    assert (ack.status, BY_ID[ack.detail].name) == (Status.INCONSISTENT, about)
    assert bytes(law_of(board)) == before
    assert board.arm().status == Status.OK  # the CRC is that of the first block, and it is verified


def test_a_board_without_a_law_refuses_one(library: CDLL) -> None:
    board = Board(library, law_maximum=0)
    board.take(board.core.receive(board.host.send(m.Identify(1, 0))))
    ack = board.configure(law=1)
    assert (ack.status, ack.detail) == (Status.OUT_OF_RANGE, BY_NAME["law"].id)


# ---------------------------------------------------------------------- the same law

LAWS = [
    ("fdm-butterworth-fixed", FIXED),
    ("fdm-butterworth-fixed", FLOAT),
    ("fdm-butterworth", FLOAT),
    ("foaw-best", FLOAT),
    ("levant", FLOAT),
    ("disturbance", FLOAT),
    ("disturbance-two-mass", FLOAT),
]


@pytest.mark.parametrize(
    ("scheme", "estimator", "arithmetic"),
    first_by_default([(scheme, *law) for scheme in (DUAL, UNIFORM) for law in LAWS], 3),
)
def test_a_supervised_hit_is_the_hit_of_the_law_alone(
    library: CDLL, law: LawLibrary, scheme: dict[str, object], estimator: str, arithmetic: int
) -> None:
    experiment = experiment_of(
        estimator, OWN.get(estimator, {}), scheme, SHORT, {"trial.start": START - 0.002}
    )
    p = values_of(controller_of(experiment), arithmetic)
    rig = Rig(library, config.rig_model(experiment), initial_position=START)
    limits = dict.fromkeys(("current_limit", "continuous_current"), p["current_limit"])
    rig.begin(**run_values(p, position_rate=20_000, **limits))
    for _ in range(MOST_TICKS):
        rig.supervise()
        if rig.states[-1].phase == Phase.DONE:
            break
    rig.command(Mode.STOP)
    currents = expected(law, p, rig.samples)
    assert resulting_currents(rig.samples) == currents[:-1]
    first = rig.samples[0].index
    assert [sample.index for sample in rig.samples] == [*range(first, first + len(rig.samples))]
    assert {state.phase for state in rig.states} >= {Phase.HOMING, Phase.TRIAL, Phase.RELEASE, Phase.DONE}
    assert max(map(abs, currents)) > 400, "it must hit"


# ---------------------------------------------------------------------- excitation


def multisine() -> dict[str, Value]:
    lines = {"lines": 20, "first": 3, "step": 5, "period": 700, "ramp": 90, "seed": 99}
    lines |= {"amplitude": 30 << 16, "bits": 6, "phases": 0}
    return push(fixed_constant_low=0, **{f"excitation_{name}": value for name, value in lines.items()})


@pytest.mark.parametrize("phases", [0, 1])
def test_an_excitation_is_played_from_the_device_s_table(library: CDLL, law: LawLibrary, phases: int) -> None:
    p = multisine() | {"excitation_phases": phases}
    board = Board(library)
    board.prepare(**run_values(p))
    while (status := board.arm().status) == Status.NOT_READY:
        board.tick()
    assert status == Status.OK
    board.run([0] * 1_600)
    board.command(Mode.STOP)
    currents = expected(law, p, board.samples)
    assert resulting_currents(board.samples) == currents[:-1]
    assert max(currents) > 60
    assert currents[100:800] == currents[800:1500]


def test_a_device_says_when_it_is_not_ready_and_then_it_is(library: CDLL) -> None:
    board = Board(library)
    board.prepare(**run_values(multisine()))
    refused = 0
    while board.arm().status == Status.NOT_READY:
        refused += 1
        library.host_poll(board.core.address, b"", 0)
    assert 700 * 20 / 32 / 4 < refused < 700 * 20 / 32
    board.disarm()
    board.prepare(**run_values(multisine(), ramp_us=5_000))
    assert board.arm().status == Status.OK  # the same table, and it is still there
    board.disarm()
    board.prepare(**run_values(multisine() | {"excitation_seed": 100}))
    assert board.arm().status == Status.NOT_READY
    board.prepare(**run_values(push()))
    assert board.arm().status == Status.OK


@pytest.mark.parametrize("name", [f"excitation_{name}" for name, _ in Parameters().excitation._fields_])
def test_another_excitation_is_worked_out_anew_whatever_differs(library: CDLL, name: str) -> None:
    board = Board(library)
    p = multisine()
    board.prepare(**run_values(p))
    while board.arm().status == Status.NOT_READY:
        board.tick()
    board.disarm()
    board.prepare(**run_values(p | {name: p[name] + 1}))
    assert board.arm().status == Status.NOT_READY


def test_a_period_that_the_board_has_no_memory_for_is_refused(library: CDLL) -> None:
    board = Board(library)
    library.host_set_excitation(board.core.address, 699)
    board.identify()
    ack = board.configure(**run_values(multisine()))
    assert (ack.status, ack.detail) == (Status.INCONSISTENT, BY_NAME["excitation_period"].id)
    library.host_set_excitation(board.core.address, 700)
    assert board.configure(**run_values(multisine())).status == Status.OK


# ---------------------------------------------------------------------- when it runs


def test_the_law_answers_each_sample_in_its_own_tick(library: CDLL, law: LawLibrary) -> None:
    p = push()
    board = Board(library).begin(**run_values(p))
    board.run([*range(90, 130)])
    board.command(Mode.STOP)
    currents = expected(law, p, board.samples)
    assert [sample.commanded for sample in board.fed] == [0, *currents[:-1]]
    assert currents[:15] == [0, 0, *[50 - 10 * max(0, count - 100) for count in range(92, 105)]]


def test_no_current_flows_before_the_first_supervision(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push()))
    for _ in range(20):
        board.tick()
    assert not board.frames
    assert {sample.commanded for sample in board.fed} == {0}
    assert {state.phase for state in board.states} == {Phase.WAIT}
    board.run([0] * 60)
    assert board.frames[0].samples[0].index == board.fed[20].index


def test_missed_ticks_have_passed_for_the_law_too(library: CDLL, law: LawLibrary) -> None:
    p = push(fixed_damping=2**16, velocity_divider=4, trial_ticks=60)
    board = Board(library).begin(**run_values(p))
    for step in range(80):
        if step % 9 == 5:
            board.missed = 1
        board.run([100 + step])
    board.command(Mode.STOP)
    assert resulting_currents(board.samples) == expected(law, p, board.samples)[:-1]
    assert board.states[-1].phase == Phase.DONE


@pytest.mark.parametrize("ramp_us", [0, 777, 10_000])
def test_after_a_silent_host_the_live_law_fades_and_the_fault_latches(
    library: CDLL, law: LawLibrary, ramp_us: int
) -> None:
    # The factor acts on the present output of the law: its current continues to follow the handle.
    p = push()
    board = Board(library).begin(**run_values(p, ramp_us=ramp_us))
    board.run([0] * 10)
    board.command(lifetime_us=6_000)
    silent_since = board.core.status.time
    counts = [110 + 2 * (step % 7) for step in range(60)]
    for board.count in counts:
        board.tick()
    status = board.core.status
    assert (status.fault, status.current, status.enabled) == (Fault.LINK_LOST, 0, 0)
    wanted = expected(law, p, board.samples)
    period, end = 16_000_000 // RATE, silent_since + 6_000 * 16 + ramp_us * 16
    fading = 0
    for n, sample in enumerate(board.samples[10:-1], start=10):
        until = silent_since + (n - 10 + 2) * period  # a current is judged at the end of its tick
        left, whole = max(0, min(end - until, ramp_us * 16)), ramp_us * 16
        faded = wanted[n]
        if until > end - whole:
            faded = (abs(wanted[n]) * left // whole) * (1 - 2 * (wanted[n] < 0))
        assert board.samples[n + 1].commanded == faded, sample
        fading += 0 < left < whole
    assert fading == {0: 0, 777: 1, 10_000: 19}[ramp_us]
    assert any(state.limits & LimitFlag.RAMPING for state in board.states)
    assert board.states[-1].fault == Fault.LINK_LOST


def test_the_lifetime_of_supervision_is_capped(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push(), supervise_lifetime_us=10_000, ramp_us=0))
    board.command(lifetime_us=2**32 - 1)
    ticks = 0
    while not board.core.status.fault:
        board.tick()
        ticks += 1
    assert ticks in {20, 21}  # 10 ms at 2 kHz


def test_limits_act_on_the_law_too(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push(fixed_constant_low=300 * 2**16), slew_limit=7))
    board.run([0] * 10)
    board.command(Mode.STOP)
    assert [sample.commanded for sample in board.samples] == [0, 0, *range(7, 57, 7)][:10]
    board.run([0] * 10)
    assert board.states[-1].limits == LimitFlag.SLEW


@pytest.mark.parametrize("mode", [Mode.STOP, Mode.CURRENT])
def test_a_command_ends_the_law_supervision_restarts_it(library: CDLL, law: LawLibrary, mode: Mode) -> None:
    p = push(trial_ticks=30)
    board = Board(library).begin(**run_values(p))
    board.run([0] * 20)
    assert board.core.status.current == 50
    board.command(mode, current=7)
    assert board.core.status.current == (0 if mode is Mode.STOP else 50)
    board.tick()
    assert board.core.status.current == (0 if mode is Mode.STOP else 7)
    first = board.samples
    assert resulting_currents(first) == expected(law, p, first)[:-1]
    board.frames.clear()
    board.run([5] * 50)
    board.command(Mode.STOP)
    again = board.samples
    assert resulting_currents(again) == expected(law, p, again)[:-1]
    assert board.states[-1].phase == Phase.DONE


@pytest.mark.parametrize(
    ("changes", "counts"),
    [
        ({"law_window_maximum": 50}, [0, 0, 40, 51]),
        ({"home_timeout_ticks": 3, "home_minimum": 5, "home_maximum": 5}, [0] * 8),
        ({"fixed_speed_limit": 9}, [0, 0, 0, 10]),
    ],
    ids=["window", "homing", "speed"],
)
def test_a_law_that_gives_up_is_done_without_a_fault(library: CDLL, changes: Any, counts: Any) -> None:
    board = Board(library).begin(**run_values(push(**changes)))
    board.run([*counts, *[counts[-1]] * 20])
    assert board.core.status.fault == Fault.NONE
    assert board.core.status.current == 0
    assert board.states[-1].phase == Phase.DONE


def test_a_current_that_is_no_number_is_a_fault(library: CDLL) -> None:
    p = values_of(controller_of(experiment_of("fdm-butterworth", {}, UNIFORM)))
    p |= {
        "settle_ticks": 0,
        "low_pass_inner_1": 2.0**30,
        "low_pass_band_1": 2.0**30,
    }  # a filter that runs away
    board = Board(library).begin(**run_values(p, current_limit=500))
    for step in range(40):
        board.run([step % 2])
        if board.core.status.fault:
            break
    status = board.core.status
    assert (status.fault, status.current, status.enabled) == (Fault.NON_FINITE, 0, 0)
    assert board.samples[-1].count == step % 2  # of the tick that caused it


def test_a_law_begins_anew_in_each_session(library: CDLL, law: LawLibrary) -> None:
    p = push(trial_ticks=20)
    board = Board(library).begin(**run_values(p))
    for _ in range(3):
        board.frames.clear()
        board.run([0] * 40)
        assert board.states[-1].phase == Phase.DONE
        board.disarm()
        assert resulting_currents(board.samples) == expected(law, p, board.samples)[:-1]
        assert board.arm().status == Status.OK
        board.tick()
        assert board.states[-1].phase == Phase.WAIT


# ---------------------------------------------------------------------- STATE, log and pins


@pytest.mark.parametrize(("rate", "every"), [(100, 1), (2_000, 10), (7_777, 38), (50_000, 250)])
def test_state_comes_two_hundred_times_a_second(library: CDLL, rate: int, every: int) -> None:
    board = Board(library).begin(**run_values(push(), position_rate=rate))
    board.run([0] * (5 * every + 1))
    indices = [state.sample_index for state in board.states]
    assert indices == [*range(indices[0], indices[0] + 5 * every + 1, every)]
    board.missed = 1
    board.run([0] * every)
    assert board.host.statistics.lost == (every == 1)  # a tick without a STATE is not a lost one


def test_a_fault_is_reported_at_once_and_once(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push(), window_maximum=1_000))
    board.run([0] * 3)
    seen = len(board.states)
    board.run([1_001])
    board.tick()
    assert [state.fault for state in board.states[seen:]] == [Fault.POSITION_WINDOW]


def test_the_fault_log_has_each_tick_with_its_own_limits(library: CDLL) -> None:
    window = {"window_maximum": 1_000, "window_minimum": -1_000}
    board = Board(library).begin(**run_values(push(), batch_layout=2, **window))
    board.run([0] * 12 + [960] + [0] * 12)
    assert [bool(state.limits & LimitFlag.POSITION) for state in board.states] == [False, False, True]
    board.run([1_001])
    entries = []
    for first in range(0, 40, 2):
        board.nonce += 1
        (page,) = board.take(board.receive(board.host.send(m.GetFaultLog(board.nonce, first))))
        assert isinstance(page, m.FaultLog)
        entries += unpack_fault_entries(page.data)
    near = [entry.count for entry in entries if entry.limits & LimitFlag.POSITION]
    assert near == [960, 1_001]
    assert entries[-1].count == 1_001


def test_pins_show_what_the_law_does(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push(trial_ticks=20), batch_layout=2))
    pins = []
    for board.count in [0] * 5 + [150] * 5 + [0] * 20:
        board.supervise()
        pins.append(board.core.status.sync)
    assert pins[:10] == [0] + [TRIAL] * 4 + [TRIAL | INSIDE] * 5  # the first tick homes
    assert pins[-1] == 0
    board.run([150])
    assert board.core.status.sync == INSIDE
    board.command(Mode.STOP)
    board.tick()
    assert board.core.status.sync == 0


@pytest.mark.parametrize("after", ["kalman", "tracking"])
def test_an_estimator_of_counts_alone_keeps_no_input_of_the_one_before(library: CDLL, after: str) -> None:
    """A block that omits a parameter leaves its old value on the device, so it must contain the input."""
    blocks = [
        run_values(values_of(controller_of(experiment_of(name, OWN.get(name, {}), DUAL))))
        for name in ("disturbance", after)
    ]
    board = Board(library).begin(**blocks[0])
    assert law_of(board).kalman.input != 0.0
    board.command(Mode.STOP)
    assert board.disarm().status == Status.OK
    assert board.configure(**blocks[1]).status == Status.OK
    assert law_of(board).kalman.input == 0.0


# ---------------------------------------------------------------------- another wall while it runs


def test_a_wall_does_not_change_under_a_pressed_hand(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push()))
    surfaces = {"here": 100, "nearer": 50, "farther": 150}
    for count, surface, status in (
        (101, "farther", Status.INSIDE_WALL),  # inside the one that is
        (100, "nearer", Status.INSIDE_WALL),  # inside the one that would be
        (100, "farther", Status.OK),
        (120, "nearer", Status.INSIDE_WALL),
        (150, "here", Status.INSIDE_WALL),
        (50, "nearer", Status.OK),
    ):
        board.run([count] * 3)
        before = bytes(law_of(board))
        ack = board.configure(fixed_surface=surfaces[surface] * 256)
        assert ack.status == status
        assert (bytes(law_of(board)) == before) == (status is not Status.OK)


def test_a_bilateral_wall_does_not_change_while_it_runs(library: CDLL) -> None:
    # Its spring acts on both sides: no place is free of it.
    board = Board(library).begin(**run_values(push(), bilateral=1))
    for count in (50, 100, 101):
        board.run([count] * 3)
        assert board.configure(fixed_surface=150 * 256).status == Status.INSIDE_WALL
        assert board.configure(fixed_stiffness=0).status == Status.INSIDE_WALL


def test_a_wall_that_cannot_be_computed_is_refused_while_it_runs(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push()))
    board.run([0] * 5)
    ack = board.configure(fixed_stiffness=-1)
    assert (ack.status, ack.detail) == (Status.INCONSISTENT, BY_NAME["fixed_stiffness"].id)
    ack = board.configure(fixed_stiffness=1, fixed_trial_slew=1)
    assert (ack.status, ack.detail) == (Status.NOT_LIVE, BY_NAME["fixed_trial_slew"].id)
    board.run([0] * 5)
    assert (board.core.status.current, board.core.status.fault) == (50, Fault.NONE)


def test_a_wall_of_a_law_that_does_not_run_may_change_at_any_time(library: CDLL) -> None:
    plain = Board(library).begin(law=0)
    plain.run([4_000] * 3)
    assert plain.configure(fixed_surface=0, fixed_stiffness=5).status == Status.OK


class Slow(Board):
    """A board whose main loop polls once per 8 bytes of the host, and once per `poll`."""

    replies: list[m.Message]

    def receive(self, data: bytes) -> bytes:
        while data:
            data = data[self.library.host_poll(self.core.address, data, min(8, len(data))) :]
        return self.core.take()

    def poll(self) -> None:
        self.library.host_poll(self.core.address, b"", 0)
        self.replies += self.take(self.core.take())

    def begin_change(self, **values: Value) -> None:
        """Send a block up to its COMMIT, without polling for the reply."""
        self.nonce, self.replies = self.nonce + 1, []
        *messages, commit = set_parameters(encode_block(values), self.nonce)
        for message in messages:
            assert self.ask(message).status == Status.OK
        self.receive(self.host.send(commit))
        assert not self.replies


def test_a_wall_changes_piece_by_piece_while_the_law_runs_on(library: CDLL, law: LawLibrary) -> None:
    # The reply names the tick from which the new wall acts, however many ticks passed.
    p = push()
    board = Slow(library).begin(**run_values(p))
    board.run([90] * 10)
    board.begin_change(fixed_surface=95 * 256, fixed_stiffness=7 * 2**8)
    while not board.replies:
        board.count = 94 if len(board.fed) % 2 else 60
        board.tick()
        board.poll()
        board.poll()
    (ack,) = board.replies
    assert isinstance(ack, m.Ack)
    assert ack.status == Status.OK
    assert 20 < len(board.fed) < 50
    board.run([110] * 5)
    board.command(Mode.STOP)
    p = structure_of(p, 1)
    other, state, currents = law_of(board), law.reset(p), []
    for sample in board.samples:
        if sample.index == ack.sample_index:
            p = other
        currents.append(law.tick(state, p, sample.count, active=sample.commanded).current)
    assert resulting_currents(board.samples) == currents[:-1]
    assert currents[-1] == 50 - 7 * 15
    board.disarm()
    board.crc = ack.crc
    assert board.arm().status == Status.OK


def test_a_fault_in_the_middle_of_a_change_leaves_the_old_wall(library: CDLL) -> None:
    board = Slow(library).begin(**run_values(push()))
    board.run([0] * 5)
    before, crc = bytes(law_of(board)), board.crc
    board.begin_change(fixed_surface=95 * 256)
    library.host_fault(board.core.address, int(Fault.INTERNAL))
    for _ in range(60):
        board.poll()
    (ack,) = board.replies
    assert isinstance(ack, m.Ack)
    assert (ack.status, ack.detail, ack.crc) == (Status.BAD_STATE, State.FAULT, crc)
    assert bytes(law_of(board)) == before


def test_a_request_in_the_same_bytes_finds_the_change_done(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push()))
    board.nonce += 1
    *messages, commit = set_parameters(encode_block({"fixed_surface": 95 * 256}), board.nonce)
    for message in messages:
        assert board.ask(message).status == Status.OK
    question = m.GetParameters(board.nonce + 1, 0)
    data = board.host.send(commit) + board.host.send(question)
    assert library.host_poll(board.core.address, data, len(data)) == len(data)
    ack, page = board.take(board.core.take())
    assert isinstance(ack, m.Ack)
    assert isinstance(page, m.Parameters)
    assert (ack.status, ack.crc) == (Status.OK, page.crc)
