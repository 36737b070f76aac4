"""The console without a terminal: keys and their meaning, questions and answers, and what may be displayed."""

import itertools
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.core.sample import ROW, Phase, RowFlag
from rig.realtime import control_words
from rig.realtime.ring import Ring
from rig.session.engine._desk import Action, DeskView, Question
from rig.session.planning._keymap import KeyMap
from rig.session.planning._protocol import Keys
from rig.session.terminal import _program as program
from rig.session.terminal import _words as words
from rig.session.terminal._conversation import Answer, Conversation, StopPressed
from rig.session.terminal._held import RELEASED_S
from rig.session.terminal._keyboard import Keyboard
from rig.session.terminal._live import Snapshot, snapshot_of
from rig.session.terminal._messages import line_of
from rig.session.terminal._plain import PlainLines
from rig.session.terminal._pointer import Pointer

KEYMAP = KeyMap.of(Keys())
READY: tuple[Action, ...] = ("go", "pause", "skip", "redo", "note", "abort")
SCALE = {
    "start": 0.1, "wall": 0.3, "side": 1, "window": [-1.0, 1.0], "effort_limit": 0.4, "speed_limit": 5.0,
    "position_unit": "rad", "velocity_unit": "rad/s", "effort_unit": "N·m",
}  # fmt: skip
SNAPSHOT = Snapshot(
    phase="trial", position=0.31, velocity=-0.2, penetration=0.01, effort=0.123, peak_effort=0.2, saturated=False,
    round_trip_ns=512_000, late=3, lost=1, skipped=0,
)  # fmt: skip


def make_conversation(question: Question | None = None, view: DeskView | None = None) -> Conversation:
    conversation = Conversation(KEYMAP)
    conversation.see(plain(view or DeskView(state="ready", scale=SCALE)))
    if question is not None:
        assert conversation.ask(plain(question), 0.0) == []
    return conversation


def make_question(kind: Any = "ready", actions: tuple[Action, ...] = READY, **more: Any) -> Question:
    return Question(kind=kind, text="?", actions=actions, **more)


# Keys


@pytest.mark.parametrize(
    ("data", "names"),
    [
        (b"1g", ["1", "g"]),
        (b"\r\n \t\x7f\x08", ["enter", "enter", "space", "tab", "backspace", "backspace"]),
        (b"\x1b[A\x1b[B\x1b[C\x1b[D\x1bOA", ["up", "down", "right", "left", "up"]),
        (b"\x1b[5~\x1b[6~\x1b[15~\x1b[24~\x1bOP\x1b[[B", ["pageup", "pagedown", "f5", "f12", "f1", "f2"]),
        (b"\x03\x1bx\x1b[1;5A", ["ctrl+c", "alt+x", "unknown"]),
        ("ä€😀".encode(), ["ä", "€", "😀"]),
        *(
            (space, ["space"]) for space in (b"\0", b"\x1b[32;2u", b"\x1b[32u", b"\x1b[27;5;32~")
        ),  # with a modifier
    ],
)
def test_bytes_are_keys(data: bytes, names: list[str]) -> None:
    assert Keyboard().feed(data) == names


noise = st.binary(max_size=80) | st.text(st.sampled_from("\x1b[<O0;159~Mm?$yAéx"), max_size=40).map(
    str.encode
)


@settings(max_examples=50)
@given(noise, st.lists(st.integers(1, 7)))
def test_any_bytes_in_any_pieces_are_the_same_keys(data: bytes, lengths: list[int]) -> None:
    whole, pieces = Keyboard(), Keyboard()
    expected = whole.feed(data) + whole.flush()
    found, at = [], 0
    for length in [*lengths, len(data) + 1]:
        found += pieces.feed(data[at : at + length])
        at += length
    assert found + pieces.flush() == expected


# SPACE is STOP

# Also with an input method, or a modifier held.
SPACES = [" ", "\u00a0", "\u1680", "\u2003", "\u202f", "\u3000"]


