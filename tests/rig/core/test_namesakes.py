"""Another package installed under the name of pyserial, pyusb or this one is reported with the command to remove it."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rig as package
from rig import cli
from rig.cli import doctor
from rig.core import deferred

ROOT = Path(package.__file__).parents[1]


def install(place: Path, name: str, distribution: str, text: str = "") -> None:
    """Install another package, as pip does, in a directory that Python searches first."""
    (place / name).mkdir(parents=True)
    (place / name / "__init__.py").write_text(text)
    facts = place / f"{distribution}-2.4.1.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 2.4.1\n")
    (facts / "top_level.txt").write_text(f"{name}\n")


def run(place: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": f"{place}{os.pathsep}{ROOT}"}
    return subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True, check=False
    )


def check_named(name: str, place: Path, output: str, error: str) -> None:
    assert re.fullmatch(
        rf"rig: the package {name} in {place}/{name}/__init__.py does not belong to py{name}, but to other-{name}, "
        rf"which was installed over it; .+ -m pip uninstall -y other-{name} py{name}; .+ -m pip install py{name}\n",
        error,
    ), error
    assert json.loads(output)["error"]["exit_code"] == 2


def test_a_package_in_place_of_another_is_named_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(tmp_path, "serial", "other-serial", "raise SyntaxError('print as it was in Python 2')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(deferred.serial, "_module", None)
    for name in [name for name in sys.modules if name.partition(".")[0] == "serial"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(doctor.doctor, "callback", lambda **_: deferred.serial.Serial)
    assert cli.run(["doctor", "--json"]) == 2
    check_named("serial", tmp_path, *capsys.readouterr())


OVERWRITTEN = """
import sys, rig
for name in ("__all__", "_NAMES"):
    delattr(rig, name)
from rig import cli
sys.exit(cli.run(sys.argv[1:]))
"""


@pytest.mark.exhaustive("::test_a_package_in_place_of_another_is_named_with_its_remedy")
def test_an_overwritten_init_is_named_and_a_stop_still_works(tmp_path: Path) -> None:
    done = run(tmp_path, "-c", OVERWRITTEN, "plan")
    assert done.returncode == 2
    assert done.stderr.startswith(
        f"rig: the package rig in {ROOT}/rig/__init__.py does not belong to haptic-rig"
    )
    assert done.stderr.endswith("uninstall -y haptic-rig; then install it from where it came\n")
    # Without a number it would stop the loops of all tests, and of a rig, on this machine.
    stopped = run(tmp_path, "-c", OVERWRITTEN, "stop", str(os.getpid()))
    assert (stopped.returncode, "runs no loop" in stopped.stderr) == (2, True)
