"""A short blind session in a browser, by keys: operator's desk and participant's screen, STOP, a reload, to its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.core.sample import Phase
from rig.recording.reader import open_recording
from rig.session.log import Event, read
from tests.system.test_session_console import PROTOCOL

HITS = 8  # that may end early or be spoiled, before this machine has no time for a loop
ASKED = "ready?", "the verdict?", "How tired?", "end the session?"


def events(place: Path, kind: str) -> list[Event]:
    (log,) = place.glob("sessions/*/P01/session.log")
    return [one for one in read(log) if one.kind == kind]


def key(page: Any, key: str) -> None:
    """Press a key about the question that stands there, and wait until something else does."""
    before = page.locator(".question").inner_text()
    page.keyboard.press(key)
    page.locator(f".operator:not(:has(.question:text-is({before!r}))), .sessions .setup").first.wait_for()


def asked(page: Any) -> str:
    """What is asked once something is, whatever goes wrong with a hit; the hand then lets go."""
    page.locator(".answers:has-text('go'), .answers:has-text('stable'), .line:visible").first.wait_for()
    return str(page.locator(".question").inner_text())


def press_the_wall(page: Any) -> None:
    """Begin a hit, and reach into the wall when the cue comes."""
    key(page, "g")
    page.locator(".cue:text-is('go'), .answers:has-text('skip')").first.wait_for()
    page.keyboard.press("End")


def test_a_short_blind_session_by_keys(console_page: Any, tmp_path: Path) -> None:
    page = console_page
    (tmp_path / "blind.toml").write_text(PROTOCOL.format(duration_s=4.0, reach_s=60.0, rate=250))
    frames: list[Any] = []
    page.on("websocket", lambda socket: socket.on("framereceived", frames.append))
    page.reload()
    page.get_by_role("button", name="Sessions").click()
    page.get_by_label("protocol").fill("blind.toml")
    page.get_by_label("code").fill("P01")
    page.get_by_label("handle").select_option("keyboard")
    page.get_by_label("loses samples").check()
    page.get_by_role("button", name="Begin").click()
    page.locator(".question:text-is('ready?')").wait_for()
    page.reload()  # the question is there again, and so is who operates
    page.locator(".question:text-is('ready?')").wait_for()
    with page.context.expect_page() as opened:
        page.get_by_text("participant's screen").click()
    participant = opened.value
    participant.locator(".cue:text-is('ready')").wait_for()
    page.bring_to_front()
    page.wait_for_timeout(1200)  # until the page that was reloaded is taken to be gone

    press_the_wall(page)
    page.locator(".gauges:has-text('trial')").wait_for()
    page.keyboard.press("Space")
    page.locator(".question:has-text('hit ended early')").wait_for()
    stopped = events(tmp_path, "trial")[-1].content
    rows = open_recording(tmp_path / "sessions/console/P01" / stopped["recording"])
    assert (stopped["ended"], rows.trailer["reason"]) == ("stopped", "stopped")
    assert rows.rows["phase"][-1] == Phase.TRIAL

    judged = 0
    for _ in range(4 * HITS):
        question = asked(page)
        if question == "the verdict?":
            judged += 1
            (participant if judged == 1 else page).keyboard.press("2")
            page.locator(".operator:not(:has(.question:text-is('the verdict?')))").wait_for()
        elif question.startswith("How tired?"):
            participant.get_by_role("button", name="5", exact=True).click()
            page.locator(".question:text-is('end the session?')").wait_for()
        elif question == "end the session?":
            page.keyboard.press("g")
            page.get_by_text("session of P01: complete").wait_for()
            break
        else:
            press_the_wall(page)
            page.locator(".answers:has-text('go'), .answers:has-text('stable')").first.wait_for()
    assert [one.content["reason"] for one in events(tmp_path, "ended")] == ["complete"]
    assert [one.content["verdict"] for one in events(tmp_path, "judged")] == ["buzz", "buzz"]
    assert events(tmp_path, "answered")[0].content["answer"] == 5
    told = b"\n".join(one if isinstance(one, bytes) else one.encode() for one in frames)
    assert b"How tired?" in told
    for secret in (b"hidden-name", b'stiffness": 10', b'effort_applied": -', b'"kind": "live"'):
        assert secret not in told, secret
