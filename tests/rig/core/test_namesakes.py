"""Another package installed under the name of pyserial, pyusb or this one is reported with the command to remove it."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rig import cli
from rig.cli import doctor
from rig.core import deferred


@pytest.mark.parametrize(
    ("package", "own_name", "text"),
    [("serial", "Serial", "raise SyntaxError('print as it was in Python 2')"), ("usb", "find", "")],
)
def test_a_package_in_place_of_another_is_named_with_its_remedy(
    package: str,
    own_name: str,
    text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It is installed as pip does, in a directory that Python searches first."""
    facts = tmp_path / f"other-{package}-2.4.1.dist-info"
    for directory in (tmp_path / package, facts):
        directory.mkdir()
    (tmp_path / package / "__init__.py").write_text(text)
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: other-{package}\nVersion: 2.4.1\n")
    (facts / "top_level.txt").write_text(f"{package}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(getattr(deferred, package), "_module", None)
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(doctor.doctor, "callback", lambda **_: getattr(getattr(deferred, package), own_name))
    assert cli.run(["doctor", "--json"]) == 2
    output, error = capsys.readouterr()
    assert re.fullmatch(
        rf"rig: the package {package} in {tmp_path}/{package}/__init__.py does not belong to py{package}, but to "
        rf"other-{package}, which was installed over it; .+ -m pip uninstall -y other-{package} py{package}; "
        rf".+ -m pip install py{package}\n",
        error,
    ), error
    assert json.loads(output)["error"]["exit_code"] == 2


OVERWRITTEN = """
import sys, rig
for name in ("__all__", "_NAMES"):
    delattr(rig, name)
from rig import cli
sys.exit(cli.run(sys.argv[1:]))
"""


@pytest.mark.exhaustive("::test_a_package_in_place_of_another_is_named_with_its_remedy")
def test_an_overwritten_init_is_named_and_a_stop_still_works() -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", OVERWRITTEN, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = run("plan")
    assert done.returncode == 2
    assert done.stderr.startswith("rig: the package rig in ")
    assert done.stderr.endswith("uninstall -y haptic-rig; then install it from where it came\n")
    # Without a number it would stop the loops of all tests, and of a rig, on this machine.
    stopped = run("stop", str(os.getpid()))
    assert (stopped.returncode, "runs no loop" in stopped.stderr) == (2, True)
