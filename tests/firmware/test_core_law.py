"""The law on the device: it computes what the law alone computes, when it should and as long as it should."""

from __future__ import annotations

import ctypes
from typing import Any

import pytest

from firmware_protocol import messages as m
from firmware_protocol.faults import Status
from firmware_protocol.messages import Mode
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_ID, BY_NAME
from rig import config
from rig.sample import Phase
from tests.conformance.host import RUN_PARAMETERS
from tests.firmware.law.law_design import FIXED, FLOAT, parameters_of
from tests.firmware.law.law_library import LawLibrary, Parameters
from tests.firmware.law.law_rigs import DUAL, SHORT, START, UNIFORM, controller_of, experiment_of
from tests.firmware.law.law_wire import wire_values
from tests.firmware.supervised import Board, Rig, Sample

TICK, TRIAL, INSIDE = 1, 2, 4  # enum hal_sync
U32 = 2**32 - 1
MOST_TICKS = 10_000
OWN: dict[str, dict[str, float | str]] = {"kalman": {"gain": "steady"}}


def push(**changes: Any) -> ctypes.Structure:
    """A law of integers without homing: a constant push, a wall at count 100, no damping; easily foreseen."""
    p = Parameters(
        arithmetic=FIXED, sense=1, window_minimum=-(10**6), window_maximum=10**6, home_minimum=-(10**6),
        home_maximum=10**6, current_limit=500, velocity_divider=1, slow_multiple=1, home_timeout_ticks=U32,
        trial_ticks=U32, release_ticks=1, home_step=2**30,
    )  # fmt: skip
    p.biquad.b0, p.biquad.coefficient_bits, p.biquad.word_bits, p.biquad.state_bits = 1, 0, 32, 0
    w = p.fixed_wall
    w.shift, w.home_shift, w.side, w.direction = 16, 1, 1, 1
    w.surface, w.stiffness, w.constant = (
        100 * 256,
        10 * 2**16 // 256,
        50 * 2**16,
    )  # 10 quanta a count; 50 quanta
    w.trial_slew = w.homing_slew = w.speed_limit = w.slow_speed = 2**31 - 1
    for name, value in changes.items():
        owner, _, field = name.rpartition("__")
        setattr(getattr(p, owner) if owner else p, field, value)
    return p


def told_to_run(p: ctypes.Structure, **more: Value) -> dict[str, Value]:
    """Parameters of a device that runs a law, on top of `RUN_PARAMETERS`."""
    return {**RUN_PARAMETERS, "continuous_current": 500, **wire_values(p), **more}


def expected(law: LawLibrary, p: ctypes.Structure, samples: list[Sample]) -> list[int]:
    """Currents of the law alone for the counts of some samples; gaps are ticks that it did not see."""
    state, before, currents = law.reset(p), None, []
    for sample in samples:
        elapsed = 1 if before is None else (sample.index - before) & U32
        currents.append(law.tick(state, p, sample.count, elapsed).current)
        before = sample.index
    return currents


def driven(samples: list[Sample]) -> list[int]:
    """What the device drove after each sample but the last: what was in force at the next one."""
    return [sample.commanded for sample in samples[1:]]


# ---------------------------------------------------------------------- from the wire to the law


def content(structure: Any, prefix: str = "") -> dict[str, Any]:
    """Leaves of a structure by name."""
    leaves = {}
    for name, _ in structure._fields_:
        value = getattr(structure, name)
        if isinstance(value, ctypes.Structure):
            leaves |= content(value, f"{prefix}{name}.")
        elif isinstance(value, ctypes.Array):
            for n, item in enumerate(value):
                inner = content(item, f"{prefix}{name}[{n}].") if isinstance(item, ctypes.Structure) else item
                leaves |= inner if isinstance(inner, dict) else {f"{prefix}{name}[{n}]": inner}
        else:
            leaves[prefix + name] = value
    return leaves


@pytest.mark.parametrize("estimator", ["fdm-butterworth", "foaw-best", "levant", "kalman", "foaw-end", "fdm"])
@pytest.mark.parametrize("scheme", [DUAL, UNIFORM], ids=["dual", "uniform"])
def test_a_law_in_float_arrives_as_it_was_designed(
    library: ctypes.CDLL, estimator: str, scheme: dict[str, object]
) -> None:
    p = parameters_of(controller_of(experiment_of(estimator, OWN.get(estimator, {}), scheme), -77))
    seen = law_of(Board(library).begin(**told_to_run(p)))
    ours, theirs = content(seen), content(p)
    skipped = {name for name in theirs if name.startswith("fixed_wall") or name.startswith("biquad")}
    skipped |= {name for name in theirs if name.startswith("low_pass.") and p.low_pass.sections == 0}
    skipped |= {f"low_pass.section[{n}].order" for n in range(p.low_pass.sections, 4)} | {"foaw.limit"}
    assert {name: ours[name] for name in theirs if name not in skipped} == {
        name: value for name, value in theirs.items() if name not in skipped
    }


