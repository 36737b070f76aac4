"""Reports: complete, self-contained, safe against what texts contain, and clear about what is missing."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from rig.papers.frame import Claim, Finding, Picture, Reproduction, Section, Status, Table
from rig.papers.page import render, write_report

NASTY = "</script><script>alert('K < B & \"C\"')</script>"
PNG = b"\x89PNG\r\n\x1a\nnot a picture"


class _Page(HTMLParser):
    """Collects what a test asks of a page, and checks that what opens closes."""

    VOID = ("meta", "img", "br")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.sources: list[str] = []
        self.texts: list[str] = []
        self.scripts = 0
        self._open: list[str] = []
        self.feed(page)
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.ids += [v] if (v := values.get("id")) else []
        self.sources += [v for name in ("src", "href") if (v := values.get(name))]
        self.scripts += tag == "script"
        if tag not in self.VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def made_up() -> Reproduction:
    claims = tuple(
        Claim(
            key=f"c{number}",
            claim=f"claim {number} {NASTY}",
            paper="560",
            finding=Finding(
                status=status, ours="1 < 2", condition="luck" if status is Status.ONLY_WITH else ""
            ),
            needs="nothing",
            rule="a rule",
        )
        for number, status in enumerate(Status)
    )
    section = Section(
        key="figure-5",
        title="Fig. 5 & more",
        text=(NASTY,),
        conditions=("by hand",),
        pictures=(Picture("drawn", "a picture"), Picture("failed", "none")),
        tables=(Table("counts", ("a", "b"), (("x", NASTY),)),),
    )
    return Reproduction(
        name="made-up",
        title="A paper",
        source="someone",
        summary=("a summary",),
        claims=claims,
        sections=(section,),
        numbers={"a": float("nan"), "b": [1.5, NASTY]},
        provenance={"seed": 0, "version": "1"},
        seconds=1.25,
        results=object(),
    )


def test_a_page_has_every_section_and_verdict_and_needs_nothing_from_elsewhere() -> None:
    page = _Page(render(made_up(), {"drawn": PNG}))
    assert {"claims", "figure-5", "provenance", "numbers"} <= set(page.ids)
    said = " ".join(page.texts)
    for verdict in ("reproduced", "reproduced only with luck", "not reproduced"):
        assert verdict in said
    assert "(no picture)" in said  # of the one that failed
    assert all(source.startswith(("data:image/png;base64,", "#")) for source in page.sources)


def test_text_is_escaped_wherever_it_stands() -> None:
    page = render(made_up(), {})
    assert NASTY not in page
    assert _Page(page).scripts == 1
    assert "alert" in page


def test_numbers_are_attached_as_json_that_any_reader_takes(tmp_path: Path) -> None:
    made = made_up()
    html, numbers = write_report(made, {}, tmp_path)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    alone = json.loads(numbers.read_text(encoding="utf-8"), parse_constant=refuse)
    (attached,) = re.findall(
        r'<script type="application/json" id="numbers">(.*?)</script>',
        html.read_text(encoding="utf-8"),
        re.DOTALL,
    )
    assert json.loads(attached, parse_constant=refuse) == alone
    assert alone["numbers"] == {"a": None, "b": [1.5, NASTY]}
    assert [claim["verdict"] for claim in alone["claims"]] == [c.finding.verdict for c in made.claims]


def test_the_same_reproduction_gives_the_same_bytes() -> None:
    assert render(made_up(), {"drawn": PNG}) == render(made_up(), {"drawn": PNG})


def test_claims_are_found_by_key() -> None:
    assert made_up()["c1"].paper == "560"
    with pytest.raises(KeyError):
        made_up()["none"]
