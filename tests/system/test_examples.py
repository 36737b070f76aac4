"""Each program of `rig/docs/examples` runs as it stands, in an empty directory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rig.testing import SerialRig
from tests.conformance.tiers import first_by_default

EXAMPLES = Path(__file__).parents[2] / "rig/docs/examples"
PROGRAMS = ["hit.py", *sorted({path.name for path in EXAMPLES.glob("[!t]*.py")} - {"hit.py"})]


def run(place: Path, *command: str | Path) -> str:
    """Run a command in an empty directory, with `rig` on the path, and return what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command,
        cwd=place,
        env={**os.environ, "PATH": path, "MPLBACKEND": "Agg"},
        capture_output=True,
        check=False,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_there_are_ten_short_ones_and_the_page_lists_them() -> None:
    paths = [path for path in EXAMPLES.iterdir() if path.suffix in {".py", ".c"}]
    page = EXAMPLES.with_suffix(".md").read_text(encoding="utf-8")
    assert len(paths) == 10
    assert [path.name for path in paths if f"](examples/{path.name})" not in page] == []
    assert max(path.read_text(encoding="utf-8").count("\n") for path in paths) <= 80


@pytest.mark.parametrize("name", first_by_default(PROGRAMS))
def test_a_program_runs(name: str, tmp_path: Path) -> None:
    assert run(tmp_path, sys.executable, EXAMPLES / name)


@pytest.mark.exhaustive(
    "tests/rig/testing/test_plugin.py::test_golden_recordings_are_missed_made_and_compared"
)
def test_the_golden_test_makes_its_recording_and_passes_with_it(tmp_path: Path) -> None:
    (tmp_path / "test_golden.py").write_text((EXAMPLES / "test_golden.py").read_text(encoding="utf-8"))
    for options in (["--rig-golden=update"], []):
        run(tmp_path, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options)
    assert list(tmp_path.rglob("golden/*"))


@pytest.mark.exhaustive("tests/firmware_protocol/test_connection.py::test_through_all_states_and_back")
def test_the_client_in_c_reads_the_identity_of_a_served_rig(rig_serial: SerialRig, tmp_path: Path) -> None:
    run(
        tmp_path,
        os.environ.get("CC", "cc"),
        "-Wall",
        "-Wextra",
        "-Werror",
        "-o",
        "client",
        EXAMPLES / "client.c",
    )
    assert run(tmp_path, tmp_path / "client", rig_serial.path).startswith(
        "protocol 2.1, state 0, dictionary of "
    )
