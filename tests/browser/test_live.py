"""The live view in a browser: first click to a wall, a judged hit, the scope, and STOP under every page fault."""

import os
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from rig.core.sample import Phase
from rig.experiments.trials.replay import replay
from rig.extras.console.lease import LOOK_S, LOST_S
from rig.extras.console.talk import SILENT_S
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from tests.conformance.tolerance import reason_of, too_busy

SCOPE = "rigConsole.scope"
START = 0.35  # where the handle begins, as a share of the width
MACHINE_S = 1.0  # for its processes to get their turn
# The last: a page that no message reached.
BUSY = [f"ended: {why}" for why in ("link silent", "device fault", "stopped")]


def wait_for_recording(place: Path) -> Recording:
    deadline = time.monotonic() + 60.0
    while not (found := sorted((place / "recordings").glob("*.parquet"))):
        assert time.monotonic() < deadline, f"nothing was sealed: {list(place.rglob('*'))}"
        time.sleep(0.05)
    return open_recording(found[-1])


def until(page: Any, expression: str) -> None:
    """Wait until an expression in the page is true; the page's policy blocks playwright's own function for this."""
    deadline = time.monotonic() + 60.0
    while not page.evaluate(expression):
        assert time.monotonic() < deadline, f"never: {expression}"
        page.wait_for_timeout(20)


def state(page: Any, text: str) -> None:
    page.locator("#state", has_text=text).wait_for()


def wait_for_trial(page: Any) -> None:
    """Wait until the started run is in its trial."""
    ended = page.locator("[data-kind]", has_text="The play ended")
    page.locator("#state", has_text="trial").or_(ended).first.wait_for()
    if ended.count():
        assert ended.get_attribute("data-kind") in ("LinkLostError", "DeviceFaultError"), ended.inner_text()
        too_busy(ended.inner_text())


def drag(page: Any, to: float = 0.6) -> None:
    """Start the simulated rig and drag its handle from its start into the wall."""
    page.get_by_role("button", name="Drag the handle").click()
    wait_for_trial(page)
    box = page.locator("canvas.handle").bounding_box()
    height = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + START * box["width"], height)
    page.mouse.down()
    for share in range(21):
        page.mouse.move(box["x"] + (START + (to - START) * share / 20) * box["width"], height)
        page.wait_for_timeout(20)
    there = page.locator("#state", has_text=re.compile("inside the wall|ended: "))
    there.wait_for()
    if (text := there.inner_text()) in BUSY:
        too_busy(text)
    assert "inside the wall" in text


def check_stopped(place: Path, since_ns: int | None = None, within_s: float = 0.0) -> None:
    """Require that the loop was stopped in the trial, with no sample later than `within_s` after `since_ns`."""
    recording = wait_for_recording(place)
    assert reason_of(recording) == "stopped"
    assert recording.rows["phase"][-1] == Phase.TRIAL
    assert recording.rows["penetration"].max() > 0.0
    if since_ns is not None:
        assert recording.rows["received_at"][-1] <= since_ns + (within_s + MACHINE_S) * 1e9


@pytest.mark.smoke
def test_first_click_to_a_wall_that_is_felt_changed_and_stopped(console_page: Any, tmp_path: Path) -> None:
    page = console_page
    drag(page)
    until(page, f"{SCOPE}.traces.length > 200")
    assert page.evaluate(f"{SCOPE}.hand[1] > {SCOPE}.hand[2]"), (
        "the hand is ahead of the handle: that is the force"
    )
    field = page.get_by_label("damping B").last
    field.fill("0.25")
    field.dispatch_event("change")
    page.get_by_text("Parameter set 1 becomes active when the handle is outside the wall").wait_for()
    page.mouse.up()
    box = page.locator("canvas.handle").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.up()
    page.get_by_text("Parameter set 1 is active").wait_for()
    page.keyboard.press("Escape")
    state(page, "ended: stopped")
    check_stopped(tmp_path)