@pytest.mark.parametrize(
    "before", ["", "\x1b", "\x1bO", "\x1b[", "\x1b[[", "\x1b[1;", "\x1b[<35;1", "\x1b\x1b"]
)
@pytest.mark.parametrize("space", SPACES)
def test_space_is_a_key_after_any_part_of_a_sequence(before: str, space: str) -> None:
    keyboard = Keyboard()
    assert (keyboard.feed(before.encode()) + keyboard.feed(space.encode()))[-1] == "space"
    assert not keyboard.waiting


pieces = st.lists(
    st.tuples(st.one_of(noise, st.sampled_from([b"\x1b", b"\x1bO", b"\xe3\x80"])), st.booleans())
)


@settings(max_examples=60)
@given(pieces, st.sampled_from(SPACES), pieces, st.sampled_from(["", "n", "a", "p", "?"]), st.booleans())
def test_a_space_anywhere_in_what_is_typed_stops_what_moves(
    before: list[tuple[bytes, bool]], space: str, after: list[tuple[bytes, bool]], first: str, live: bool
) -> None:
    conversation, keyboard = make_conversation(make_question() if live else None), Keyboard()
    conversation.press(first)
    conversation.live = live
    found: list[Any] = []
    for data, waited in [*before, (space.encode(), False), *after]:
        if live:
            conversation.ask(plain(make_question()), 0.0)  # whatever was answered meanwhile
        for key in keyboard.feed(data) + (keyboard.flush() if waited else []):
            found += conversation.press(key)
    assert StopPressed() in found


# What they mean


def test_keys_of_a_protocol() -> None:
    keymap = KeyMap.of(Keys(stable="PageUp", go="f1"))
    assert keymap.meaning("pageup") == "stable"
    assert keymap.meaning("enter") == keymap.meaning("f1") == "go"
    assert keymap.meaning("space") == "stop"
    assert keymap.meaning("R") == "redo"
    assert keymap.meaning("1") == ""
    assert KeyMap.from_mapping(plain(keymap)) == keymap


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        (Keys(stable=" "), "always STOP"),
        (Keys(stable="space"), "always STOP"),
        (Keys(redo="Enter"), "always means go"),
        (Keys(note="?"), "lists the keys"),
        (Keys(buzz="1"), "this key already means buzz"),
        (Keys(buzz="G"), "this key already means go|this key already means buzz"),
        (Keys(abort="pedal"), "is not the name of a key"),
    ],
)
def test_impossible_keys_are_refused(keys: Keys, text: str) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        KeyMap.of(keys)
    assert caught.value.remedy


# Questions and answers


@settings(max_examples=30)
@given(
    before=st.integers(1, 60),
    repeat_s=st.floats(0.01, 0.9),
    delay_s=st.floats(0.0, 0.95, allow_subnormal=False),
    trials=st.integers(1, 9),
)
def test_a_stuck_key_answers_no_question(before: int, repeat_s: float, delay_s: float, trials: int) -> None:
    conversation, now_s = make_conversation(), 100.0
    for _ in range(before):
        assert conversation.press("1", now_s) == []
        assert "not possible now" in conversation.notice
        now_s += repeat_s
    now_s += max(0.0, delay_s - repeat_s)
    for _ in range(trials):
        conversation.ask(plain(make_question("verdict", ("judge", "redo"))), now_s - 1e-3)
        for _ in range(30):
            assert conversation.press("1", now_s) == []
            assert "release it" in conversation.notice
            now_s += repeat_s
        assert conversation.press("space", now_s) == [StopPressed()]  # STOP is no answer
    assert conversation.press("1", now_s + RELEASED_S) == [Answer("judge", "stable")]


def test_a_key_judges_once_however_long_it_is_held() -> None:
    conversation = make_conversation(make_question("verdict", ("judge", "redo")))
    presses = [conversation.press("1", 1.0 + 0.03 * n) for n in range(100)]
    assert [one for one in presses if one] == [[Answer("judge", "stable")]]
    conversation.ask(plain(make_question("verdict", ("judge", "redo"))), 4.0)
    assert conversation.press("1", 4.01) == []
    assert conversation.press("3", 4.02) == [Answer("judge", "unstable")]  # another key is another press


