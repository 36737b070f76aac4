"""A map in a real browser: start it, watch it fill, move by keys, and open one of its hits by a click."""

import re
from typing import Any

SETTINGS = "trial.duration_s = 0.8\nverdict.tail_s = 0.2\nhoming.settle_s = 0.02"
COMPILING_MS = 300_000


def test_a_map_fills_in_and_a_click_on_a_cell_opens_that_hit(console_page: Any, tmp_path: Any) -> None:
    page = console_page
    page.get_by_role("button", name="Maps", exact=True).click()
    page.get_by_label("Schemes, one per line").fill("uniform:20k")
    page.get_by_label("dampings B").fill("0,0.3")
    page.get_by_role("textbox", name="stiffness K").fill("20:100")
    page.get_by_label("Other settings, one per line").fill(SETTINGS)
    page.get_by_role("button", name="Start the map").click()
    finished = page.get_by_text(re.compile(r"^finished: 4 of 4 columns, \d+ cells$"))
    finished.wait_for(timeout=COMPILING_MS)
    page.get_by_role("columnheader", name="linear theory").wait_for(timeout=COMPILING_MS)
    page.locator(".list").get_by_text("finished").wait_for()
    (place,) = (tmp_path / "maps").iterdir()
    assert (place / "map.json").exists()

    canvas = page.locator("canvas.plane")
    canvas.focus()
    page.keyboard.press("ArrowUp")
    status = page.locator(".map p[role=status]").first
    softest = status.inner_text()
    assert re.match(
        r"K 20 N·m/rad, B 0 N·m·s/rad · zero at 0.1 count · stable; passes: felt, heard, any", softest
    )
    page.keyboard.press("ArrowUp")
    assert status.inner_text() != softest
    page.keyboard.press("Enter")
    page.get_by_role("heading", name=re.compile(r"^koul-compliant-K21\.2-B0-\w+\.parquet$")).wait_for(
        timeout=COMPILING_MS
    )
    page.locator("section[aria-label=Recording] .u-wrap").first.wait_for()
    assert [path.name for path in (tmp_path / "recordings").glob("*.parquet")]