@pytest.mark.smoke
def test_an_automated_hit_is_judged(console_page: Any) -> None:
    page = console_page
    page.get_by_role("button", name="Automatic hit").click()
    verdict = page.locator(".verdict")
    verdict.wait_for()
    assert verdict.text_content() in ("stable", "limit cycle", "invalid")


def test_the_estimators_settings_are_checked_and_run(console_page: Any, tmp_path: Path) -> None:
    page = console_page
    until(page, "[...document.querySelectorAll('.side input[type=number]')].some((one) => one.value)")
    page.get_by_label("estimator", exact=True).select_option("fdm-butterworth")
    cutoff = page.get_by_label("cutoff_hz", exact=True)
    cutoff.fill("1e9")
    cutoff.dispatch_event("change")
    page.get_by_text("cutoff_hz = 1e+09 Hz is out of range").wait_for()
    page.get_by_label("cutoff_hz, slider").fill("500")  # halfway over seven decades from 0.1 Hz
    assert float(cutoff.input_value()) == pytest.approx(0.1 * 10**3.5, rel=0.01)
    page.locator(".side .notice", has_text="out of range").wait_for(state="hidden")
    page.get_by_role("button", name="Automatic hit").click()
    page.locator(".verdict").wait_for()
    rates = wait_for_recording(tmp_path).experiment["controller"]
    assert rates["estimator"] == "fdm-butterworth"
    assert rates["parameters"] == {"cutoff_hz": pytest.approx(316, rel=0.01)}


def test_the_scope_pauses_zooms_triggers_and_saves(console_page: Any, tmp_path: Path) -> None:
    page = console_page
    page.get_by_role("button", name="Automatic hit").click()
    page.locator(".verdict").wait_for()
    page.get_by_role("button", name="Pause").click()
    chart = page.locator(".u-over").first
    box = chart.bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 20, steps=5)
    page.mouse.up()
    until(page, f"{SCOPE}.zoomed && {SCOPE}.zoomed.length > 10")
    span = page.evaluate(f"{SCOPE}.zoomed.newest - {SCOPE}.zoomed.oldest")
    assert span == pytest.approx(0.2, rel=0.35), "a tenth of two seconds"
    chart.click(position={"x": 100, "y": 20})
    chart.click(position={"x": 200, "y": 20})
    assert "Δt" in page.locator(".scope [role=status]").text_content()
    for kind, begins in (("png", b"\x89PNG"), ("svg", b"<svg"), ("csv", b"time (s),position (rad)")):
        with page.expect_download() as saved:
            page.get_by_label("save").select_option(kind)
        assert Path(saved.value.path()).read_bytes().startswith(begins)
    first, last = page.evaluate(f"[{SCOPE}.zoomed.oldest, {SCOPE}.zoomed.newest]")
    page.get_by_label("save").select_option("cut")
    page.locator(".scope [role=status]", has_text="-cut.parquet").wait_for()
    (path,) = (tmp_path / "recordings").glob("*-cut.parquet")
    cut = open_recording(path)
    assert cut.time_s[-1] == pytest.approx(last - first, abs=0.002), "what was seen"
    assert replay(cut).exact
    page.get_by_role("button", name="Continue").click()
    page.get_by_label("trigger", exact=True).select_option("contact")
    page.get_by_label("window").select_option("0.2")
    until(page, "!document.querySelector('.side button.first').disabled")
    page.get_by_role("button", name="Automatic hit").click()
    until(page, f"{SCOPE}.triggered > 0")
    page.get_by_role("button", name="Effort over penetration").click()
    page.locator("canvas.plane").wait_for()
    with page.expect_download() as saved:
        page.get_by_label("save").select_option("svg")
    assert b"ideal spring" in Path(saved.value.path()).read_bytes(), "what is seen"


def stop_by_mouse(page: Any, console: Any) -> None:
    page.mouse.up()
    page.get_by_role("button", name="STOP").click()


def stop_by_space(page: Any, console: Any) -> None:
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("Space")


def close_the_tab(page: Any, console: Any) -> None:
    page.close()


def kill_the_server(page: Any, console: Any) -> None:
    console.send_signal(signal.SIGKILL)


