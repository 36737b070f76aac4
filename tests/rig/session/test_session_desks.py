"""A session's desk for its operator: alike at a terminal and at a page; the console that a terminal's desk starts."""

import errno
import itertools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from rig.core.errors import ConfigError, RigError, StoppedError
from rig.core.sample import Phase
from rig.realtime.hand import SharedHand, Wish
from rig.session.engine._desk import Action, DeskView, Question
from rig.session.planning._protocol import Keys
from rig.session.terminal import _child as child
from rig.session.terminal._pointer import HandKind
from rig.session.terminal.desk import ConsoleDesk, at_console
from tests.conformance.started import WAIT_S, is_alive
from tests.conformance.terminal import Program, Terminal
from tests.rig.session.session_desks import PLACES, Place, answered, until, watched
from tests.rig.session.session_fakes import FakeRunner, protocol_of

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
        reply.result(WAIT_S)
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


# The console at a terminal: a hang, a death, and the terminal's settings restored afterwards.


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    with Terminal() as one:
        yield one


@contextmanager
def console(terminal: Terminal, **options: Any) -> Iterator[tuple[ConsoleDesk, ThreadPoolExecutor]]:
    """Yield a desk at this terminal and a thread for its questions, which ends with the terminal."""
    with ThreadPoolExecutor(1) as asker, ConsoleDesk(place=Path(terminal.path), **options) as desk:
        try:
            yield desk, asker
        except BaseException:
            terminal.close()  # a console without a terminal says so, and the question ends
            raise


def assert_given_back(terminal: Terminal) -> None:
    assert terminal.attributes_are_back()
    assert "\x1b" not in terminal.printed  # no screen of its own, no mode


def wait_for_console(terminal: Terminal, number: int, *texts: str) -> None:
    """Wait until the console of this number, counted from 1, has printed the texts."""

    def printed() -> bool:
        _, *consoles = terminal.printed.split("[SPACE] STOP")
        return len(consoles) == number and all(text in consoles[-1] for text in texts)

    terminal.until(printed, f"{texts} of console {number}")


