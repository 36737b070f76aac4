"""Commands and examples of the documentation site run unchanged, or the page states why they cannot."""

import inspect
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import click
import pytest

import rig
import rig.cli
from firmware_protocol.faults import Fault, Input, LimitFlag, Status
from rig.cli._listing import commands
from rig.config._table import parameters
from rig.core.errors import ConfigError, RigError
from rig.core.sample import COLUMNS
from rig.testing import check_law
from rig.views import site
from tests.conformance.commands import parse_line
from tests.conformance.firmware import need_compiler
from tests.conformance.guides import ROOT, Block, blocks
from tests.conformance.tiers import first_by_default

GUIDES = [
    ROOT / "README.md",
    *sorted((ROOT / "rig").rglob("*.md")),
    *sorted((ROOT / "firmware_protocol").rglob("*.md")),
]
# The course has tests of its own, of its answers.
PAGES = {
    str(page.relative_to(site.SOURCES)): page
    for page in GUIDES
    if site.SOURCES in page.parents and page.parent.name != "course"
}
# Pages whose output must match a pattern; the others must end without an error.
PATTERNS = {
    "index.md": r"stable|limit cycle",
    "first-walls.md": r"(?s)stable.*K_max.*area",
    "reference/python.md": r"stable 0\.0 N·m|stable -",
    "tutorials/first-hit.md": r"True\nFalse",
    "how-to/estimators-in-a-wall.md": r"(?s)FDM: K-width.*Levant \[\(0.0, .*AKF: .* off the ideal wall.*cutoff_hz = ",
}


def runnable_blocks(page: Path) -> list[Block]:
    return [one for one in blocks(page) if not one.reason]


LONG = """
explanation/linear-theory first-walls how-to/cluster how-to/device-loop how-to/drive how-to/estimators-in-a-wall index
reference/python reference/ranking-entries tutorials/ci tutorials/first-hit tutorials/own-estimator tutorials/own-law
tutorials/own-rig tutorials/session
"""  # half a second and more
RUNNING = sorted(
    (name for name, page in PAGES.items() if any(b.language != "toml" for b in runnable_blocks(page))),
    key=lambda name: name.removesuffix(".md") in LONG.split(),
)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", first_by_default(RUNNING, len(RUNNING) - len(LONG.split())))
def test_examples_of_a_page_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name == "how-to/device-loop.md":
        need_compiler()
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": name}
    output = StringIO()
    with redirect_stdout(output):
        for number, block in enumerate(runnable_blocks(PAGES[name])):
            if block.file:
                Path(block.file).write_text(block.text, encoding="utf-8")
            elif block.language == "python":
                exec(compile(block.text, f"{name}, block {number}", "exec"), names)
            for line in block.commands():
                run_line(line)
        for test in [one for key, one in names.items() if key.startswith("test_")]:
            test(**{"tmp_path": tmp_path} if "tmp_path" in inspect.signature(test).parameters else {})
    assert re.search(PATTERNS.get(name, ""), output.getvalue()), output.getvalue()


