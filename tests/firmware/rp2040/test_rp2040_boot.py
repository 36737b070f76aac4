"""The Pico's boot, from power-up to its first reply: delays, duration, and the images that it refuses to start."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rig.firmware._build import BuildResult
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.emulator import START_US, WATCHDOG_US, Pico
from tests.firmware.rp2040.session import Session

BOOT_S = 0.2
CRYSTAL_DELAY_S = 6e-3  # of the maker's SDK
SETTLES_NS = 1e6


def test_it_listens_within_a_fifth_of_a_second(built: BuildResult) -> None:
    with Pico(emulator.built("usual")[0], built.bin, start_us=0.0, waits=True) as pico:
        while not len(pico.ticks().came) and pico.look()["now"] < BOOT_S * 1e9:
            pico.run(START_US)
        first = float(pico.ticks().came[0]) * 1e-9
    assert first < BOOT_S


def test_crystal_and_regulator_get_their_time_after_every_reset(powered: Callable[..., Session]) -> None:
    pico = powered().pico
    for resets in range(2):
        look = pico.look()
        assert look["resets"] == resets
        assert look["crystal_delay"] * 256 / 12e6 >= CRYSTAL_DELAY_S
        assert look["clock"] == 200_000_000
        assert look["settled"] >= SETTLES_NS, "from its last change to the fast clock"
        pico.ask("hang")
        pico.run(WATCHDOG_US + START_US)


@pytest.mark.parametrize("place", [0x800, -5])
def test_an_image_with_a_flipped_bit_shows_the_boot_roms_drive_and_drives_nothing(
    built: BuildResult, tmp_path: Path, place: int
) -> None:
    image = bytearray(built.bin.read_bytes())
    image[place] ^= 0x10
    broken = tmp_path / "broken.bin"
    broken.write_bytes(image)
    with Pico(emulator.built("usual")[0], broken) as pico:
        look = pico.look()
        assert look["bootloader"]
        assert not look["enabled"]
        assert len(pico.ticks().at) == 0
