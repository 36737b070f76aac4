"""The files of the page: the vendored library is unmodified, and nothing is loaded from another host."""

import hashlib
import re
from importlib.resources import files

import pytest

from rig.views.plots import style

PAGE = files("rig.extras.console") / "page"
VENDORED = {  # of uPlot 1.6.32 as its makers publish it (npm registry, uplot-1.6.32.tgz, dist/)
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
}
OURS = sorted(
    one.name for one in PAGE.iterdir() if one.name not in VENDORED and not one.name.endswith("LICENSE")
)


@pytest.mark.parametrize("name", VENDORED)
def test_the_vendored_library_is_unchanged_and_licensed(name: str) -> None:
    assert hashlib.sha256((PAGE / name).read_bytes()).hexdigest() == VENDORED[name]
    assert "MIT" in (PAGE / "uPlot.LICENSE").read_text()


@pytest.mark.parametrize("name", OURS)
def test_the_page_requests_no_other_host(name: str) -> None:
    hosts = set(re.findall(r"(?:https?|wss?)://([^/\s\"'`]+)", (PAGE / name).read_text()))
    # www.w3.org is the namespace of SVG, which no browser fetches.
    assert hosts <= {"www.w3.org", "${location.host}"}, hosts


@pytest.mark.parametrize("name", OURS)
def test_text_never_becomes_markup_and_no_code_is_inline(name: str) -> None:
    """Names in recordings come from anywhere, and the content security policy forbids inline code."""
    text = (PAGE / name).read_text()
    for forbidden in (
        "innerHTML",
        "outerHTML",
        "insertAdjacentHTML",
        "document.write",
        "eval(",
        "document.cookie",
    ):
        assert forbidden not in text
    if name.endswith(".html"):
        assert not re.search(r"\son\w+=|style=|<script>|<style", text)


def luminance(colour: str) -> float:
    """Return the relative luminance of #rrggbb (WCAG 2.2)."""
    parts = (int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5))
    linear = (one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in parts)
    return sum(share * one for share, one in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one: str, other: str) -> float:
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def schemes() -> dict[str, dict[str, str]]:
    """Return the colours of the page by name, for light and dark."""
    roots = re.findall(r":root \{(.*?)\}", (PAGE / "style.css").read_text(), re.DOTALL)
    light, dark = (dict(re.findall(r"--([\w-]+): (#\w{6})", root)) for root in roots)
    return {"light": light, "dark": {**light, **dark}}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_and_edges_of_fields_stand_out(scheme: str) -> None:
    """WCAG 2.2 AA requires a contrast of 4.5 for text (1.4.3) and 3 for edges of fields (1.4.11)."""
    colours = schemes()[scheme]
    for ground in (colours["paper"], colours["panel"]):
        for name in ("ink", "quiet", "measured", "stable", "limit-cycle", "unstable", "invalid"):
            assert contrast(colours[name], ground) >= 4.5, name
        assert contrast(colours["edge"], ground) >= 3.0
    assert contrast(colours["paper"], colours["measured"]) >= 4.5, "the first button's text"
    assert contrast("#ffffff", colours["stop"]) >= 4.5


def test_colours_are_those_of_the_pictures() -> None:
    light = schemes()["light"]
    series = {"measured": style.MEASURED, "true": style.TRUE, "sent": style.SENT, "other": style.OTHER}
    kinds = {kind.replace(" ", "-"): colour for kind, colour in style.KINDS.items()}
    for name, colour in {**series, **kinds}.items():
        assert light[name] == colour, name
