"""Flashing by copying to the drive of a boot ROM, which is a directory here."""

import errno
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import dictionary as dictionaries
from rig.core.errors import ConfigError, DeviceNotFoundError, DeviceRefusedError, LinkLostError
from rig.firmware import _flash as flashing
from rig.firmware._flash import BootDrive, find_drives, flash
from rig.firmware._record import ImageFacts, Record, pack
from rig.firmware._uf2 import RP2040, Piece, write_uf2

DICTIONARY = dictionaries.build(device="mine", firmware="1", simulated=False, current_quantum_a=0.001)
FACTS = ImageFacts(package="0.1", sources="abc", board="a pico", rig="mine", settings={})
IMAGE = pack(Record(FACTS, dictionaries.encode(DICTIONARY)))
PICO = "UF2 Bootloader v3.0\nModel: Raspberry Pi RP2\nBoard-ID: RPI-RP2\n"


@pytest.fixture
def image(tmp_path: Path) -> Any:
    path = tmp_path / "a.uf2"
    path.write_bytes(write_uf2([Piece(0x1000_0000, IMAGE)], RP2040))
    return path


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    path = tmp_path / "RPI-RP2"
    path.mkdir()
    (path / "INFO_UF2.TXT").write_text(PICO)
    monkeypatch.setattr(flashing, "_mount_points", lambda: [tmp_path / "nothing", path])
    return path


def starting(drive: Any) -> Any:
    """Act as a board after the last block: it restarts, and its drive disappears."""

    def step(what: Any, _share: Any) -> None:
        if what == "waiting for the board to start":
            (drive / "INFO_UF2.TXT").unlink(missing_ok=True)

    return step


def test_the_image_is_copied_and_the_board_starts(image: Any, drive: Any) -> None:
    assert find_drives() == [BootDrive(path=drive, board_id="RPI-RP2", model="Raspberry Pi RP2")]
    done = flash(image, on_progress=starting(drive))
    assert (drive / "a.uf2").read_bytes() == image.read_bytes()
    assert (done.drive, done.board_id, done.rig) == (drive, "RPI-RP2", "mine")
    assert done.bytes == image.stat().st_size


def test_a_running_device_shows_its_drive(image: Any, drive: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (drive / "INFO_UF2.TXT").unlink()
    asked = []

    class Device:
        def enter_bootloader(self) -> None:
            asked.append("asked")
            (drive / "INFO_UF2.TXT").write_text(PICO)

    monkeypatch.setattr(flashing, "open_device", lambda _url: nullcontext(Device()))

    done = flash(image, on_progress=starting(drive), url="usb://1209:0001")
    assert (asked, done.drive) == (["asked"], drive)


def test_a_device_without_a_boot_loader_refuses_the_request(image: Any, drive: Any) -> None:
    with pytest.raises(DeviceRefusedError, match="does not support this request"):
        flash(image, url="sim://koul-rigid")


def test_a_missing_drive_names_a_button(image: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(flashing, "_mount_points", list)
    with pytest.raises(DeviceNotFoundError, match="BOOTSEL"):
        flash(image)
    with pytest.raises(DeviceNotFoundError, match=r"INFO_UF2\.TXT"):
        flash(image, tmp_path)


def test_of_two_boards_one_must_be_named(image: Any, drive: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flashing, "_mount_points", lambda: [drive, drive])
    with pytest.raises(DeviceNotFoundError, match="`drive`"):
        flash(image)
    assert flash(image, drive, starting(drive)).drive == drive


def test_an_image_for_another_processor_or_board_is_refused(image: Any, drive: Any) -> None:
    good = image.read_bytes()
    other = pack(Record(replace(FACTS, board="mps2"), dictionaries.encode(DICTIONARY)))
    for content, message in (
        (write_uf2([Piece(0x1000_0000, IMAGE)], 0xE48BFF59), "RP2350"),
        (write_uf2([Piece(0x1000_0000, other)], RP2040), "for board mps2"),
        (IMAGE, "not a UF2"),
    ):
        image.write_bytes(content)
        with pytest.raises(ConfigError, match=message):
            flash(image)
    image.write_bytes(good)
    (drive / "INFO_UF2.TXT").write_text("Board-ID: OTHER\n")
    with pytest.raises(DeviceNotFoundError, match="OTHER"):
        flash(image)
    assert not (drive / "a.uf2").exists()


def test_a_failed_start_or_copy_is_an_error(image: Any, drive: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flashing, "VANISH_S", 0.0)
    with pytest.raises(LinkLostError, match="did not accept the image"):
        flash(image)
    (drive / "a.uf2").unlink()
    (drive / "a.uf2").mkdir()
    with pytest.raises(LinkLostError, match="cannot be written"):
        flash(image)


def test_a_board_lost_in_mid_copy_is_named(image: Any, drive: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flashing, "_CHUNK", 64)

    def step(_what: Any, _share: Any) -> None:
        (drive / "INFO_UF2.TXT").unlink()
        raise OSError(errno.EIO, "input/output error")

    with pytest.raises(LinkLostError, match=r"while copying, after 64 of \d+ bytes.*hold BOOTSEL"):
        flash(image, on_progress=step)


def test_a_sync_may_fail_after_the_last_byte(image: Any, drive: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fsync(_descriptor: Any) -> None:
        (drive / "INFO_UF2.TXT").unlink()
        raise OSError(errno.EIO, "input/output error")

    monkeypatch.setattr(flashing.os, "fsync", fsync)
    assert flash(image).bytes == image.stat().st_size


def test_a_stale_mount_is_a_missing_drive(image: Any, drive: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = flashing.Path.exists

    def stale(path: Any, **named: Any) -> Any:
        if path.name == flashing.INFO_FILE:
            raise OSError(errno.EIO, "input/output error")
        return honest(path, **named)

    with monkeypatch.context() as patch:
        patch.setattr(flashing.Path, "exists", stale)
        done = flash(image, drive)
    assert done.drive == drive
