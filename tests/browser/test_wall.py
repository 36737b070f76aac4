"""The documents' first wall in a browser: pushed by mouse, touch and keys, judged, sent as a link; no other host."""

import re
from typing import Any

import pytest

from sim_backend.browser.__main__ import build
from tests.browser.conftest import SIZE
from tests.browser.test_tablet import Finger

SCREENS = {"desk": (SIZE, "light"), "phone": ({"width": 390, "height": 844}, "dark")}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page as a file, which no server serves."""
    pytest.importorskip("ziglang", reason="no compiler for WebAssembly: pip install 'haptic-rig[page]'")
    build(place := tmp_path_factory.mktemp("wall"))
    return (place / "index.html").as_uri()


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
    for step in ("1 Uniform", "2 Dual-rate", "3 Compare"):
        page.get_by_role("button", name=step).click()
    page.get_by_text("linear theory: stable up to").last.wait_for()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert all(url.startswith("file:") for url in requests)
    assert page.context.cookies() == []