def run_line(line: str) -> None:
    """Run a shell line; a plain `rig` or pytest command runs in this process, where the loop is compiled already."""
    words = shlex.split(line, comments=True)
    words = words[: words.index("||")] if "||" in words else words  # what follows is for when it fails
    if words[0] == "pytest":
        without = ("-p", "no:cacheprovider", "-p", "no:unraisableexception")  # the outer pytest reports these
        assert pytest.main([*words[1:], "-p", "rig.testing.plugin", *without]) == 0
        return
    if words[0] != "rig" or {"&&", "|"} & set(words):
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        around = {"PATH": path, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            ["bash", "-euc", line], env={**os.environ, **around},
            capture_output=True, text=True, timeout=100, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return
    target = words[words.index(">") + 1] if ">" in words else None
    arguments = words[1 : words.index(">")] if target else words[1:]
    out = StringIO()
    with redirect_stdout(out):
        code = rig.cli.run(arguments)
    assert code == 0, f"{line}\n{out.getvalue()}"
    print(out.getvalue())
    if target:
        Path(target).write_text(out.getvalue(), encoding="utf-8")


COMMANDS = [
    pytest.param(line, id=f"{page.relative_to(ROOT)}: {line[:50]}")
    for page in GUIDES
    for block in blocks(page)
    if block.reason
    for line in block.commands()
    if line.startswith("rig ")
]


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_that_is_not_run_exists_with_its_options(line: str) -> None:
    parse_line(shlex.split(line, comments=True)[1:])


@pytest.mark.parametrize("page", [*GUIDES, *(ROOT / ".github").rglob("*.md")], ids=lambda page: page.name)
def test_commands_in_the_text_of_a_page_exist_with_their_options(page: Path) -> None:
    text = re.sub(r"(?s)```.*?```", "", page.read_text(encoding="utf-8"))
    for line in re.findall(r"`(?:\.venv/bin/)?rig\s([a-z][^`…|]*)`", text):
        if "NAME" not in line:
            with suppress(click.BadOptionUsage):  # the text names an option without its value
                parse_line(shlex.split(line))


# ------------------------------------------------------------------ generated pages


@pytest.fixture(scope="module")
def built_sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the documentation sources and add all generated pages, as Sphinx reads them."""
    place = tmp_path_factory.mktemp("docs") / "docs"
    shutil.copytree(site.SOURCES, place)
    runpy.run_path(str(place / "made.py"))["make_pages"](place)
    return place


def test_every_command_fault_key_and_column_has_its_place(built_sources: Path) -> None:
    reference = built_sources / "reference"
    assert {page.stem for page in (reference / "commands").iterdir()} == {
        words.split()[0] for words in commands()
    }
    assert len(list((reference / "faults").iterdir())) == len(Fault) - 1
    limits = (reference / "limits.md").read_text()
    assert all(f"| `{one.name}` |" in limits for one in (*LimitFlag, *Status, *Input))
    assert all(
        f"| `{key.rpartition('.')[2]}` |" in limits for key in parameters() if key.startswith("rig.limits.")
    )
    configuration = (reference / "configuration.md").read_text()
    assert all(f"| `{key.rpartition('.')[2]}` |" in configuration for key in parameters())
    columns = (reference / "columns.md").read_text()
    assert all(f"| `{column.name}` |" in columns for column in COLUMNS)
    assert "<!--" not in "".join(page.read_text() for page in built_sources.rglob("*.md"))


def test_the_page_of_public_names_has_them_all() -> None:
    text = (site.SOURCES / "reference" / "python.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    assert sorted([*re.findall(r"`(\w+)`", "".join(rows)), "__version__"]) == rig.__all__


def test_links_between_pages_are_those_of_the_site(built_sources: Path) -> None:
    called_by_files = [
        page for page in built_sources.rglob("*.md") if re.search(r"\[[^]\n]*\.md`?\]\(", page.read_text())
    ]
    assert not called_by_files
    sessions = (built_sources / "how-to" / "sessions.md").read_text()
    assert "(../explanation/safety.md)" in sessions
    assert "(../reference/searches.md)" in sessions


# ------------------------------------------------------------------ the gallery


LAWS = sorted((site.SOURCES / "gallery").glob("law_*.py"))
AT_REST = {"bump", "grating", "mass"}  # may pull a handle at rest: a shape or a swinging mass does


@pytest.mark.parametrize("script", first_by_default(LAWS), ids=lambda script: script.stem)
def test_a_law_of_the_gallery_does_what_its_page_claims_and_replays(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each script asserts its claim; this test adds that the law is finite, bounded in memory and passive."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = runpy.run_path(str(script))
    law = names.get("law") or names[script.stem.removeprefix("law_")]
    check_law(law, pulls=law.name in AT_REST)
    assert rig.replay(names["result"].recording, law=law).exact


def test_every_figure_of_a_page_is_made_by_a_script() -> None:
    for page in PAGES.values():
        for name in re.findall(r"sphx_glr_(\w+)_001\.png", page.read_text(encoding="utf-8")):
            assert (site.SOURCES / "gallery" / f"{name}.py").is_file(), f"{page.name}: {name}"


# ------------------------------------------------------------------ building


@pytest.fixture
def one_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Replace the documentation by a site of one page."""
    pytest.importorskip("sphinx")
    sources = tmp_path / "small"
    sources.mkdir()
    (sources / "conf.py").write_text('extensions = ["myst_parser"]\n')
    (sources / "index.md").write_text("# One page\n")
    monkeypatch.setattr(site, "SOURCES", sources)
    return sources


def test_a_site_is_built(one_page: Path, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    assert rig.cli.run(["serve", "docs", "--no-open", "--strict", "-o", str(out)]) == 0
    assert "One page" in (out / "html" / "index.html").read_text()
    assert str(out / "html" / "index.html") in capsys.readouterr().out


@pytest.mark.exhaustive("::test_a_site_is_built")
def test_a_warning_is_an_error_where_that_is_asked_for(one_page: Path, tmp_path: Path) -> None:
    (one_page / "index.md").write_text("# One page\n\n[nothing](nowhere.md)\n")
    assert "nowhere.md" in site.build_site(tmp_path / "out").warnings[0]
    with pytest.raises(RigError, match=r"nowhere\.md"):
        site.build_site(tmp_path / "out", strict=True)


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(site, "find_spec", lambda name: None if name == "furo" else name)
    with pytest.raises(ConfigError, match="furo"):
        site.build_site(tmp_path)
    assert rig.cli.run(["serve", "docs", "--no-open", "-o", str(tmp_path)]) == 2
    assert "haptic-rig[docs]" in capsys.readouterr().err


def test_a_directory_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    pytest.importorskip("sphinx")
    (tmp_path / "file").touch()
    assert rig.cli.run(["serve", "docs", "--no-open", "-o", str(tmp_path / "file")]) == 9
