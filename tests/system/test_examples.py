"""Each program of `rig/docs/examples` runs as it stands, in an empty directory."""

import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig.testing import SerialRig
from rig.views.plots import style
from tests.system.test_docs import run_line

EXAMPLES = Path(__file__).parents[2] / "rig/docs/examples"
PROGRAMS = sorted(path.name for path in EXAMPLES.glob("[!t]*.py"))
PARALLEL = "map_on_all_cores.py"  # starts workers, which import the main program


def run(place: Path, *command: str | Path) -> str:
    """Run a command in an empty directory, with `rig` on the path, and return what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    around = {**os.environ, "PATH": path, "MPLBACKEND": "Agg"}
    done = subprocess.run(command, cwd=place, env=around, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.exhaustive("tests/system/test_readme.py::test_the_example_of_a_new_law_runs")
@pytest.mark.parametrize("name", [name for name in PROGRAMS if name != PARALLEL])
def test_a_program_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """Run the program and its commands in this process, which has loaded the libraries and the kernels."""
    run_process = subprocess.run

    def run_command(words: list[str], **options: Any) -> Any:
        if words[0] != "rig":
            return run_process(words, **options)
        assert rig.cli.run(words[1:]) == 0
        return None

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(subprocess, "run", run_command)
    monkeypatch.setattr(style, "DPI", 10)
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert capsys.readouterr().out


@pytest.mark.exhaustive("tests/system/test_readme.py::test_the_example_of_a_new_law_runs")
def test_a_program_with_workers_runs(tmp_path: Path) -> None:
    assert run(tmp_path, sys.executable, EXAMPLES / PARALLEL)


@pytest.mark.exhaustive("tests/rig/testing/test_plugin.py::test_golden_recordings_are_compared")
def test_the_golden_test_makes_its_recording_and_passes_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "test_golden.py").write_text((EXAMPLES / "test_golden.py").read_text(encoding="utf-8"))
    for options in (" --rig-golden=update", ""):
        run_line(f"pytest -q{options} test_golden.py")
    assert list(tmp_path.rglob("golden/*"))


@pytest.mark.exhaustive("tests/firmware_protocol/test_connection.py::test_through_all_states_and_back")
def test_the_client_in_c_reads_the_identity_of_a_served_rig(rig_serial: SerialRig, tmp_path: Path) -> None:
    flags = ["-Wall", "-Wextra", "-Werror", "-o", "client"]
    run(tmp_path, os.environ.get("CC", "cc"), *flags, EXAMPLES / "client.c")
    assert run(tmp_path, tmp_path / "client", rig_serial.path).startswith(
        "protocol 2.1, state 0, dictionary of "
    )