def test_an_escape_waits_for_no_silence_and_closing_gives_the_terminal_of_a_stopped_console_back(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages wake the console all the time; the escape key must still time out at its own age."""
    monkeypatch.setattr("rig.session.terminal._child.END_S", 0.05)
    pause, deadline = threading.Event(), time.monotonic() + WAIT_S
    with console(terminal) as (desk, _):
        desk.show(DeskView(state="hold"))
        terminal.wait("hold")
        terminal.type("\x1b")
        while "escape has no function" not in terminal.printed:
            assert time.monotonic() < deadline
            desk.show(DeskView(state="hold"))
            pause.wait(0.01)
        os.kill(desk.pid, signal.SIGSTOP)
    assert_given_back(terminal)


def test_a_stopped_console_ends_the_hit_and_is_replaced(terminal: Terminal) -> None:
    with console(terminal, silence_s=0.2, hung_s=0.3) as (desk, asker):
        desk.show(DeskView(state="hold", code="P07"))
        terminal.wait("P07")
        stopped = desk.pid
        os.kill(stopped, signal.SIGSTOP)
        error = watched(desk)
        assert "no message from the console for 0.2 s" in error.message
        assert "resume" in error.remedy
        for number in range(200):  # a full pipe must not block the session
            desk.show(
                DeskView(state="hold", code="P07", lines=tuple(f"line {number}" * 20 for _ in range(8)))
            )
        reply = asker.submit(desk.ask, VERDICT)
        wait_for_console(terminal, 2, "the verdict?", "P07")
        terminal.type("1")
        assert answered(reply) == ("judge", "stable")
        assert not Path(f"/proc/{stopped}").exists()
    assert terminal.attributes_are_back()


def test_a_console_that_dies_is_started_anew_with_the_same_question(terminal: Terminal) -> None:
    with console(terminal, silence_s=20.0) as (desk, asker):
        desk.show(DeskView(state="verdict?", code="P08"))
        reply = asker.submit(desk.ask, VERDICT)
        terminal.wait("the verdict?")
        before = desk.pid
        os.kill(before, signal.SIGKILL)
        wait_for_console(terminal, 2, "the verdict?", "P08")
        assert desk.pid != before
        terminal.type("3")
        assert answered(reply) == ("judge", "unstable")
        before = desk.pid
        os.kill(before, signal.SIGKILL)  # in a hit: a new one comes, and the hit continues
        watch, deadline = desk.watch(), time.monotonic() + WAIT_S
        assert watch is not None
        while desk.pid == before and time.monotonic() < deadline:
            watch(0, Phase.TRIAL)
        os.kill(desk.pid, signal.SIGKILL)
        terminal.type("1\x1b ")  # SPACE before the next console is there is STOP, too
        assert "stopped at the console" in str(watched(desk))
    assert_given_back(terminal)


def test_a_console_that_dies_again_and_again_ends_the_session(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.session.terminal.desk.RESTARTS", 1)
    with console(terminal) as (desk, asker):
        reply = asker.submit(desk.ask, VERDICT)
        for number in (1, 2):
            wait_for_console(terminal, number, "the verdict?")
            os.kill(desk.pid, signal.SIGKILL)
        with pytest.raises(StoppedError, match="failed 2 times") as caught:
            reply.result(WAIT_S)
        assert "resume" in caught.value.remedy
    assert_given_back(terminal)


@pytest.mark.parametrize("place", ["nowhere", "no-terminal"])
def test_a_session_without_a_terminal_is_refused(place: str, tmp_path: Path) -> None:
    (tmp_path / "no-terminal").write_text("g1g1")
    with pytest.raises(ConfigError, match="needs a terminal for the operator") as caught:
        ConsoleDesk(place=tmp_path / place)
    assert "--rehearse" in caught.value.remedy


# A session's program of its own: the kernel's signals, an end without a word.

PROGRAM = """
import sys
from rig.core.errors import RigError
from rig.session.terminal import _child as child
from rig.session.terminal.desk import ConsoleDesk
from rig.session.engine._desk import DeskView, Question

child.END_S = 0.05  # of one that is stopped
with ConsoleDesk() as desk:
    print("console", desk.pid, file=sys.stderr, flush=True)
    desk.show(DeskView(state="verdict?", code="P09"))
    try:
        while True:
            reply = desk.ask(Question(kind="verdict", text="?", actions=("judge", "redo", "note")))
            print(reply.action, reply.value, file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr, flush=True)
    except RigError as error:
        print(error, file=sys.stderr, flush=True)
"""


@contextmanager
def program(terminal: Terminal) -> Iterator[tuple[Program, int]]:
    started = terminal.run(sys.executable, "-c", PROGRAM, cwd=Path(__file__).parents[3])
    try:
        assert started.shell.stderr is not None
        yield started, int(started.shell.stderr.readline().split()[1])
    finally:
        started.end()


@pytest.mark.signals
def test_ctrl_c_reaches_the_session_past_a_stopped_console(terminal: Terminal) -> None:
    with program(terminal) as (started, child):
        terminal.wait("P09", "[1] stable")
        terminal.type("\x1a\x1c\x13")  # ^Z, ^\\ and ^S do nothing but be unknown keys
        terminal.wait("ctrl+s has no function")
        os.kill(child, signal.SIGSTOP)
        terminal.type("\x03")
        _, err = started.wait()
        assert err == "interrupted\n"
    assert_given_back(terminal)


def test_a_console_whose_session_is_gone_gives_the_terminal_back(terminal: Terminal) -> None:
    with program(terminal) as (started, child):
        terminal.wait("P09", "[1] stable")
        os.kill(started.pid, signal.SIGKILL)
        terminal.wait("rig session resume")
        pause, deadline = threading.Event(), time.monotonic() + WAIT_S
        while is_alive(child) and time.monotonic() < deadline:
            pause.wait(0.005)
        assert_given_back(terminal)


@pytest.mark.parametrize(
    ("name", "works"),
    [
        ("tempfile.TemporaryFile", 0),
        ("os.pipe", 0),
        ("os.pipe", 1),
        ("subprocess.Popen", 0),
        ("threading.Thread", 0),
    ],
)
def test_a_console_that_does_not_start_leaves_nothing(
    name: str, works: int, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = attrgetter(name)(child), itertools.count()

    def refuse(*given: Any, **more: Any) -> Any:
        if next(calls) == works:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return real(*given, **more)

    monkeypatch.setattr(f"{child.__name__}.{name}", refuse)
    before = sorted(os.listdir("/proc/self/fd"))
    with pytest.raises(RigError, match="cannot be started: Too many open files") as caught:
        ConsoleDesk(place=Path(terminal.path))
    monkeypatch.undo()
    assert caught.value.remedy
    assert sorted(os.listdir("/proc/self/fd")) == before


def test_a_hand_of_a_console_that_is_refused_leaves_no_file(
    terminal: Terminal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*given: Any) -> Any:
        raise RigError("the console cannot be started")

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("rig.session.terminal.desk.Child", refuse)
    runner = FakeRunner()
    with pytest.raises(RigError, match="cannot be started"):
        at_console(hand="keyboard", place=Path(terminal.path))(protocol_of(), {}, runner)
    assert list(tmp_path.iterdir()) == []
    assert runner.hand is None