def test_a_held_key_neither_confirms_what_it_asked_for_nor_answers_with_an_empty_line() -> None:
    conversation = make_conversation(make_question())
    assert conversation.press("s", 1.0) == []
    assert conversation.press("s", 1.5) == []
    assert conversation.twice == "skip"
    assert conversation.press("y", 1.6) == [Answer("skip")]
    item = {"kind": "text"}
    conversation.press("enter", 2.0)
    conversation.ask(plain(make_question("item", ("answer", "note", "abort"), item=item)), 2.1)
    assert conversation.press("enter", 2.2) == []
    for place, key in enumerate("oo"):
        assert conversation.press(key, 2.3 + 0.03 * place) == []  # text is text
    assert conversation.press("enter", 2.4) == [Answer("answer", "oo")]


def test_a_held_key_of_a_hit_still_stops_it() -> None:
    conversation = make_conversation()
    conversation.live = True
    assert conversation.press("a", 1.0) == []
    assert conversation.press("a", 1.03) == [StopPressed()]


@pytest.mark.parametrize("action", ["pause", "note"])
def test_pause_and_note_wait_for_the_next_question(action: Action) -> None:
    conversation = make_conversation()
    assert conversation.press(KEYMAP.key_of(action)) == []
    assert conversation.later == action
    answered = conversation.ask(plain(make_question()), 0.0)
    if action == "pause":
        assert answered == [Answer("pause")]
    else:
        assert conversation.entry is not None
        assert type_line(conversation, "ok") == [Answer("note", "ok")]


def type_line(conversation: Conversation, text: str) -> list[Any]:
    for character in text:
        assert conversation.press("space" if character == " " else character) == []
    return conversation.press("enter")


def test_abort_and_skip_ask_once() -> None:
    for action in ("abort", "skip"):
        conversation = make_conversation(make_question())
        key = KEYMAP.key_of(action)
        assert conversation.press(key) == []
        assert conversation.twice == action
        assert conversation.press("1") == []  # no, and nothing else
        assert conversation.twice is None
        assert conversation.press(key) == []
        assert conversation.press("y" if action == "skip" else key) == [Answer(action)]


def test_abort_in_a_hit_stops_it_and_answers_the_next_question() -> None:
    conversation = make_conversation()
    conversation.live = True
    assert conversation.press("a") == []
    assert conversation.press("y") == [StopPressed()]
    assert conversation.ask(plain(make_question()), 0.0) == [Answer("abort")]


def test_the_page_of_the_keys_hides_no_stop_and_no_question() -> None:
    conversation = make_conversation()
    conversation.live = True
    conversation.press("?")
    conversation.press("space")
    assert not conversation.help
    conversation.press("?")
    assert conversation.help
    conversation.ask(plain(make_question("trouble", ("go", "abort"))), 0.0)
    assert not conversation.help


@pytest.mark.parametrize(
    ("key", "outcome"),
    [
        ("1", [Answer("judge", "stable")]),
        ("r", [Answer("redo")]),
        ("space", [StopPressed()]),
        *((leaves, []) for leaves in ("?", "enter", "escape")),
    ],
)
def test_a_key_on_the_page_of_the_keys_does_what_the_page_says(key: str, outcome: list[Any]) -> None:
    conversation = make_conversation(make_question("verdict", ("judge", "redo", "note", "abort")))
    conversation.press("?")
    assert conversation.press(key) == outcome
    assert not conversation.help
    assert (conversation.question is None) == any(isinstance(one, Answer) for one in outcome)


@settings(max_examples=40)
@given(st.text(st.sampled_from("1234grpnsa?y "), max_size=20), st.booleans())
def test_typed_text_is_never_a_command(text: str, note: bool) -> None:
    item = {"kind": "text"}
    conversation = make_conversation(
        make_question("item", ("answer", "redo", "note", "abort"), item=item) if not note else make_question()
    )
    if note:
        conversation.press("n")
    for character in text:
        assert conversation.press("space" if character == " " else character) == []
    assert (conversation.help, conversation.twice, conversation.later, conversation.notice) == (
        False, None, None, "",
    )  # fmt: skip
    kind: Action = "note" if note else "answer"
    found = conversation.press("enter")
    assert found == ([Answer(kind, text.strip())] if text.strip() or not note else [])


