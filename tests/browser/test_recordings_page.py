"""Recordings in a real browser: hostile names stay text; one is opened, replayed, drawn, exported, thrown away."""

from pathlib import Path
from typing import Any

import pytest

from rig.config import presets
from rig.experiments.hit import HitRequest, hit

WAIT_MS = 300_000
NAME = "<img src=x onerror=alert(1)>.parquet"


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """A hit, and a file with a name that would be markup."""
    place = tmp_path / "recordings"
    list(hit(HitRequest(experiment=presets.load("koul-compliant"), output=place, name="one")))
    (place / NAME).write_bytes(b"no recording")
    return place


def test_a_recording_is_found_opened_replayed_drawn_exported_and_kept_in_the_trash(
    recordings: Path, console_page: Any
) -> None:
    page = console_page
    page.get_by_role("button", name="Recordings", exact=True).click()
    rows = page.locator(".found tbody tr")
    rows.nth(1).wait_for(timeout=WAIT_MS)
    assert NAME.removesuffix(".parquet") in page.locator(".found").inner_text()
    assert page.locator(".found img").count() == 0
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
    with page.expect_download() as download:
        page.get_by_label("Export as").select_option("csv")
    assert download.value.suggested_filename == "one.csv"
    with open(download.value.path()) as file:
        assert file.readline().startswith("tick,")

    page.get_by_role("button", name="Move to trash").click()
    page.get_by_role("heading", name="one.parquet is in the trash").wait_for()
    assert sorted(path.name for path in (recordings / "trash").iterdir()) == ["one.parquet", "one.png"]
    page.get_by_label("those in the trash").check()
    page.get_by_role("button", name="Restore").click()
    page.get_by_text("none in").wait_for()
    assert (recordings / "one.parquet").exists()
