"""The course: the commands of its pages run as they stand, and print the numbers of its answers.

The first line of a TOML block names its file. In an answer a number between backticks is printed by a command of the
page; ``a / b = c`` is calculated.
"""

from __future__ import annotations

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from tests.conformance.guides import ROOT
from tests.conformance.tiers import first_by_default
from tests.system.test_docs import run_line

COURSE = ROOT / "rig" / "docs" / "course"
PAGES = sorted(COURSE.glob("[0-9]*.md"))
BLOCK = re.compile(r"^```(sh|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ANSWERS = re.compile(r"<details>(.*?)</details>", re.DOTALL)
SPAN = re.compile(r"`([^`\n]+)`")
SUM = re.compile(r"[\d.\s()+*/e-]+")


def test_there_are_six_exercises_and_each_has_questions_and_answers() -> None:
    assert len(PAGES) == 6
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert "## Questions" in text
        assert SPAN.search("".join(ANSWERS.findall(text))), page.name
        assert f"]({page.name})" in (COURSE / "index.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("page", first_by_default(PAGES), ids=lambda page: page.stem)
def test_every_command_runs_and_the_answers_have_its_numbers(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = page.read_text(encoding="utf-8")
    printed = _run_page(text)
    for answer in ANSWERS.findall(text):
        for span in SPAN.findall(answer):
            if " = " in span and SUM.fullmatch(left := span.partition(" = ")[0]):
                right = float(span.partition(" = ")[2])
                assert right == pytest.approx(eval(left), rel=0.02), span
            elif span[0].isdigit():
                assert span in printed, f"{page.name}: {span} is not what the commands print"


def _run_page(text: str) -> str:
    """Write the files of a page and run its commands; return their output."""
    output = StringIO()
    with redirect_stdout(output):
        for kind, block in BLOCK.findall(text):
            if kind == "toml":
                Path(block.splitlines()[0].lstrip("# ")).write_text(block, encoding="utf-8")
            for line in block.splitlines() if kind == "sh" else ():
                if line.strip():
                    run_line(line)
    return re.sub(r"\s+", " ", output.getvalue())