def test_a_rest_ends_itself_but_not_under_a_note() -> None:
    conversation = make_conversation()
    conversation.ask(plain(make_question("rest", ("go", "note", "abort"), seconds=10.0)), 100.0)
    assert conversation.left_s(104.0) == 6.0
    assert conversation.pass_time(109.0) == []
    conversation.press("n")
    assert conversation.pass_time(111.0) == []
    conversation.press("escape")
    assert conversation.pass_time(111.0) == [Answer("go")]
    assert conversation.pass_time(112.0) == []


keys_pressed = st.lists(
    st.sampled_from(
        ["1", "3", "g", "r", "p", "n", "s", "a", "y", "x", "?", "space", "enter", "escape", "backspace"]
    )
)
questions = st.sampled_from(
    [
        make_question(),
        make_question("verdict", ("judge", "redo", "note", "abort")),
        make_question("rest", ("go", "note", "abort"), seconds=5.0),
        make_question("paused", ("go", "note", "abort")),
        make_question("item", ("answer", "note", "abort"), item={"kind": "scale", "lowest": 1, "highest": 7}),
    ]
)


@settings(max_examples=60)
@given(st.lists(st.tuples(questions, keys_pressed), min_size=1, max_size=4))
def test_an_answer_is_always_one_that_was_asked_for(rounds: list[tuple[Question, list[str]]]) -> None:
    conversation = Conversation(KEYMAP)
    for question, keys in rounds:
        outcomes = conversation.ask(plain(question), 0.0)
        for key in keys:
            stands = conversation.question
            outcomes += conversation.press(key)
            if key == "space" and stands is None:
                assert isinstance(outcomes[-1], StopPressed)
        answers = [one for one in outcomes if isinstance(one, Answer)]
        assert len(answers) <= 1
        assert all(one.action in question.actions for one in answers)


# What may be seen


@settings(max_examples=40)
@given(st.floats(0, 2, allow_subnormal=False), st.booleans())
def test_a_blinded_effort_is_a_word(share: float, saturated: bool) -> None:
    limit = SCALE["effort_limit"]
    assert isinstance(limit, float)
    live = replace(SNAPSHOT, peak_effort=share * limit, effort=share * limit, saturated=saturated)
    gauge = words.gauges(DeskView(state="hit", scale=SCALE), live)[words.GAUGES.index("effort")]
    assert gauge.text in ("low", "half", "near the limit", "saturated")
    assert gauge.share in (0.1, words.HALF, words.NEAR, 1.0)  # nor is the bar a number
    if saturated:
        assert gauge.text == "saturated"


def test_a_blinded_console_shows_neither_effort_nor_wall() -> None:
    def shown(view: DeskView) -> str:
        lines = PlainLines().lines(make_conversation(view=view), SNAPSHOT, 0.0)
        facts = [" ".join(fact) for fact in words.facts(view)]
        return "\n".join([*lines, *facts, *(gauge.text for gauge in words.gauges(view, SNAPSHOT))])

    text = shown(DeskView(state="hit", scale=SCALE))
    assert "N·m" not in text
    assert "0.123" not in text
    assert text.count("hidden") == 2
    assert "half" in text
    view = DeskView(state="hit", scale=SCALE, blinded=False, condition="dual", stiffness=25.5, damping=0.1)
    for part in ("+0.123 N·m", "K = 25.5, B = 0.1", "dual", "+0.0100 rad", "-0.200 rad/s", "0.51 ms", "3, 1"):
        assert part in shown(view)


def test_each_line_is_printed_once() -> None:
    conversation, printer = make_conversation(make_question("verdict", ("judge", "redo"))), PlainLines()
    first = printer.lines(conversation, None, 0.0)
    assert first[-1].startswith("? [1] stable")
    assert printer.lines(conversation, None, 1.0) == []
    conversation.press("1")
    conversation.see(plain(DeskView(state="hit", lines=("one", "two"))))
    assert printer.lines(conversation, SNAPSHOT, 2.0) == [
        "state: hit",
        "phase: trial",
        "log: one",
        "log: two",
    ]
    conversation.see(plain(DeskView(state="hit", lines=("two", "three"))))
    assert printer.lines(conversation, SNAPSHOT, 3.0) == ["log: three"]
    conversation.ask(plain(make_question("verdict", ("judge", "redo"))), 4.0)
    # The same question once more is a new one.
    assert printer.lines(conversation, SNAPSHOT, 4.0) == first[-1:]


