"""The files of the page: the vendored library is unmodified, and nothing is loaded from another host."""

import hashlib
import re
from importlib.resources import files

import pytest

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
