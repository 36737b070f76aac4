"""The course lab: every command of its pages runs as it stands, and every number of its answers is what they print.

In a page a shell block is executed line by line; a TOML block whose first line is a comment with a file's name is that
file. In the answers a number between backticks stands in what the page's commands printed; ``a / b = c`` is calculated.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from tests.conformance.guides import ROOT
from tests.conformance.tiers import first_by_default

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
@pytest.mark.parametrize("page", first_by_default(PAGES, 2), ids=lambda page: page.stem)
def test_every_command_runs_and_the_answers_have_its_numbers(page: Path, run: Any) -> None:
    text = page.read_text(encoding="utf-8")
    printed = "".join(_run_block(kind, block, run) for kind, block in BLOCK.findall(text))
    printed = re.sub(r"\s+", " ", printed)
    for answer in ANSWERS.findall(text):
        for span in SPAN.findall(answer):
            if " = " in span and SUM.fullmatch(left := span.partition(" = ")[0]):
                right = float(span.partition(" = ")[2])
                assert right == pytest.approx(eval(left), rel=0.02), span
            elif span[0].isdigit():
                assert span in printed, f"{page.name}: {span} is not what the commands print"


def _run_block(kind: str, block: str, run: Any) -> str:
    """Do what a block says; what its commands print."""
    if kind == "toml":
        name = block.splitlines()[0].lstrip("# ")
        Path(name).write_text(block, encoding="utf-8")
        return ""
    printed = ""
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        assert words[0] == "rig", line
        target = words[words.index(">") + 1] if ">" in words else None
        code, out, err = run(*(words[1 : words.index(">")] if target else words[1:]))
        assert code == 0, f"{line}\n{err}"
        if target:
            Path(target).write_text(out, encoding="utf-8")
        printed += out
    return printed
