"""Recordings in a real browser: hostile names stay text; one is opened, replayed, drawn, exported and deleted."""

from pathlib import Path
from typing import Any

import pytest

from rig.config import presets
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from tests.browser.test_live import until

WAIT_MS = 300_000
NAME = "<img src=x onerror=alert(1)>.parquet"


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """A directory with a hit and a file whose name would be markup."""
    place = tmp_path / "recordings"
    list(hit(HitRequest(experiment=presets.load("koul-compliant"), output=place, name="one"), admit))
    (place / NAME).write_bytes(b"no recording")
    return place


def test_a_recording_is_found_replayed_exported_and_restored(recordings: Path, console_page: Any) -> None:
    page = console_page
    page.get_by_role("button", name="Recordings", exact=True).click()
    rows = page.locator(".found tbody tr")
    rows.nth(1).wait_for(timeout=WAIT_MS)
    assert NAME.removesuffix(".parquet") in page.locator(".found").inner_text()
    assert page.locator(".found img").count() == 0, "a name that would be markup is text"
    page.get_by_role("searchbox").fill("koul-compliant butterworth")
    rows.nth(1).wait_for(state="detached")
    page.get_by_role("button", name="one", exact=True).click()
    charts = page.locator("section[aria-label=Recording] .u-wrap")
    charts.nth(2).wait_for(timeout=WAIT_MS)

    page.get_by_label("replay through").select_option("fdm")
    page.get_by_text("Through fdm the velocity differs by").wait_for(timeout=WAIT_MS)
    page.get_by_role("button", name="Picture").click()
    page.locator("img.picture").wait_for(timeout=WAIT_MS)
    assert (recordings / "one.png").exists()
    recording = page.locator("section[aria-label=Recording]")
    small = page.locator(".found img")
    small.wait_for()
    until(page, "document.querySelector('.found img').naturalWidth > 0")
    page.get_by_role("button", name="Effort over penetration").click()
    page.get_by_role("img", name="Effort over penetration").wait_for()
    for kind, begins in (("png", b"\x89PNG"), ("svg", b"<svg"), ("csv", b"time (s),")):
        with page.expect_download() as saved:
            recording.get_by_label("save").select_option(kind)
        found = Path(saved.value.path()).read_bytes()
        assert found.startswith(begins)
        assert kind != "svg" or b"ideal spring" in found, "what is seen"
    recording.get_by_label("save").select_option("cut")
    page.get_by_text("rows as one-cut.parquet").wait_for()
    with page.expect_download() as download:
        page.get_by_label("Export as").select_option("csv")
    assert download.value.suggested_filename == "one.csv"
    with open(download.value.path()) as file:
        assert file.readline().startswith("tick,")

    page.get_by_role("button", name="Move to trash").click()
    page.get_by_role("heading", name="one.parquet is in the trash").wait_for()
    assert sorted(path.name for path in (recordings / "trash").iterdir()) == ["one.parquet", "one.png"]
    page.get_by_label("show the trash").check()
    page.get_by_role("button", name="Restore").click()
    page.get_by_text("no recordings in").wait_for()
    assert (recordings / "one.parquet").exists()


def test_a_bucket_pairs_the_deepest_penetration_with_the_strongest_effort(console_page: Any) -> None:
    """Every point of a spring, drawn from minima and maxima, lies on its line for a wall on either side."""
    for side in (1, -1):
        depth, stiffness = [0.1, 0.4, 0.2, 0.5], 10.0  # least and greatest of two buckets
        effort = [-side * stiffness * one for one in depth]
        sent = [one for place in (0, 2) for one in sorted(effort[place : place + 2])]
        found = console_page.evaluate(
            "([x, y, side]) => import('./effort_plane.js').then(({ pairs }) => pairs(x, y, side, 2))",
            [depth, sent, side],
        )
        assert [-side * y for _, y in found] == pytest.approx([stiffness * x for x, _ in found])
