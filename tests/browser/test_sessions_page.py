"""A short blind session in a browser, operated by keys: desk, participant's screen, STOP, reload, to its end."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rig.core.sample import Phase
from rig.recording.reader import open_recording
from rig.session.engine._log import Event, read
from rig.session.terminal._held import RELEASED_S
from tests.browser.test_reading import check_readable
from tests.conformance.tolerance import too_busy
from tests.extras.console.test_session_console import PROTOCOL

PATIENCE_S = 120.0  # a first run compiles
REACH = (
    5  # large steps from the start into the wall, with a third of the hand's press: no effort at its limit
)
QUESTIONS = 40  # before this machine has no time for a loop
SECRETS = ("hidden-name", '"say": "loop"', '"kind": "live"')


def events(place: Path, kind: str) -> list[Event]:
    (log,) = place.glob("sessions/*/P01/session.log")
    return [one for one in read(log) if one.kind == kind]


def until(page: Any, condition: Callable[[], Any], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"never: {what}; {page.locator('.sessions').inner_text()}"
        page.wait_for_timeout(30)


def question(page: Any) -> str:
    return str(page.locator(".question").inner_text())


def offers(page: Any, *names: str) -> bool:
    shown = page.locator(".answers").inner_text()
    return any(name in shown for name in names)


def press_the_wall(page: Any) -> None:
    """Start a trial and press into the wall at the cue; return early if the page shows another question."""
    before = question(page)
    page.wait_for_timeout(1e3 * RELEASED_S)  # the same key sooner would be one that is held
    page.keyboard.press("g")
    until(page, lambda: question(page) != before, f"no more: {before}")
    until(page, lambda: page.locator(".cue").inner_text() == "go" or offers(page, "go"), "the cue")
    for _ in range(REACH):
        page.keyboard.press("ArrowUp")


def test_a_short_blind_session_by_keys(console_page: Any, tmp_path: Path) -> None:
    page, frames = console_page, list[Any]()

    def keep(frame: str | bytes) -> None:
        frames.append(frame)

    (tmp_path / "blind.toml").write_text(PROTOCOL.format(duration_s=5.0, reach_s=1.0, rate=250))
    page.on("websocket", lambda socket: socket.on("framereceived", keep))
    page.get_by_role("button", name="Sessions").click()
    form = page.locator(".setup")
    form.get_by_label("protocol").fill("blind.toml")
    form.get_by_label("code").fill("P01")
    form.get_by_label("handle").select_option("keyboard")
    form.get_by_label("loses samples").check()
    form.get_by_role("button", name="Begin").click()
    until(page, lambda: question(page) == "ready?", "the first question")
    page.reload()
    until(page, lambda: question(page) == "ready?", "the question once more")
    with page.context.expect_page() as opened:
        page.get_by_text("participant's screen").click()
    participant = opened.value
    participant.locator(".cue:text-is('Get ready')").wait_for()
    for one in (page, participant):
        check_readable(one)
    page.bring_to_front()
    free = page.locator("#operate:enabled")
    until(page, free.is_visible, "no operator, since the page was reloaded")

    for _ in range(QUESTIONS):
        press_the_wall(page)
        until(page, lambda: "trial" in page.locator(".gauges").inner_text() or offers(page, "go"), "a trial")
        if not offers(page, "go"):
            break
    page.keyboard.press("Space")
    until(page, lambda: "hit ended early" in question(page), "the hit's end")
    stopped = events(tmp_path, "trial")[-1].content
    recording = open_recording(tmp_path / "sessions/console/P01" / stopped["recording"])
    assert recording.trailer is not None
    assert (stopped["ended"], recording.trailer["reason"]) == ("stopped", "stopped")
    assert recording.rows["phase"][-1] == Phase.TRIAL

    for _ in range(QUESTIONS):
        until(page, lambda: offers(page, "go", "stable") or page.locator(".line").is_visible(), "a question")
        asked = question(page)
        if asked == "the verdict?":
            judge = page if events(tmp_path, "judged") else participant
            judge.keyboard.press("2")
            until(page, lambda: question(page) != "the verdict?", "a verdict that was taken")
        elif "How tired?" in asked:
            participant.get_by_role("button", name="5", exact=True).click()
            until(page, lambda: question(page) == "end the session?", "an answer that was taken")
        elif asked == "end the session?":
            page.wait_for_timeout(1e3 * RELEASED_S)
            page.keyboard.press("g")
            page.get_by_text("session of P01: complete").wait_for()
            break
        elif "cools" in asked:
            until(page, lambda: "cools" not in question(page), "a motor that is cool")
        else:
            press_the_wall(page)
            until(page, lambda: offers(page, "go", "stable") or page.locator(".line").is_visible(), "the end")
    else:
        too_busy("every hit was spoiled")
    assert [one.content["reason"] for one in events(tmp_path, "ended")] == ["complete"]
    assert [one.content["verdict"] for one in events(tmp_path, "judged")] == ["buzz", "buzz"]
    assert events(tmp_path, "answered")[0].content["answer"] == 5
    shown = "\n".join(one if isinstance(one, str) else one.decode("latin-1") for one in frames)
    assert "How tired?" in shown
    for secret in SECRETS:
        assert secret not in shown, secret
