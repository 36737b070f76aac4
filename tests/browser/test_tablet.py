"""The page on a tablet in both orientations: every control is reachable by a finger, which drags, slides and stops."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.browser.test_live import check_stopped, state, until, wait_for_trial

FINGER_PX = 24  # least height of a target (WCAG 2.2, 2.5.8)
SIZES = [(1024, 768), (768, 1024)]
VIEWS = ["Live", "Sessions", "Maps", "Recordings", "Devices"]


class Finger:
    """One finger on the touch screen, which moves in small steps."""

    def __init__(self, page: Any) -> None:
        self._page = page
        self._glass = page.context.new_cdp_session(page)

    def _dispatch_touch(self, kind: str, *points: tuple[float, float]) -> None:
        touches = [{"x": x, "y": y} for x, y in points]
        self._glass.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

    @contextmanager
    def drags(self, element: Any, start: float, end: float) -> Iterator[None]:
        """Drag along an element, from one share of its width to another; lift the finger at the end of the block."""
        element.scroll_into_view_if_needed()
        box = element.bounding_box()
        x, y = (lambda share: box["x"] + share * box["width"]), box["y"] + box["height"] / 2
        self._dispatch_touch("touchStart", (x(start), y))
        for step in range(1, 26):
            self._dispatch_touch("touchMove", (x(start + (end - start) * step / 25), y))
            self._page.wait_for_timeout(20)
        yield
        self._dispatch_touch("touchEnd")


@pytest.fixture(params=SIZES, ids=["across", "upright"])
def tablet(request: pytest.FixtureRequest, console: Any, open_page: Any) -> Any:
    width, height = request.param
    return open_page(console.url, viewport={"width": width, "height": height}, has_touch=True, is_mobile=True)


def test_a_finger_drags_the_handle_slides_the_wall_and_stops(tablet: Any, tmp_path: Path) -> None:
    page, finger = tablet, Finger(tablet)
    page.get_by_role("button", name="Drag the handle").tap()
    wait_for_trial(page)
    handle = page.locator("canvas.handle")
    with finger.drags(handle, 0.35, 0.6):
        state(page, "inside the wall")
    with finger.drags(handle, 0.35, 0.3):
        pass
    page.locator("#state", has_not_text="inside the wall").wait_for()
    stiffness = page.get_by_label("stiffness K").last
    before = float(stiffness.input_value())
    with finger.drags(page.get_by_label("stiffness K").first, 0.25, 0.1):
        pass
    assert float(stiffness.input_value()) < before
    page.get_by_text("is active").wait_for()
    stop = page.get_by_role("button", name="STOP")
    assert stop.bounding_box()["y"] < 100, "in the header, wherever the view was scrolled"
    stop.tap()
    state(page, "ended: stopped")
    check_stopped(tmp_path)


def test_every_view_fits_and_is_within_reach_of_a_finger(tablet: Any) -> None:
    page = tablet
    for view in VIEWS:
        page.get_by_role("button", name=view, exact=True).tap()
        page.wait_for_timeout(300)
        until(page, "document.documentElement.scrollWidth <= innerWidth")
        small = page.evaluate(
            "[...document.querySelectorAll('button, select, input:not([type=checkbox])')]"
            f".filter((one) => one.offsetParent && one.getBoundingClientRect().height < {FINGER_PX})"
            ".map((one) => one.outerHTML.slice(0, 120))"
        )
        assert small == [], view
        stop = page.get_by_role("button", name="STOP").bounding_box()
        assert stop["x"] + stop["width"] <= page.viewport_size["width"], view