# The running loop


def ring_with(rows: int) -> Ring:
    ring = Ring.allocate(8192)
    numbers = np.arange(rows)
    made = np.zeros(rows, ROW)
    made["received_at"] = 1_000_000 * numbers
    made["sent_at"] = made["received_at"] + 100_000
    made["command_sequence"] = numbers % 65536
    made["command_active"] = np.maximum(0, numbers - 2) % 65536  # becomes active two ticks later
    made["effort_applied"] = -0.1
    made["penetration"] = 0.01
    made["flags"][-1:] = RowFlag.SATURATED
    ring.rows[numbers % 8192] = made
    ring.words[control_words.HEAD] = rows
    ring.words[control_words.PHASE] = Phase.TRIAL
    ring.words[control_words.LATE] = 7
    return ring


def test_a_snapshot_is_of_the_newest_rows() -> None:
    assert snapshot_of(Ring.allocate(8192)) is None
    for rows in (5, 500, 8192 + 700, 70_000):
        found = snapshot_of(ring_with(rows))
        assert found is not None
        assert (found.phase, found.late, found.penetration, found.effort) == ("trial", 7, 0.01, -0.1)
        assert (found.peak_effort, found.saturated) == (0.1, True)
        assert found.round_trip_ns == 1_900_000  # named two ticks after it was sent, less what the law took


# The hand


@pytest.mark.parametrize("scale", [SCALE, {**SCALE, "wall": -0.3}])
def test_the_pointer_reaches_from_behind_the_start_into_the_wall(scale: dict[str, Any]) -> None:
    pointer = Pointer(press=4.0)
    assert pointer.intention is None
    pointer.scale(scale)
    start, wall = scale["start"], scale["wall"]
    assert pointer.intention == pytest.approx((start, 0.0))
    pointer.point(0.0, held=False)
    assert pointer.intention == pytest.approx((start - 0.25 * (wall - start), 0.0))
    pointer.point(7.0, held=False)
    assert pointer.intention == pytest.approx((wall + 0.75 * (wall - start), 4.0))
    pointer.point(0.0, held=True)
    assert pointer.intention is not None
    assert pointer.intention[1] == 4.0
    assert pointer.key("end")
    assert pointer.key("left")
    assert not pointer.key("g")
    position, press = pointer.intention
    assert abs(position - wall) < 0.75 * abs(wall - start)
    assert 0.0 < press < 4.0


# Messages


def test_stop_is_in_the_shared_control_words_before_the_session_receives_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """STOP acts on the realtime loop also if the session's program hangs and no longer reads its pipe."""
    pipes = [os.pipe() for _ in range(3)]
    (console_reads, to_console), (_, to_session), (keyboard, _) = pipes
    monkeypatch.setattr(program, "IN", keyboard)
    os.write(to_console, line_of("setup", pid=os.getpid(), keys=plain(KEYMAP), attributes=None, hand=None))
    console = program._Console(console_reads, to_session)
    os.set_blocking(to_session, False)
    with suppress(BlockingIOError):
        while True:
            os.write(to_session, bytes(4096))
    # No question is open, so the handle may move; only then the console's seat also sends STOP to the session.
    assert console._talk.moving
    with Ring.allocate(16, info={}, shared=True) as ring:
        with pytest.raises(BlockingIOError):
            console._seat.do([StopPressed()])
        assert ring.peek(control_words.STOP) != 0
    for descriptor in itertools.chain(*pipes):
        os.close(descriptor)


def test_a_console_that_is_started_anew_within_a_hit_loads_no_loop() -> None:
    modules = "rig.session.terminal.__main__, rig.session.terminal.desk"
    script = f"import sys, {modules}; assert not {{'numba', 'scipy', 'pydantic'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)
