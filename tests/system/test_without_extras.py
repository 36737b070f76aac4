"""A copy of the tree without the optional extras installs, runs, and passes the tests of the core."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rig.core import extras
from tests.conformance.guides import ROOT

pytest.importorskip("hatchling")
pytestmark = [
    pytest.mark.exhaustive(
        "tests/rig/core/test_extras.py::test_a_drive_whose_extra_is_gone_is_refused_and_never_another_rig"
    ),
    pytest.mark.timeout(1500),
]

COMMANDS = "tests/system/test_commands.py"
REFUSALS = f"{COMMANDS}::test_a_refusal_is_one_line_with_its_exit_code_and_leaves_nothing"
# Tests of what looks up names of extras, and a good run of each command. Everything else is only collected, which
# shows that it imports no extra; beyond that it cannot differ.
RUN = (
    *(f"tests/rig/core/test_{name}.py" for name in ("extras", "lazy", "plugins")),
    "tests/rig/cli",
    "tests/rig/devices/test_devices_table.py",
    "tests/rig/experiments/test_sweep.py",
    COMMANDS,
)
# What these state is true of the whole distribution: documents and tables that have the names of extras in them.
WHOLE = (
    "tests/rig/core/test_extras.py::test_every_table_of_this_tree_is_whole",
    "tests/rig/core/test_lazy.py::test_stub_table_and_package_agree[rig]",
    "tests/rig/core/test_lazy.py::test_names_of_a_missing_extra_are_no_names",
    "tests/rig/core/test_lazy.py::test_every_public_function_documents_its_parameters_results_and_errors",
    "tests/rig/cli/test_command_line.py::test_each_command_explains_itself_without_its_libraries",
    "tests/rig/cli/test_command_line.py::test_a_missing_library_is_named_with_the_extra_that_installs_it",
    "tests/rig/cli/test_command_line.py::test_an_argument_that_a_message_names_is_an_option_of_a_command",
    "tests/rig/cli/test_help.py::test_there_are_at_most_twenty_commands_at_the_top",
    f"{COMMANDS}::test_every_command_has_a_row_with_a_good_run",
    *(
        f"{COMMANDS}::test_a_good_run_ends_with_0_as_json_and_as_text[{words}"
        for words in extras.added("commands")
    ),
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy this tree without the folders of extras and without tests that import from them."""
    place = tmp_path_factory.mktemp("copy")
    folders = {ROOT / "rig" / "extras", ROOT / "tests" / "extras"}

    def left_out(folder: str, names: list[str]) -> list[str]:
        return [name for name in names if Path(folder, name) in folders]

    for name in ("firmware_protocol", "rig", "sim_backend", "tests"):
        shutil.copytree(ROOT / name, place / name, ignore=left_out)
    for name in ("README.md", "LICENSE", "pyproject.toml"):
        shutil.copy(ROOT / name, place)
    for path in files_that_need_extras(place / "tests"):
        path.unlink()
    return place


def files_that_need_extras(tests: Path) -> set[Path]:
    """Return the test files that import from an extra, directly or through another test file."""
    names = {
        ".".join(path.relative_to(tests.parent).with_suffix("").parts): path for path in tests.rglob("*.py")
    }
    imported = {name: imports(path) for name, path in names.items()}
    found: set[str] = set()
    while more := {
        name
        for name, modules in imported.items()
        if name not in found and any(one.startswith("rig.extras") or one in found for one in modules)
    }:
        found |= more
    return {names[name] for name in found}


def imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def run(*command: str, cwd: Path, packages: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", *command], cwd=cwd, env={**os.environ, "PYTHONPATH": str(packages)},
        capture_output=True, text=True, timeout=1400, check=False,
    )  # fmt: skip


def test_it_installs_and_hits(copy: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    built = run("-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path), cwd=copy, packages=copy)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    shutil.unpack_archive(wheel, site, "zip")
    assert not (site / "rig" / "extras").exists()
    shown = run("-m", "rig", "--help", cwd=tmp_path, packages=site)
    assert "  hit " in shown.stdout, shown.stderr
    assert "console" not in shown.stdout
    hit = run("-m", "rig", "hit", "--json", "--no-plot", cwd=tmp_path, packages=site)
    assert hit.returncode == 0, hit.stderr
    refused = run("-m", "rig", "hit", "--url", "moteus:///dev/fdcanusb", cwd=tmp_path, packages=site)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "URL scheme moteus: no installed extra has it, it belongs to the extra drives" in refused.stderr


def test_the_core_passes_its_tests(copy: Path) -> None:
    files = [str(path.relative_to(copy)) for path in copy.glob("tests/**/test_*.py")]
    left_out = [*WHOLE, REFUSALS, *(file for file in files if not file.startswith(RUN))]
    options = ("-n", "0", "tests", *(f"--deselect={one}" for one in left_out))
    done = run("-m", "pytest", *options, cwd=copy, packages=copy)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) > 150
