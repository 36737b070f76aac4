"""A lab's own package, and every example, against the wheel alone: types, an entry point's law, hits, maps, its CI.

Its CI is the recipe that the package brings, copied as its tutorial says, and run by the commands of its workflow.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conformance.guides import ROOT, blocks

pytest.importorskip("hatchling")

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

pytestmark = pytest.mark.exhaustive("tests/rig/testing/test_plugin.py::test_its_entry_point_and_dash_p_are_one_plugin")

print(rig.__file__, mylab.__file__, sim_backend.__file__)
sys.exit(code)
"""


def done(*command: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", *command], cwd=cwd, env={**os.environ, **environment},
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package beside a directory `site`, in which it is installed with the wheel, and the examples in `guides`."""
    place = tmp_path_factory.mktemp("lab") / "lab"
    shutil.copytree(ROOT / "tests" / "lab_package", place)
    built = done("-m", "hatchling", "build", "-t", "wheel", "-d", str(place / "dist"), cwd=ROOT)
    assert built.returncode == 0, built.stderr
    (wheel,) = (place / "dist").glob("*.whl")
    offline = (
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--disable-pip-version-check",
        "--no-compile",
    )
    installed = done(
        "-m", "pip", "install", "-q", *offline, "--target", "site", str(wheel), str(place), cwd=place
    )
    assert installed.returncode == 0, installed.stderr
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


def test_it_and_every_example_pass_mypy_strict_and_what_is_wrong_is_found(lab: Path) -> None:
    """One run for all: most of it is reading the package, which mypy does again where a file has changed."""
    shown = [str(path.relative_to(lab)) for path in sorted((lab / "guides").iterdir())]
    assert len(shown) >= 10
    kept = ROOT / ".mypy_cache" / "lab_package"
    command = ("-m", "mypy", f"--cache-dir={kept}", "mylab", "tests", *shown, "wrong.py")
    checked = done(*command, cwd=lab, PYTHONPATH=str(lab / "site"))
    errors = [line for line in checked.stdout.splitlines() if ": error: " in line]
    assert [line for line in errors if not line.startswith("wrong.py:")] == []
    assert len(errors) == len(ERRORS), checked.stdout + checked.stderr
    for line, (said, near) in zip(errors, ERRORS, strict=True):
        assert said in line
        assert near in line
    assert re.search(rf"Found {len(ERRORS)} errors in 1 file", checked.stdout)


def test_its_tests_pass_with_the_wheel_and_without_the_sources(lab: Path) -> None:
    assert (lab / "site" / "rig" / "docs" / "index.md").is_file(), (
        "rig serve docs builds from what is installed"
    )
    workflow = (lab / ".github" / "workflows" / "haptics.yml").read_text()
    assert re.findall(r"^      - run: (.+)$", workflow, re.MULTILINE) == [
        "pip install -r requirements.txt",
        "pytest",
    ]
    environment = {"PYTHONPATH": str(lab / "site"), "PYTEST_ADDOPTS": ""}
    offline = {"PIP_NO_INDEX": "1", "PIP_DRY_RUN": "1"}  # what they ask for is installed
    needed = done("-m", "pip", "install", "-q", "-r", "requirements.txt", cwd=lab, **environment, **offline)
    assert needed.returncode == 0, needed.stderr
    tests = done("-c", TWICE, cwd=lab, **environment)
    assert tests.returncode == 0, tests.stdout + tests.stderr
    assert "1 passed, 8 deselected" in tests.stdout  # once, and committed
    assert "9 passed" in tests.stdout
    found = tests.stdout.splitlines()[-1].split()
    assert [Path(file).parts[: len(lab.parts) + 1] for file in found] == [(*lab.parts, "site")] * 3
    assert not (lab / "rig-recordings").exists(), "only failed tests leave some"
