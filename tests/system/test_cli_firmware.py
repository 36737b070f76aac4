"""``rig firmware``: build, inspect, flash, self-test."""

import json
from pathlib import Path
from typing import Any

import pytest

from rig.firmware import _build
from rig.firmware import _flash as flashing
from rig.firmware._uf2 import RP2040, Piece, write_uf2
from tests.firmware import cross
from tests.rig.firmware.test_firmware_flash import IMAGE


def test_an_image_is_flashed_to_a_pico(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, drive = tmp_path / "a.uf2", tmp_path / "RPI-RP2"
    image.write_bytes(write_uf2([Piece(0x1000_0000, IMAGE)], RP2040))
    drive.mkdir()
    (drive / "INFO_UF2.TXT").write_text("Model: Raspberry Pi RP2\nBoard-ID: RPI-RP2\n")
    monkeypatch.setattr(flashing, "_wait_until_gone", lambda *_arguments: None)
    code, out, err = run("firmware", "flash", image, "--drive", drive)
    assert code == 0, err
    assert f"the drive at {drive} took the image: a pico" in out
    assert (drive / image.name).read_bytes() == image.read_bytes()


@pytest.fixture
def built_image(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Build an image by the command; its ELF file was compiled for the present sources, now or in an earlier run."""
    compiled = cross.image("mps2", rig="koul-rigid").elf.read_bytes()
    monkeypatch.setattr(_build, "_compile", lambda *_: compiled)
    code, out, err = run(
        "firmware", "build", "--rig", "koul-rigid", "--board", "mps2", "--json", "-o", tmp_path / "made"
    )
    assert code == 0, err
    return json.loads(out)


def test_an_image_is_built_and_inspected(run: Any, built_image: Any) -> None:
    assert built_image["rig"] == "koul-rigid"
    assert {Path(built_image[kind]).exists() for kind in ("elf", "bin", "facts")} == {True}
    code, out, _ = run("firmware", "info", built_image["elf"])
    assert code == 0
    assert all(
        words in out for words in ("mps2", "koul-rigid", built_image["dictionary_hash"], "compatible", "yes")
    )
