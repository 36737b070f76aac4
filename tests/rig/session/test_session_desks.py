"""A session's desk for its operator: the same behaviour at a terminal and at a page of the console."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from rig.core.errors import ConfigError, StoppedError
from rig.core.sample import Phase
from rig.realtime.hand import SharedHand, Wish
from rig.session.engine._desk import Action, DeskView, Question
from rig.session.planning._protocol import Keys
from rig.session.terminal._pointer import HandKind
from tests.conformance.terminal import PATIENCE_S
from tests.rig.session.session_desks import PLACES, Place, answered, until, watched

READY: tuple[Action, ...] = ("go", "pause", "skip", "redo", "note", "abort")
VERDICT = Question(kind="verdict", text="the verdict?", actions=("judge", "redo", "note", "abort"), trial=3)
READY_QUESTION = Question(kind="ready", text="ready?", actions=READY)

Sit = Callable[..., Place]


@pytest.fixture
def asker() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as one:
        yield one


@pytest.fixture(params=PLACES)
def sit(request: pytest.FixtureRequest, asker: ThreadPoolExecutor) -> Iterator[Sit]:
    """Yield a function that makes a desk with an operator; the desks end before `asker`, which may be waiting."""
    places: list[Place] = []

    def make(
        keys: Keys | None = None, hand: tuple[HandKind, Path] | None = None, silence_s: float = 20.0
    ) -> Place:
        places.append(PLACES[request.param](keys or Keys(), hand, silence_s))
        return places[-1]

    yield make
    for place in places:
        place.leave()  # a question that still waits ends
        place.close()


def test_a_session_is_shown_and_answered_by_keys(sit: Sit, asker: ThreadPoolExecutor) -> None:
    place = sit()
    place.desk.show(DeskView(state="ready", say="Push.", code="P03", block=2, blocks=5, trial=34, trials=120))
    reply = asker.submit(place.desk.ask, READY_QUESTION)
    place.sees("P03 · block 2 of 5 · trial 34 of about 120", "ready?", "Push.", "[g] go")
    place.press("n")
    place.line("b c")
    assert answered(reply) == ("note", "b c")
    reply = asker.submit(place.desk.ask, replace(READY_QUESTION, text="ready now?"))
    place.sees("ready now?")
    place.press("x")
    place.sees("x has no function")
    place.press("?")
    place.sees("verdict: unsure")
    place.press("a")  # acts there as it would without the page of the keys
    place.sees("leave the session")
    place.press("g")
    place.sees("abort: cancelled")
    place.press("g")
    assert answered(reply) == ("go", "")
    place.desk.show(DeskView(state="go"))
    reply = asker.submit(place.desk.ask, VERDICT)
    place.sees("[1] stable")
    place.press("2")
    assert answered(reply) == ("judge", "buzz")
    reply = asker.submit(place.desk.ask, Question(kind="rest", text="Rest.", actions=("go",), seconds=0.1))
    assert answered(reply) == ("go", "")
    assert reply.result().took_s >= 0.05
    assert place.rings == 3  # twice for ready, once for the hit


def test_a_pedal_and_no_bell_and_a_question_ends_with_its_desk(sit: Sit, asker: ThreadPoolExecutor) -> None:
    place = sit(Keys(stable="f5", bell=False))
    reply = asker.submit(place.desk.ask, VERDICT)
    place.sees("[f5] stable")
    place.press("f5")
    assert answered(reply) == ("judge", "stable")
    reply = asker.submit(place.desk.ask, READY_QUESTION)
    place.sees("ready?")
    place.press("enter")
    assert answered(reply) == ("go", "")
    assert place.rings == 0
    reply = asker.submit(place.desk.ask, replace(VERDICT, text="and now?"))
    place.sees("and now?")
    place.leave()
    with pytest.raises(StoppedError, match=r"was closed|was lost") as caught:
        reply.result(PATIENCE_S)
    assert caught.value.remedy


def test_space_stops_the_hit_that_runs_and_not_the_next_one(sit: Sit, asker: ThreadPoolExecutor) -> None:
    place = sit()
    place.desk.show(DeskView(state="hold"))
    place.sees("hold")
    place.press("space")
    assert "stopped at the console" in str(watched(place.desk))
    reply = asker.submit(place.desk.ask, READY_QUESTION)
    place.sees("ready?")
    place.press("space")
    place.sees("STOP: nothing is moving")
    place.press("g")
    assert answered(reply) == ("go", "")
    watch = place.desk.watch()
    assert watch is not None
    watch(0, Phase.TRIAL)


@pytest.mark.parametrize(
    "sit", ["page"], indirect=True
)  # at a terminal: test_a_stopped_console_ends_the_hit…
def test_a_silent_desk_ends_a_hit(sit: Sit) -> None:
    place = sit(silence_s=0.1)
    place.desk.show(DeskView(state="hold", code="P07"))
    place.sees("P07")
    place.hang()
    error = watched(place.desk)
    assert "no message from the console for 0.1 s" in error.message
    assert "resume" in error.remedy


def wait_for_wish(hand: SharedHand, right: Callable[[Wish], bool]) -> Wish:
    """Wait until the request to the hand fulfils a condition, and return it."""
    found: list[Wish] = []

    def is_there() -> bool:
        wish = hand.read()
        found[:] = [wish] if wish is not None else []
        return bool(found) and right(found[0])

    until(is_there, "the wish")
    return found[0]


@pytest.fixture
def hand(tmp_path: Path) -> Iterator[SharedHand]:
    path = tmp_path / "of" / "hand"
    path.parent.mkdir()
    with SharedHand.create(path) as one:
        yield one


def test_the_hand_follows_the_keys_but_not_those_in_a_note_and_is_back_before_a_trial(
    sit: Sit, asker: ThreadPoolExecutor, hand: SharedHand
) -> None:
    place = sit(hand=("keyboard", hand.path))
    place.desk.show(DeskView(state="hold", scale={"start": 0.1, "wall": 0.5}))
    place.sees("hold", "hand:")
    place.press("end")
    assert wait_for_wish(hand, lambda one: one.position > 0.7).position == pytest.approx(0.8)
    assert wait_for_wish(hand, lambda one: one.press > 3.9).press == pytest.approx(4.0)
    place.press("home")
    again = wait_for_wish(hand, lambda one: one.position < 0.1)
    assert (again.position, again.press) == (pytest.approx(0.0), 0.0)
    wait_for_wish(hand, lambda one: one.sequence > again.sequence + 2)  # repeated: else the hand would rest
    place.press("end")
    wait_for_wish(hand, lambda one: one.press == 4.0)
    reply = asker.submit(place.desk.ask, READY_QUESTION)
    place.sees("ready?")
    wait_for_wish(hand, lambda one: one.press == 0.0)
    place.press("n")
    place.sees("note, then enter:")
    for key in ("end", "left"):  # they belong to the line that is typed
        place.press(key)
    place.line("abc")
    assert answered(reply) == ("note", "abc")
    found = wait_for_wish(hand, lambda one: True)
    assert (found.position, found.press) == (pytest.approx(0.1), 0.0)


def test_a_key_that_moves_the_hand_means_nothing_else(sit: Sit, hand: SharedHand) -> None:
    with pytest.raises(ConfigError, match=r"go = 'right': this key already moves the simulated hand"):
        sit(Keys(go="right"), hand=("keyboard", hand.path))
