"""The course: commands on its pages run unchanged, and print the numbers in the instructor's answers.

The first line of a TOML block names its file. In an answer a number between backticks is printed by a command of the
exercise; ``a / b = c`` is calculated.
"""

import re
import shlex
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from tests.conformance.guides import ROOT
from tests.system.test_docs import run_line
from tests.system.test_examples import run

COURSE = ROOT / "rig" / "docs" / "course"
PAGES = sorted(COURSE.glob("[0-9]*.md"))
BLOCK = re.compile(r"^```(sh|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INSTRUCTOR = (COURSE / "instructor.md").read_text(encoding="utf-8")
ANSWERS = dict(re.findall(r"^### (\d)\. .*?\n(.*?)(?=^##|\Z)", INSTRUCTOR, re.MULTILINE | re.DOTALL))
SPAN = re.compile(r"`([^`\n]+)`")
SUM = r"[\d.\s()+*/e-]+"


def test_the_sums_of_the_answers_are_right() -> None:
    sums = [span.split(" = ") for span in SPAN.findall(INSTRUCTOR) if re.fullmatch(rf"{SUM} = {SUM}", span)]
    assert len(sums) > 10
    for left, right in sums:
        assert float(right) == pytest.approx(eval(left), rel=0.02), left


@pytest.mark.exhaustive("tests/rig/testing/test_asserts.py::test_a_damped_wall_passes_them_all")
def test_the_assignment_is_marked_as_the_page_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "handed-in").mkdir()
    for name, text in re.findall(r"^```python\n# (\S+)\n(.*?)^```$", INSTRUCTOR, re.MULTILINE | re.DOTALL):
        (tmp_path / name).write_text(text, encoding="utf-8")
    ((command, points),) = re.findall(r"```sh\n(pytest .*?)```\n```text\n(.*?)```", INSTRUCTOR, re.DOTALL)
    marking, counting = command.splitlines()
    assert marking.endswith(" > marks.txt || true")
    marks = StringIO()
    with redirect_stdout(marks):
        options = shlex.split(marking.partition(" > ")[0])[1:]
        pytest.main([*options, "-p", "rig.testing.plugin", "-p", "no:cacheprovider"])
    Path("marks.txt").write_text(marks.getvalue(), encoding="utf-8")
    assert run(tmp_path, "bash", "-euc", counting) == points


@pytest.mark.exhaustive("tests/system/test_cli.py::test_the_default_hit_is_the_one_of_the_reference_study")
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_runs_and_the_answers_have_its_numbers(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    printed = _run_page(page.read_text(encoding="utf-8"))
    for span in SPAN.findall(ANSWERS[page.name[0]]):
        if span[0].isdigit() and " = " not in span:
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
