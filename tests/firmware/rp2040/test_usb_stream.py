"""The throughput of USB beside a busy tick, which it must not delay."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from rig.firmware._elf import flat, read_segments, seal
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.test_rp2040_boot import BOOT2_BYTES
from tests.firmware.rp2040.usb_host import BOARD, CORE
from tests.firmware.rp2040.usb_line import UsbLine

STREAM_US = 40_000.0
FRAME_BYTES, SAMPLES = 254, 45  # BATCH's longest, with the measured current
PORT_FILES = [
    "boot2.S",
    "start.S",
    "image.c",
    "reset.c",
    "exceptions.c",
    "clocks.c",
    "timekeeping.c",
    "usb*.c",
]
FLAGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-O2", "-mcpu=cortex-m0plus", "-mthumb"),
    *("-ffunction-sections", "-nostartfiles", "--specs=nano.specs", "--specs=nosys.specs", "-Wl,--gc-sections"),
)  # fmt: skip
WAKE_CYCLES = 48  # entry or return of the USB's interrupt, which a chip shortens when a tick comes meanwhile


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("arm-none-eabi-gcc is not installed (package gcc-arm-none-eabi)")
    place = tmp_path_factory.mktemp("stream")
    (place / "board_config.h").write_text(
        "#define BOARD_CLOCK_200MHZ\n"
        f"#define BOARD_ENABLE_PIN {emulator.PINS['enable']}u\n"
        f"#define BOARD_SYNC_OUT_PIN {emulator.PINS['sync_out']}u\n"
    )
    sources = [
        Path(__file__).with_name("usb_stream.c"),
        *(f for name in PORT_FILES for f in BOARD.glob(name)),
    ]
    elf, bin_ = place / "stream.elf", place / "stream.bin"
    options = [*FLAGS, f"-I{place}", f"-I{BOARD}", f"-I{CORE}", f"-T{BOARD / 'rp2040.ld'}", "-o", elf]
    command = ["arm-none-eabi-gcc", *options, *sources]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    content = seal(elf.read_bytes(), BOOT2_BYTES)
    bin_.write_bytes(flat(tuple(s.load for s in read_segments(content, "stream") if s.load.data)))
    return bin_


def test_frames_of_every_tick_arrive_and_the_tick_keeps_its_beat(image: Path) -> None:
    rate = 50_000
    with emulator.Pico(emulator.built("usual")[0], image) as pico:
        line = UsbLine(pico)
        line.send(rate.to_bytes(4, "little"))
        line.run(5_000.0)
        known = len(pico.ticks().at)
        before = line.look()
        data = line.run(STREAM_US)
        after = line.look()
        ticks = pico.ticks()[known:]
        assert after["errors"] == []
    frames = [frame for frame in data.split(b"\0") if len(frame) == FRAME_BYTES - 1]
    numbers = [int(frame[:8], 16) for frame in frames]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert len(numbers) >= STREAM_US * 1e-6 * rate / SAMPLES - 2
    period = emulator.CLOCK_HZ // rate
    entered = np.diff(ticks.entered)
    jitter = int(np.abs(entered - period).max())
    busy = (after["bytesIn"] - before["bytesIn"]) / (STREAM_US * 1e-6)
    print(f"{rate} Hz: {len(numbers)} frames, {busy / 1e3:.0f} kB/s, tick to tick {jitter} cycles at most")
    assert jitter <= WAKE_CYCLES