def hang_the_page(page: Any, console: Any) -> None:
    page.evaluate("setTimeout(() => { for (;;); }, 0)")


def freeze_the_page(page: Any, console: Any) -> None:
    """Send SIGSTOP to the page and its worker, which share one process."""
    browser = page.context.browser.new_browser_cdp_session()
    found = browser.send("SystemInfo.getProcessInfo")["processInfo"]
    console.frozen = [int(one["id"]) for one in found if one["type"] == "renderer"]
    for pid in console.frozen:
        os.kill(pid, signal.SIGSTOP)


def stop_the_server(page: Any, console: Any) -> None:
    os.kill(console.pid, signal.SIGSTOP)


LEASE_S = LOST_S + 2.0 * LOOK_S
ENDS = [
    (stop_by_mouse, 0.0), (stop_by_space, 0.0), (close_the_tab, LEASE_S), (kill_the_server, 0.0),
    (hang_the_page, LEASE_S), (freeze_the_page, LEASE_S), (stop_the_server, SILENT_S),
]  # fmt: skip


@pytest.mark.parametrize(("ends", "within_s"), ENDS, ids=[ends.__name__ for ends, _ in ENDS])
def test_whatever_ends_the_page_ends_what_it_moves(
    ends: Any, within_s: float, console: Any, console_page: Any, tmp_path: Path
) -> None:
    drag(console_page)
    console.frozen = []
    try:
        since_ns = time.monotonic_ns()
        ends(console_page, console)
        check_stopped(tmp_path, since_ns, within_s)
    finally:
        for pid in console.frozen:
            os.kill(pid, signal.SIGCONT)


def test_a_cut_connection_ends_what_its_page_moves(cable: Any, open_page: Any, tmp_path: Path) -> None:
    """Neither end is notified: the page still shows the newest state, and its STOP is lost."""
    page = open_page(cable.url)
    drag(page)
    since_ns = time.monotonic_ns()
    cable.cut()
    stop_by_mouse(page, cable)
    check_stopped(tmp_path, since_ns, LEASE_S)


def test_two_pages_one_operator_and_names_as_text(console: Any, open_page: Any, tmp_path: Path) -> None:
    one, two = open_page(console.url), open_page(console.url)
    one.get_by_role("button", name="Operate").click()
    two.get_by_role("button", name="Another page operates").wait_for()
    assert two.get_by_role("button", name="Drag the handle").is_disabled()
    rig = one.get_by_label("rig", exact=True)
    name = "<script>window.hit = 1</script>.toml"
    rig.evaluate("(select, name) => { select.add(new Option(name)); select.value = name; }", name)
    rig.dispatch_event("change")
    one.locator("#notice").wait_for()
    assert "<script>" in one.locator("#notice").text_content()
    assert one.evaluate("window.hit") is None


def test_consent_given_at_the_terminal_stands_on_the_page(terminal: Any, open_page: Any) -> None:
    console, person = terminal
    page = open_page(console.url)
    page.get_by_label("Device", exact=True).fill("serial:///dev/no-such-rig")
    page.get_by_role("button", name="Automatic hit").click()
    asked = page.locator("#consent")
    asked.wait_for()
    lines = asked.locator("li").all_inner_texts()
    assert lines[0] == "serial:///dev/no-such-rig for a hit on koul-compliant"
    assert lines[-1].startswith("experiment ")
    os.write(person, b"\n")
    page.locator("#notice", has_text="was not armed").wait_for()
    assert asked.is_hidden()
    console.terminate()
    text = console.stdout.read()
    assert all(line in text for line in lines), text


def test_keyboard_alone_moves_the_handle(console_page: Any) -> None:
    page = console_page
    page.get_by_role("button", name="Drag the handle").focus()
    page.keyboard.press("Enter")
    state(page, "trial")
    page.locator("canvas.handle").focus()
    for _ in range(40):
        page.keyboard.press("ArrowRight")
        page.wait_for_timeout(20)
    state(page, "inside the wall")
    page.keyboard.press("Escape")
    state(page, "ended: stopped")
