"""The documents' first wall in a browser: pushed by mouse, touch and keys, judged, sent as a link; no other host."""

import re
from typing import Any

import pytest

from tests.browser.conftest import SIZE
from tests.browser.test_tablet import Finger
from tests.sim_backend.test_browser import built_page

# Click a step of the rehearsal; a series ends within a fraction of a second, so the same task reads the buttons.
CLICK = """(place) => {
  const steps = [...document.querySelectorAll(".steps button")];
  steps[place].click();
  return steps.map((step) => step.disabled);
}"""
SCREENS = {"desk": (SIZE, "light"), "phone": ({"width": 390, "height": 844}, "dark")}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page as a file, which no server serves."""
    return (built_page(tmp_path_factory) / "index.html").as_uri()


@pytest.mark.smoke
@pytest.mark.parametrize("screen", SCREENS)
def test_a_wall_is_pushed_judged_and_sent_without_a_server(address: str, open_page: Any, screen: str) -> None:
    size, scheme = SCREENS[screen]
    page = open_page(f"{address}#rig=koul-rigid&B=0", viewport=size, color_scheme=scheme, has_touch=True)
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    verdict = page.locator(".share .verdict")
    verdict.wait_for()
    assert page.locator(".share .command").inner_text() == "rig hit --rig koul-rigid --loop device -B 0"
    with Finger(page).drags(page.locator("canvas.handle"), 0.35, 0.6):
        page.locator("#state", has_text="inside the wall").wait_for()
    page.keyboard.press("Escape")
    assert page.locator("#state").inner_text() == "ended: stopped"
    page.locator("canvas.handle").focus()
    for _ in range(60):
        page.keyboard.press("ArrowRight")
    page.locator("#state", has_text="inside the wall").wait_for()
    page.get_by_label("damping B").last.fill("0.5")
    page.get_by_label("damping B").last.dispatch_event("change")
    page.wait_for_url(re.compile(r"B=0\.5&"))
    page.get_by_role("button", name="Automatic hit").click()
    page.locator("#state", has_text="ended: finished").wait_for()
    assert verdict.inner_text() == page.locator(".panel:not(.share) .verdict").first.inner_text() == "stable"
    page.get_by_text("To compare, first hit with: Uniform, 20 kHz; Dual-rate, 20 and 2 kHz.").wait_for()
    compare = page.get_by_role("button", name="3 Compare")
    for place, scheme in enumerate(("Uniform, 20 kHz", "Dual-rate, 20 and 2 kHz")):
        assert compare.is_disabled()
        assert page.evaluate(CLICK, place) == [True] * 3, "one series at a time"
        page.get_by_text(f"{scheme}: 9 hits.").wait_for()
    compare.click()
    page.get_by_text("linear theory: stable up to").last.wait_for()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    box = page.locator("#stop").bounding_box()
    middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    assert page.evaluate("([x, y]) => document.elementFromPoint(x, y)?.id", middle) == "stop"
    assert all(url.startswith("file:") for url in requests)
    assert page.context.cookies() == []


@pytest.mark.smoke
def test_stop_ends_what_a_pointer_or_a_key_still_holds(address: str, open_page: Any) -> None:
    page = open_page(address)
    state, handle = page.locator("#state"), page.locator("canvas.handle")
    page.get_by_role("button", name="Drag the handle").click()
    page.locator("#state", has_text="trial").wait_for()
    assert page.get_by_text("starting …").count() == 0
    box = handle.bounding_box()
    x, y = (lambda share: box["x"] + share * box["width"]), box["y"] + box["height"] / 2
    page.mouse.move(x(0.3), y)
    page.mouse.down()
    page.mouse.move(x(0.4), y, steps=5)
    page.keyboard.press("Escape")
    page.mouse.move(x(0.6), y, steps=5)
    page.wait_for_timeout(200)
    assert state.inner_text() == "ended: stopped"
    page.mouse.up()
    handle.focus()
    page.keyboard.down("ArrowRight")
    page.locator("#state", has_text="trial").wait_for()
    page.keyboard.press("Escape")
    page.keyboard.down("ArrowRight")  # repeats, as a held key does
    page.wait_for_timeout(200)
    assert state.inner_text() == "ended: stopped"
