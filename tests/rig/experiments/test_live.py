"""Wall changes from outside a running loop: the loop gets the numbers of an experiment that began with that wall."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.config import as_mapping, controller, override
from rig.config.presets import load
from rig.core.errors import ConfigError, PlanError, RigError, RunEndedError
from rig.experiments.trials import live
from rig.realtime import control_words, running
from rig.realtime.mailbox import SET_FLOATS, take
from rig.realtime.ring import Ring

QUANTUM_A = 0.001
EXPERIMENT = load("koul-compliant")


def info_of(experiment: Any = EXPERIMENT, **more: Any) -> dict[str, Any]:
    known = {"url": "serial:///dev/ttyTEST", "experiment": as_mapping(experiment), "law": False}
    return {**known, "current_quantum_a": QUANTUM_A, "reference_count": 12, **more}


def numbers_of(experiment: Any) -> list[float]:
    """Return the numbers of a loop that is started with this experiment, computed independently."""
    made = controller.for_experiment(experiment, current_quantum_a=QUANTUM_A, reference_count=12)
    return [float(made.control["wall_position"][0]), *made.law.parameters.tolist()]


def take_set(ring: Ring) -> tuple[int, list[float]]:
    into = np.full(SET_FLOATS, np.nan)
    number = take(ring.mailbox, into.view(np.uint8))
    return number, into[~np.isnan(into)].tolist()


@pytest.fixture
def ring(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:  # type: ignore[no-untyped-def]
    """Return the memory of a loop in this process, listed as the only running loop."""
    with Ring.allocate(1, info=info_of(), shared=True) as ring:
        path = f"/proc/self/fd/{ring.descriptor}"
        loop = running.RunningLoop(1, 0.0, 0, "trial", False, False, control_words.LAYOUT_VERSION, {}, path)
        monkeypatch.setattr(running, "running", lambda: [loop])
        yield ring


def test_a_change_arrives_as_the_numbers_of_an_experiment_begun_with_it(ring: Ring) -> None:
    done = live.change_wall({"wall.stiffness": 400.0, "damping": 1.5}, patience_s=0)
    assert (done.number, done.active, done.ended) == (1, False, False)
    assert done.changes == {"wall.stiffness": 400.0, "wall.damping": 1.5}
    assert done.wall["stiffness"] == 400.0
    expected = override(EXPERIMENT, {"wall.stiffness": 400.0, "wall.damping": 1.5})
    assert take_set(ring) == (1, numbers_of(expected))


def test_a_second_change_keeps_the_first_also_before_the_loop_has_taken_it(ring: Ring) -> None:
    live.change_wall({"stiffness": 400.0}, patience_s=0)
    live.change_wall({"pull": "allow"}, patience_s=0)
    done = live.change_wall({"position": 0.01}, patience_s=0)
    both = {"wall.stiffness": 400.0, "wall.pull": "allow", "wall.position": 0.01}
    assert take_set(ring) == (3, numbers_of(override(EXPERIMENT, both)))
    assert done.number == 3
    assert ring.info["parameter_sets"] == [
        {"number": 1, "changes": {"wall.stiffness": 400.0}},
        {"number": 2, "changes": {"wall.pull": "allow"}},
        {"number": 3, "changes": {"wall.position": 0.01}},
    ]
    assert ring.info["experiment"]["wall"]["pull"] == "allow"
    assert ring.info["url"] == "serial:///dev/ttyTEST"


def gate_info(**changes: Any) -> dict[str, Any]:
    """Return the "gate" entry of a loop's info: an armed real device with a delay of twenty ticks."""
    return {"gate": {"delay_ticks": 20, "simulated": False, "forced": False, **changes}}


@pytest.mark.parametrize(
    ("gate", "refused"),
    [
        (gate_info(), True),
        (gate_info(delay_ticks=1), False),
        (gate_info(simulated=True), False),
        (gate_info(forced=True), False),
        ({"gate": None}, False),
    ],
)
def test_a_wall_that_the_gate_refuses_is_not_activated_later(gate: dict[str, Any], refused: bool) -> None:
    ring = Ring.allocate(1, info=info_of(**gate))
    if not refused:
        assert live._post(ring, {"wall.stiffness": 400.0})[0] == 1
        return
    with pytest.raises(PlanError, match="unstable at 20000 Hz with 20 ticks"):
        live._post(ring, {"wall.stiffness": 400.0})
    assert take_set(ring)[0] == 0


CHANGES = st.one_of(
    st.tuples(st.just("stiffness"), st.floats(50.0, 450.0)),
    st.tuples(st.just("damping"), st.just(0.0) | st.floats(1e-6, 2.0)),
    st.tuples(st.just("pull"), st.sampled_from(["allow", "clamp"])),
)


