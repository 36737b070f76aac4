"""`rig theory levant-regions`: one command makes the picture and its numbers."""

import json
from pathlib import Path

import pytest

import rig.cli


def test_the_picture_and_its_numbers_come_from_one_command(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "fig1.png"
    assert rig.cli.run(["theory", "levant-regions", "-o", str(picture), "--json"]) == 0
    facts = json.loads(capfd.readouterr().out)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert facts["crossing"]["mu2"] == pytest.approx(2.7443, abs=5e-5)
    assert facts["named"]["hba-sc"]["in_hba"] is False
    assert facts["hba_mu1"][0] is None
    assert len(facts["mu2"]) == len(facts["hba_mu1"]) == len(facts["lfba_mu1"])
    assert rig.cli.run(["theory", "levant-regions", "-o", str(tmp_path / "again.png")]) == 0
    assert "3.2656" in capfd.readouterr().out
    assert (tmp_path / "again.png").read_bytes() == picture.read_bytes()
