"""Another package installed under the name of pyserial is reported with the command to remove it."""

import json
import re
import sys
from pathlib import Path

import pytest

from rig import cli
from rig.cli import doctor
from rig.core import deferred


def test_a_package_in_place_of_another_is_named_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is installed as pip does, in a directory that Python searches first."""
    facts = tmp_path / "other-serial-2.4.1.dist-info"
    for directory in (tmp_path / "serial", facts):
        directory.mkdir()
    (tmp_path / "serial/__init__.py").write_text("raise SyntaxError('print as it was in Python 2')")
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: other-serial\nVersion: 2.4.1\n")
    (facts / "top_level.txt").write_text("serial\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(deferred.serial, "_module", None)
    for name in [name for name in sys.modules if name.partition(".")[0] == "serial"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(doctor.doctor, "callback", lambda **_: deferred.serial.Serial)
    assert cli.run(["doctor", "--json"]) == 2
    output, error = capsys.readouterr()
    assert re.fullmatch(
        rf"rig: the package serial in {tmp_path}/serial/__init__.py does not belong to pyserial, but to other-serial, "
        r"which was installed over it; .+ -m pip uninstall -y other-serial pyserial; .+ -m pip install pyserial\n",
        error,
    ), error
    assert json.loads(output)["error"]["exit_code"] == 2