@settings(max_examples=10)
@given(st.lists(CHANGES, min_size=1, max_size=4))
def test_any_sequence_of_changes_ends_where_all_of_them_at_once_would(changes: list[tuple[str, Any]]) -> None:
    ring = Ring.allocate(1, info=info_of())
    for name, value in changes:
        live._post(ring, {f"wall.{name}": value})
    at_once = override(EXPERIMENT, {f"wall.{name}": value for name, value in changes})
    assert take_set(ring) == (len(changes), numbers_of(at_once))


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"controller.estimator": "kalman"}, ConfigError, "one of these keys: wall.stiffness, wall.damping"),
        ({"wall.side": -1}, ConfigError, "wall.side cannot change while a loop runs"),
        ({"wall.law": "bilateral"}, ConfigError, "cannot change while a loop runs"),
        ({"stifness": 3.0}, ConfigError, "cannot change while a loop runs"),
        ({}, ConfigError, "no parameter to change is given"),
        ({"stiffness": -1.0}, ConfigError, r"wall.stiffness.*-1"),
        ({"stiffness": "hard"}, ConfigError, "wall.stiffness"),
        ({"pull": "sometimes"}, ConfigError, "wall.pull"),
        ({"stiffness": 0.01}, PlanError, "window"),
        ({"stiffness": 1e6}, ConfigError, "at most 477"),
    ],
)
def test_a_forbidden_change_is_refused_and_not_posted(
    ring: Ring, changes: dict[str, Any], error: type[Exception], message: str
) -> None:
    before = ring.info_and_word()
    with pytest.raises(error, match=message):
        live.change_wall(changes, patience_s=0)
    assert ring.writer().posted == 0
    assert ring.info_and_word() == before


@pytest.mark.parametrize("loop", ["host", "device"])
def test_a_bilateral_wall_is_not_changed_while_it_runs(loop: str) -> None:
    """Its spring acts on both sides, so the handle is never outside it."""
    experiment = override(EXPERIMENT, {"wall.law": "bilateral", "controller.loop": loop})
    ring = Ring.allocate(1, info=info_of(experiment))
    with pytest.raises(PlanError, match="both sides"):
        live._post(ring, {"wall.stiffness": 100.0})
    assert ring.writer().posted == 0


@pytest.mark.parametrize(
    ("info", "message"),
    [
        ({}, "does not report which experiment"),
        (info_of(law=True), "is defined in the program that runs it"),
        (info_of(experiment=EXPERIMENT) | {"experiment": {"wall": {}}}, "the running experiment"),
    ],
)
def test_a_loop_that_cannot_be_changed_from_outside_is_left_alone(info: dict[str, Any], message: str) -> None:
    ring = Ring.allocate(1, info=info)
    with pytest.raises(RigError, match=message):
        live._post(ring, {"wall.stiffness": 400.0})
    assert ring.writer().posted == 0


def test_a_loop_that_has_ended_is_not_changed() -> None:
    ring = Ring.allocate(1, info=info_of())
    ring.put(control_words.LOOP_DONE, 1)
    with pytest.raises(RunEndedError, match="has ended"):
        live._post(ring, {"wall.stiffness": 400.0})


def test_the_loop_is_watched_until_it_has_taken_the_change(ring: Ring) -> None:
    posted: list[int] = []

    def commit(number: int) -> None:
        posted.append(number)
        threading.Timer(0.05, lambda: ring.put(control_words.PARAMETER_SET, number)).start()

    done = live.change_wall({"stiffness": 400.0}, patience_s=20, posted=commit)
    assert done.active
    assert posted == [1]


def test_a_loop_that_ends_before_it_takes_the_change_is_reported_as_ended(ring: Ring) -> None:
    end = partial(ring.put, control_words.LOOP_DONE)
    done = live.change_wall({"stiffness": 400.0}, patience_s=20, posted=end)
    assert (done.active, done.ended) == (False, True)


def test_two_terminals_at_once_lose_no_change() -> None:
    """Both read the wall and change a different key of it; the slower one must retry with the new wall."""
    ring = Ring.allocate(1, info=info_of())

    def change(name: str, values: list[float]) -> None:
        for value in values:
            live._post(ring, {f"wall.{name}": value})

    with ThreadPoolExecutor(2) as threads:
        changed = threads.map(change, ("stiffness", "damping"), ([310.0, 320.0, 330.0], [1.0, 1.1, 1.2]))
        assert list(changed) == [None, None]
    last = override(EXPERIMENT, {"wall.stiffness": 330.0, "wall.damping": 1.2})
    assert take_set(ring) == (6, numbers_of(last))
