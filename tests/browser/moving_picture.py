"""Record the moving picture of the README: ``python -m tests.browser.moving_picture``.

The handle of the simulated rig is pushed into a wall and, when it is outside again, into a stiffer one, which theory
calls unstable. Chromium sends a frame after each change of the page; the picture takes one each tenth of a second.
"""

from __future__ import annotations

import base64
import io
import math
import tempfile
import time
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.browser.conftest import CHROMIUM, ROOT, SIZE, started_console

PICTURE = ROOT / ".assets" / "console.webp"
FRAMES, FRAME_S, COLOURS = 100, 0.1, 48
STIFFER_S, STIFFNESS = 4.6, "150"


def record(page: Any) -> list[tuple[float, bytes]]:
    """Push twice into the wall; return the time (s) and the PNG of each frame."""
    page.get_by_role("button", name="Drag the handle").click()
    page.locator("#state", has_text="trial").wait_for(timeout=300_000)  # a first run compiles
    box = page.locator("canvas.handle").bounding_box()

    def move(since_s: float) -> None:
        share = 0.5 - 0.28 * math.cos(2.0 * math.pi * since_s / 5.0)
        page.mouse.move(box["x"] + share * box["width"], box["y"] + box["height"] / 2)

    def keep(event: dict[str, Any]) -> None:
        frames.append((event["metadata"]["timestamp"], base64.b64decode(event["data"])))
        session.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})

    move(0.0)
    page.mouse.down()
    page.wait_for_timeout(1000)
    frames: list[tuple[float, bytes]] = []
    session = page.context.new_cdp_session(page)
    session.on("Page.screencastFrame", keep)
    session.send("Page.startScreencast", {"format": "png"})
    started, stiffness = time.monotonic(), page.get_by_label("stiffness K").last
    while (since_s := time.monotonic() - started) < FRAMES * FRAME_S:
        move(since_s)
        if since_s > STIFFER_S and stiffness.input_value() != STIFFNESS:
            stiffness.fill(STIFFNESS)
            stiffness.dispatch_event("change")
        page.wait_for_timeout(15)
    session.send("Page.stopScreencast")
    session.detach()
    return frames


with sync_playwright() as playwright, tempfile.TemporaryDirectory() as place:
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
    with started_console(Path(place)) as console:
        page = browser.new_page(viewport=SIZE)
        page.goto(console.url)
        frames = record(page)
ticks = [frames[0][0] + FRAME_S * number for number in range(FRAMES)]
shown = [[png for at, png in frames if at <= tick][-1] for tick in ticks]
pictures = [Image.open(io.BytesIO(png)).convert("RGB") for png in shown]
palette = pictures[FRAMES // 2].quantize(COLOURS)
# Without loss and in few colours, an animated WebP is a third of a GIF.
first, *others = [one.quantize(palette=palette, dither=Image.Dither.NONE).convert("RGB") for one in pictures]
drawn = {"append_images": others, "duration": round(1e3 * FRAME_S), "lossless": True, "method": 6}
first.save(PICTURE, save_all=True, loop=0, **drawn)
print(f"{PICTURE}: {len(set(shown))} different frames, {PICTURE.stat().st_size / 1e6:.2f} MB")