@pytest.mark.parametrize("sign", [1, -1])
def test_a_law_in_integers_arrives_as_it_was_designed(library: ctypes.CDLL, sign: int) -> None:
    experiment = experiment_of("fdm-butterworth-fixed", {}, DUAL, {"rig.encoder.sign": sign})
    p = parameters_of(controller_of(experiment, reference_count=1234), FIXED)
    board = Board(library, config.rig_model(experiment)).begin(**told_to_run(p))
    ours, theirs = content(law_of(board)), content(p)
    names = [name for name in theirs if name.partition(".")[0] not in {"low_pass", "foaw", "levant", "wall"}]
    assert {name: ours[name] for name in names} == {name: theirs[name] for name in names}


def law_of(board: Board) -> Any:
    seen = Parameters()
    assert board.library.host_law(board.core.address, ctypes.byref(seen))
    return seen


REFUSED: list[tuple[str, dict[str, Value]]] = [
    ("estimator", {"extrapolate": 1}),
    ("estimator", {"estimator": 3}),
    ("law_window_maximum", {"law_window_minimum": 1, "law_window_maximum": 0}),
    ("home_maximum", {"home_minimum": 1, "home_maximum": 0}),
    ("biquad_b0", {"biquad_b0": 2**31 - 1, "biquad_b1": 2**31 - 1, "biquad_a1": -(2**31)}),
    ("fixed_stiffness", {"fixed_stiffness": -1}),
    ("fixed_stiffness", {"fixed_constant_high": 2**31 - 1, "fixed_stiffness": 2**31 - 1}),
    ("excitation_lines", {"excitation_lines": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("about", "values"), REFUSED)
def test_a_law_that_cannot_run_is_refused_and_nothing_changes(
    library: ctypes.CDLL, about: str, values: dict[str, Value]
) -> None:
    board = Board(library).begin(**told_to_run(push()))
    board.disarm()
    before = bytes(law_of(board))
    ack = board.configure(**values)
    assert (ack.status, BY_ID[ack.detail].name) == (Status.INCONSISTENT, about)
    assert bytes(law_of(board)) == before
    assert board.arm().status == Status.OK  # the CRC is that of the first block, and it is verified


def test_a_foaw_band_that_is_too_wide_is_refused(library: ctypes.CDLL) -> None:
    p = parameters_of(controller_of(experiment_of("foaw-best", {}, DUAL)))
    board = Board(library).begin(**told_to_run(p))
    board.disarm()
    ack = board.configure(foaw_band=2**30)
    assert (ack.status, ack.detail) == (Status.INCONSISTENT, BY_NAME["foaw_band"].id)


def test_a_board_without_a_law_refuses_one(library: ctypes.CDLL) -> None:
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
    ("kalman", FLOAT),
]


@pytest.mark.parametrize(("estimator", "arithmetic"), LAWS)
@pytest.mark.parametrize("scheme", [DUAL, UNIFORM], ids=["dual", "uniform"])
def test_a_supervised_hit_is_the_hit_of_the_law_alone(
    library: ctypes.CDLL,
    law: LawLibrary,
    scheme: dict[str, object],
    estimator: str,
    arithmetic: int,
) -> None:
    """Homing to release behind the link, with the plant; every tick arrives, and every current is the law's own."""
    experiment = experiment_of(
        estimator, OWN.get(estimator, {}), scheme, SHORT, {"trial.start": START - 0.002}
    )
    p = parameters_of(controller_of(experiment), arithmetic)
    rig = Rig(library, config.rig_model(experiment), initial_position=START)
    limits = {
        "current_limit": p.current_limit,
        "continuous_current": p.current_limit,
        "position_rate": 20_000,
    }
    rig.begin(**told_to_run(p, **limits))
    for _ in range(MOST_TICKS):
        rig.supervise()
        if rig.states[-1].phase == Phase.DONE:
            break
    rig.command(Mode.STOP)
    currents = expected(law, p, rig.samples)
    assert driven(rig.samples) == currents[:-1]
    first = rig.samples[0].index
    assert [sample.index for sample in rig.samples] == [*range(first, first + len(rig.samples))]
    assert {state.phase for state in rig.states} >= {Phase.HOMING, Phase.TRIAL, Phase.RELEASE, Phase.DONE}
    assert max(map(abs, currents)) > 400, "it must hit"
