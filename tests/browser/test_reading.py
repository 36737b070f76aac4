"""Accessibility of the page: names, spoken text, operation by keys, and contrast of colours."""

import re
from pathlib import Path
from typing import Any

import pytest

from tests.browser.test_live import until

VIEWS = ["Live", "Sessions", "Maps", "Recordings", "Devices"]
ROLES = "button|textbox|spinbutton|slider|combobox|checkbox|searchbox|link|meter|progressbar|img|application"
UNNAMED = re.compile(rf"^\s*- (?:{ROLES})(?! \")(?: .*|:.*)?$", re.MULTILINE)
FAR = 80  # keys to anything of a view
# Texts that stand out less from the nearest ground behind them than WCAG 2.2 (1.4.3) asks: 4.5, or 3 where large.
FAINT = """() => {
  const parts = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = (rgb) => rgb.slice(0, 3).map((one) => one / 255)
    .map((one) => one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4)
    .reduce((sum, one, i) => sum + one * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = parts(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] > 0.99) return colour;
    }
    return [255, 255, 255];
  };
  const found = [];
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = texts.nextNode(); node; node = texts.nextNode()) {
    const element = node.parentElement;
    if (!node.textContent.trim() || !element.checkVisibility() || element.closest("option, :disabled")) continue;
    const style = getComputedStyle(element);
    const [dark, bright] = [light(parts(style.color)), light(ground(element))].sort((a, b) => a - b);
    const size = parseFloat(style.fontSize);
    const least = size >= 24 || (size >= 18.66 && style.fontWeight >= 700) ? 3 : 4.5;
    if ((bright + 0.05) / (dark + 0.05) < least) found.push(`${node.textContent.trim()} ${style.color}`);
  }
  return found;
}"""


def view(page: Any, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()
    page.wait_for_timeout(300)


def check_readable(page: Any) -> None:
    """Require sufficient contrast of every text, and an accessible name of every control."""
    assert page.evaluate(FAINT) == []
    snapshot = page.locator("body").aria_snapshot()
    assert UNNAMED.findall(snapshot) == [], snapshot


def tab_to(page: Any, element: Any) -> None:
    """Press Tab until an element has the focus."""
    for _ in range(FAR):
        if element.evaluate("(one) => one === document.activeElement"):
            return
        page.keyboard.press("Tab")
    pytest.fail(f"Tab does not lead to {element}")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_each_text_stands_out_and_each_control_has_a_name(scheme: str, console: Any, open_page: Any) -> None:
    page = open_page(console.url, color_scheme=scheme)
    page.get_by_text("By linear theory with").wait_for()
    for name in VIEWS:
        view(page, name)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "at 1280 × 720"
        check_readable(page)
    page.goto(page.url + (page.locator("a[href^=participant]").get_attribute("href") or ""))
    page.get_by_text("Please wait").wait_for()
    check_readable(page)


def test_keys_alone_hit_a_wall_read_it_and_open_its_recording(console_page: Any, tmp_path: Path) -> None:
    page = console_page
    stiffness = page.get_by_label("stiffness K, slider")
    until(page, "[...document.querySelectorAll('.side input[type=number]')].some((one) => one.value)")
    tab_to(page, stiffness)
    page.keyboard.press("ArrowLeft")
    assert re.fullmatch(r"[\d.]+ N·m/rad", stiffness.get_attribute("aria-valuetext") or ""), "not its place"
    tab_to(page, page.get_by_role("button", name="Automatic hit"))
    page.keyboard.press("Enter")
    page.get_by_role("status").filter(has=page.locator(".verdict")).wait_for()
    state = page.locator("#state[role=status]")
    assert state.inner_text().startswith("ended: "), "states stand where they are read aloud"

    tab_to(page, page.get_by_role("button", name="Pause"))
    page.keyboard.press("Enter")
    charts = page.get_by_role("application", name="Charts over time")
    tab_to(page, charts)
    page.keyboard.press("ArrowRight")
    readout = page.locator(".scope [role=status]")
    first = readout.inner_text()
    assert re.match(r"t [\d.]+ s, position ", first)
    page.keyboard.press("Shift+ArrowLeft")
    assert readout.inner_text() != first
    page.keyboard.press("Enter")
    page.keyboard.press("Shift+ArrowRight")
    assert readout.inner_text().startswith("Δt 0.2 s"), "ten hundredths of two seconds"
    page.keyboard.press("+")
    scope = "rigConsole.scope"
    until(page, f"{scope}.zoomed && {scope}.zoomed.length > 10")
    span = page.evaluate(f"{scope}.zoomed.newest - {scope}.zoomed.oldest")
    assert 0.2 < span < 1.01, "half of it, as far as there is something"

    tab_to(page, page.get_by_role("button", name="Recordings", exact=True))
    page.keyboard.press("Enter")
    (recording,) = (tmp_path / "recordings").glob("*.parquet")
    tab_to(page, page.get_by_role("button", name=recording.stem, exact=True))
    page.keyboard.press("Enter")
    page.locator("section[aria-label=Recording] .u-wrap").nth(2).wait_for()
    tab_to(page, page.locator(".found").get_by_role("searchbox"))
    page.keyboard.type("no such words")
    page.get_by_text("no recordings in").wait_for()
