"""Copy a firmware image to a board whose boot ROM appears as a USB drive.

If the board's BOOTSEL button is held while it is plugged in, the boot ROM appears as a small drive with a file
INFO_UF2.TXT; firmware of this project does the same on request. The boot ROM writes a UF2 file that is copied to the
drive into the flash and starts it; the drive disappears. `rig firmware flash` calls it. It must not write to a drive
that is not a boot drive of the image's board.
"""

import os
import string
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rig.core.errors import ConfigError, DeviceNotFoundError, LinkLostError
from rig.core.regular_file import TABLE_BYTES, read_regular
from rig.devices import open_device
from rig.firmware import _boards as boards
from rig.firmware._elf import flat
from rig.firmware._record import Record, find
from rig.firmware._uf2 import FAMILIES, RP2040, is_uf2, read_uf2

INFO_FILE = "INFO_UF2.TXT"
# Board-ID of a boot ROM → families that it takes. RP2040 data sheet, section 2.8.4.1.
FAMILY_OF_DRIVE = {"RPI-RP2": RP2040, "RP2350": 0xE48BFF59}
VANISH_S = 20.0  # from the last byte to the drive's end; a Pico takes less than one
APPEAR_S = 20.0  # from the request to a drive that is mounted
_LOOK_S = 0.05
_CHUNK = 64 * 1024
HOLD_BOOTSEL = "hold BOOTSEL while plugging the board in, wait for its drive, and start the command again"

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BootDrive:
    """A boot ROM that appears as a USB drive: path at which it is mounted, and Board-ID and model from INFO_UF2.TXT."""

    path: Path
    board_id: str
    model: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FlashResult:
    """The firmware image that was flashed, and the board that accepted it."""

    image: Path
    drive: Path
    board_id: str
    board: str
    rig: str
    firmware: str
    bytes: int


def flash(
    image: Path,
    drive: Path | None = None,
    on_progress: Progress = lambda _what, _share: None,
    *,
    url: str | None = None,
) -> FlashResult:
    """Copy a firmware image to a board's boot drive, and wait until the board has started it.

    Parameters
    ----------
    image
        UF2 file made by `rig.firmware._build`.
    drive
        Path of the boot ROM's drive; None to search for it.
    on_progress
        Called with the name of the current step and the completed share of that step, 0 … 1.
    url
        URL of a device that is restarted into its boot loader first; it must not be armed.

    Raises
    ------
    ConfigError
        The file is not an image, or it is for another processor or board.
    DeviceNotFoundError
        No boot drive or several boot drives are present; or there is no device at the URL.
    DeviceRefusedError
        The device is armed, or it has no boot loader.
    LinkLostError
        The board did not accept the image.
    """
    content, record = read_image(image)
    if url is not None:
        _check_kind(image, content)
        with open_device(url) as device:
            device.enter_bootloader()
        _wait_for_drive(drive, on_progress)
    target = _choose_drive(find_drives()) if drive is None else drive_at(drive)
    _check_family(image, content, target)
    _check_board(image, record, target)
    _copy(content, target, image.name, on_progress)
    _wait_until_gone(target, on_progress)
    return FlashResult(
        image=image,
        drive=target.path,
        board_id=target.board_id,
        board=record.facts.board,
        rig=record.facts.rig,
        firmware=record.dictionary.firmware,
        bytes=len(content),
    )


def read_image(path: Path) -> tuple[bytes, Record]:
    """Return the bytes of an image file (.elf, .uf2 or .bin) and its record; raise `ConfigError` if it has none."""
    try:
        content = read_regular(path, TABLE_BYTES)
    except OSError as error:
        raise ConfigError(
            f"the image {path} cannot be read: {error.strerror or error}",
            remedy="give an image made by rig firmware build",
        ) from None
    plain = flat(read_uf2(content, str(path)).pieces) if is_uf2(content) else content
    return content, find(plain, str(path))


def find_drives() -> list[BootDrive]:
    """Return the boot drives of all boards that are mounted now."""
    found = []
    for path in _mount_points():
        drive = _read_drive(path)
        if drive is not None:
            found.append(drive)
    return found


def drive_at(path: Path) -> BootDrive:
    """Return the boot drive at a path; raise `DeviceNotFoundError` if the path is not the drive of a boot ROM."""
    drive = _read_drive(path)
    if drive is None:
        raise DeviceNotFoundError(
            f"{path} is not the drive of a boot ROM: {INFO_FILE} is missing", remedy=HOLD_BOOTSEL
        )
    return drive


def _mount_points() -> list[Path]:
    if sys.platform == "win32":
        return [Path(f"{letter}:\\") for letter in string.ascii_uppercase]
    else:
        parents = ["/Volumes"] if sys.platform == "darwin" else ["/media", "/media/*", "/run/media/*", "/mnt"]
        root = Path("/")
        return sorted({path for parent in parents for path in root.glob(f"{parent.lstrip('/')}/*")})


