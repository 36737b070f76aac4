"""A lab's own package and every example against the installed wheel: types, a law's entry point, hits, maps, CI."""

import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.conformance.guides import ROOT, blocks

pytest.importorskip("hatchling")
pytestmark = pytest.mark.exhaustive("tests/rig/testing/test_plugin.py::test_entry_point_and_p_are_one_plugin")

WRONG = """
import rig
from rig.testing import check_lwa

rig.hti
rig.hit("koul-compliant", stifness=1.0)
rig.hit("koul-compliant", stiffness="hard")
rig.hit().verdict.knd
rig.hit().recording["velocity"].units
rig.law(parameters={"gain": "much"})
"""
ERRORS = [
    ('Module "rig.testing" has no attribute "check_lwa"', "check_law"),
    ('Module has no attribute "hti"', ""),
    ('Unexpected keyword argument "stifness"', 'did you mean "stiffness"'),
    ('Argument "stiffness" to "hit" has incompatible type "str"', "float"),
    ('"Verdict" has no attribute "knd"', ""),
    ('"Column" has no attribute "units"', "unit"),
    ('has incompatible type "str": "str"', "Parameter"),
]
# Both runs of pytest in one process: what they import and the compiled kernels that they load are most of a run.
TWICE = """
import sys

import pytest

here = ["-q", "-p", "no:cacheprovider", "-W", "error", "tests"]
update = ["--rig-golden=update", "-k", "what_it_was", "-p", "no:unraisableexception"]  # the second run looks for them
code = pytest.main([*here, *update]) or pytest.main(here)

import mylab
import rig
import sim_backend

print(rig.__file__, mylab.__file__, sim_backend.__file__)
sys.exit(code)
"""


def run_python(*command: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", *command], cwd=cwd, env={**os.environ, **environment},
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build both wheels, unpack them in `site` (an environment may lack pip), and copy the examples beside it."""
    place = tmp_path_factory.mktemp("lab") / "lab"
    shutil.copytree(ROOT / "tests" / "lab_package", place)
    for source in (ROOT, place):
        built = run_python("-m", "hatchling", "build", "-t", "wheel", "-d", str(place / "dist"), cwd=source)
        assert built.returncode == 0, built.stderr
    for wheel in (place / "dist").glob("*.whl"):
        shutil.unpack_archive(wheel, place / "site", "zip")
    shutil.copytree(place / "site" / "rig" / "testing" / "recipe", place, dirs_exist_ok=True)
    guides = place / "guides"
    guides.mkdir()
    for guide in (ROOT / "README.md", *(ROOT / "rig").rglob("*.md")):
        shown = [block for block in blocks(guide) if block.language == "python"]
        whole = "\n".join(block.text for block in shown if not block.file)
        for number, text in enumerate([whole, *(block.text for block in shown if block.file)]):
            if text:
                name = f"{guide.parent.name}_{guide.stem.lower()}_{number}.py".replace("-", "_")
                (guides / name).write_text(text)
    (place / "wrong.py").write_text(WRONG)
    return place


def test_it_and_every_example_pass_mypy_strict_and_errors_are_found(lab: Path) -> None:
    shown = [str(path.relative_to(lab)) for path in sorted((lab / "guides").iterdir())]
    assert len(shown) >= 10
    # mypy keeps what it found about a file by its path, which must be the same in each run.
    kept = ROOT / ".mypy_cache" / "lab_package"
    kept.mkdir(parents=True, exist_ok=True)
    site = kept / "site"
    site.unlink(missing_ok=True)
    site.symlink_to(lab / "site", target_is_directory=True)
    command = ("-m", "mypy", f"--cache-dir={kept}", "mylab", "tests", *shown, "wrong.py")
    checked = run_python(*command, cwd=lab, PYTHONPATH=str(site))
    errors = [line for line in checked.stdout.splitlines() if ": error: " in line]
    assert [line for line in errors if not line.startswith("wrong.py:")] == []
    assert len(errors) == len(ERRORS), checked.stdout + checked.stderr
    for line, (words, near) in zip(errors, ERRORS, strict=True):
        assert words in line
        assert near in line
    assert re.search(rf"Found {len(ERRORS)} errors in 1 file", checked.stdout)


def test_its_tests_pass_with_the_wheel_and_without_the_sources(lab: Path) -> None:
    workflow = (lab / ".github" / "workflows" / "haptics.yml").read_text()
    assert re.findall(r"^      - run: (.+)$", workflow, re.MULTILINE) == [
        "pip install -r requirements.txt",
        "pytest",
    ]
    environment = {"PYTHONPATH": str(lab / "site"), "PYTEST_ADDOPTS": ""}
    for line in (lab / "requirements.txt").read_text().splitlines():
        if text := line.partition("#")[0].strip():
            requirement = Requirement(text)
            assert version(requirement.name) in requirement.specifier, "installed"
    tests = run_python("-c", TWICE, cwd=lab, **environment)
    assert tests.returncode == 0, tests.stdout + tests.stderr
    assert "1 passed, 8 deselected" in tests.stdout  # once, and committed
    assert "9 passed" in tests.stdout
    found = tests.stdout.splitlines()[-1].split()
    assert [Path(file).parts[: len(lab.parts) + 1] for file in found] == [(*lab.parts, "site")] * 3
    assert not (lab / "rig-recordings").exists(), "only failed tests leave some"