def _read_drive(path: Path) -> BootDrive | None:
    try:
        text = read_regular(path / INFO_FILE).decode(errors="replace")
    except OSError:
        return None
    fields = dict(line.split(":", 1) for line in text.splitlines() if ":" in line)
    return BootDrive(
        path=path, board_id=fields.get("Board-ID", "").strip(), model=fields.get("Model", "").strip()
    )


def _choose_drive(drives: list[BootDrive]) -> BootDrive:
    if len(drives) == 1:
        return drives[0]
    if drives:
        listed = ", ".join(str(drive.path) for drive in drives)
        raise DeviceNotFoundError(
            f"several boot drives of boards are mounted: {listed}", remedy="choose one with `drive`"
        )
    unmounted = _find_unmounted()
    if unmounted:
        raise DeviceNotFoundError(
            f"a board's boot drive is not mounted: {unmounted}",
            remedy=f"mount it: udisksctl mount -b {unmounted}",
        )
    raise DeviceNotFoundError("no boot drive of a board found", remedy=HOLD_BOOTSEL)


def _find_unmounted() -> Path | None:
    """Return the block device of a boot drive that is connected but not mounted, or None."""
    labels = Path("/dev/disk/by-label")
    return next((labels / name for name in FAMILY_OF_DRIVE if (labels / name).exists()), None)


def _check_kind(image: Path, content: bytes) -> None:
    if not is_uf2(content):
        raise ConfigError(
            f"{image} is not a UF2 file", remedy="flash the .uf2 file that rig firmware build wrote beside it"
        )


def _check_family(image: Path, content: bytes, drive: BootDrive) -> None:
    _check_kind(image, content)
    family = read_uf2(content, str(image)).family
    wanted = FAMILY_OF_DRIVE.get(drive.board_id)
    if wanted is None:
        raise DeviceNotFoundError(
            f"the drive at {drive.path} belongs to an unknown board: {drive.board_id or 'no Board-ID'}",
            remedy=f"use one of the supported boards: {', '.join(FAMILY_OF_DRIVE)}",
        )
    if family != wanted:
        is_for = "no processor" if family is None else FAMILIES.get(family, f"family {family:#010x}")
        raise ConfigError(
            f"the image {image} is for {is_for}, but the board at {drive.path} is a {drive.model or drive.board_id}",
            remedy="build the firmware for that board, or connect the other one",
        )


def _check_board(image: Path, record: Record, drive: BootDrive) -> None:
    wanted = boards.load(record.facts.board).drive if record.facts.board in boards.names() else drive.board_id
    if wanted != drive.board_id:
        raise ConfigError(
            f"the image {image} is for board {record.facts.board}, not for {drive.board_id}",
            remedy="build the firmware for that board",
        )


def _copy(content: bytes, drive: BootDrive, name: str, on_progress: Progress) -> None:
    """Write the image to the drive; raise `LinkLostError` if the drive disappears or is not writable."""
    # The board restarts once it has every byte, before the system has finished the write: that error is a success.
    at = 0
    try:
        with (drive.path / name).open("wb", buffering=0) as file:
            while at < len(content):
                at += file.write(content[at : at + _CHUNK])
                on_progress("writing", at / len(content))
            with suppress(OSError):
                os.fsync(file.fileno())
    except OSError as error:
        gone = not _is_there(drive)
        if gone and at == len(content):
            return
        if gone:
            raise LinkLostError(
                f"the board at {drive.path} disappeared while copying, after {at} of {len(content)} bytes",
                remedy=HOLD_BOOTSEL,
            ) from None
        raise LinkLostError(
            f"the image cannot be written to {drive.path}: {error.strerror or error}",
            remedy="check that the drive is writable and not full; then unplug the board and try again",
        ) from None


def _is_there(drive: BootDrive) -> bool:
    # A stale mount gives an error: the drive is gone.
    try:
        return (drive.path / INFO_FILE).exists()
    except OSError:
        return False


def _wait_for_drive(drive: Path | None, on_progress: Progress) -> None:
    """Wait until the system has mounted the drive (None: any boot drive), at most `APPEAR_S` (20 s); raise nothing."""
    deadline = time.monotonic() + APPEAR_S
    while not (find_drives() if drive is None else _read_drive(drive)) and time.monotonic() < deadline:
        on_progress("waiting for the board's drive", 1.0 - (deadline - time.monotonic()) / APPEAR_S)
        time.sleep(_LOOK_S)


def _wait_until_gone(drive: BootDrive, on_progress: Progress) -> None:
    """Wait until the drive disappears, the only sign that the board has accepted the image and restarts.

    Raise `LinkLostError` if the drive is still present after `VANISH_S` (20 s).
    """
    deadline = time.monotonic() + VANISH_S
    while _is_there(drive):
        left = deadline - time.monotonic()
        if left <= 0.0:
            raise LinkLostError(
                f"the board at {drive.path} did not accept the image: its drive is still present after {VANISH_S:g} s",
                remedy="unplug the board, hold BOOTSEL while plugging it in, and flash again",
            )
        on_progress("waiting for the board to start", 1.0 - left / VANISH_S)
        time.sleep(_LOOK_S)
