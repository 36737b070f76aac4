"""The law built for a Cortex-M and run in an instruction-set simulator: answers, and instructions a tick.

Nothing of a board is there but memory. Instructions are counted by basic blocks: exact, and quick enough.
"""

from __future__ import annotations

import ctypes as ct
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.firmware.law.law_library import SOURCES, STRICT, TICKS, Output, Parameters, State

FLASH, RAM, SIZE = 0x0800_0000, 0x2000_0000, 0x2_0000
OUTPUT, INPUT, STATE, PARAMETERS = RAM, RAM + 0x40, RAM + 0x100, RAM + 0x1000
STACK, STACK_LEAST, WORK, TABLE = RAM + 0x8000, RAM + 0x4000, RAM + 0x9000, RAM + 0xA000
PAINT = b"\xa5"
RETURN = FLASH + SIZE - 0x100  # where the law returns to: nothing is there


@dataclass(frozen=True)
class Core:
    """A processor: what gcc calls it, what unicorn calls it."""

    name: str
    flags: tuple[str, ...]
    model: str


CORES = {
    core.name: core
    for core in (
        Core("M0+", ("-mcpu=cortex-m0plus", "-mfloat-abi=soft"), "UC_CPU_ARM_CORTEX_M0"),
        Core("M4F", ("-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"), "UC_CPU_ARM_CORTEX_M4"),
        Core("M7", ("-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"), "UC_CPU_ARM_CORTEX_M7"),
    )
}


@dataclass(frozen=True)
class Image:
    """Bytes for the flash, where its functions are, and how large each part is."""

    core: Core
    code: bytes
    symbols: dict[str, int]


def build(core: Core, directory: Path) -> Image:
    """Compile and link the law for a core; the test is skipped where there is no compiler for it."""
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip(
            "arm-none-eabi-gcc is not installed (packages gcc-arm-none-eabi, libnewlib-arm-none-eabi)"
        )
    elf, raw = directory / "law.elf", directory / "law.bin"
    sources = [str(path) for path in sorted(SOURCES.glob("*.c"))]
    keep = [
        f"-Wl,-u,{name}"
        for name in ("law_check", "law_reset", "law_tick", "law_excitation_continue", "law_excitation_begin")
    ]
    link = ["-nostartfiles", "--specs=nosys.specs", f"-Wl,-Ttext={FLASH:#x},-e,law_tick,--gc-sections", *keep]
    sections = ["-ffunction-sections", "-fdata-sections", "-fno-math-errno"]
    command = ["arm-none-eabi-gcc", *STRICT, "-O2", "-mthumb", *core.flags, *sections, *link]
    _run([*command, "-o", str(elf), *sources, "-lm"])
    _run(["arm-none-eabi-objcopy", "-O", "binary", "-j", ".text*", "-j", ".rodata*", str(elf), str(raw)])
    listed = [line.split() for line in _run(["arm-none-eabi-nm", str(elf)]).splitlines()]
    symbols = {name: int(address, 16) for address, _, name in (row for row in listed if len(row) == 3)}
    held = [row[2] for row in listed if len(row) == 3 and row[1] in "bBdD" and "law" in row[2]]
    assert not held, f"globals: {held}"
    return Image(core, raw.read_bytes(), symbols)


def _run(command: list[str]) -> str:
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


class Simulator:
    """One core with the law in its flash."""

    def __init__(self, image: Image):
        unicorn = pytest.importorskip(
            "unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)"
        )
        arm = pytest.importorskip("unicorn.arm_const")
        self.uc = uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(getattr(arm, image.core.model))
        uc.mem_map(FLASH, SIZE)
        uc.mem_map(RAM, SIZE)
        uc.mem_write(FLASH, image.code)
        uc.mem_write(STACK_LEAST, PAINT * (STACK - STACK_LEAST))
        self.image, self.arm = image, arm
        self.instructions, self._blocks = 0, {}
        uc.hook_add(unicorn.UC_HOOK_BLOCK, self._count)

    def _count(self, uc: Any, address: int, size: int, user: object) -> None:
        key = (address, size)
        if key not in self._blocks:
            words = np.frombuffer(bytes(uc.mem_read(address, size)), "<u2")
            number = at = 0
            while at < len(words):
                at += 2 if words[at] >> 11 in (0b11101, 0b11110, 0b11111) else 1
                number += 1
            self._blocks[key] = number
        self.instructions += self._blocks[key]

    def call(self, name: str, *arguments: int) -> int:
        """Call a function with up to four words; its answer, and `instructions` what it took."""
        uc, arm = self.uc, self.arm
        for register, value in zip(("R0", "R1", "R2", "R3"), arguments, strict=False):
            uc.reg_write(getattr(arm, f"UC_ARM_REG_{register}"), value)
        uc.reg_write(arm.UC_ARM_REG_SP, STACK)
        uc.reg_write(arm.UC_ARM_REG_LR, RETURN | 1)
        self.instructions = 0
        uc.emu_start(self.image.symbols[name] | 1, RETURN)
        return int(uc.reg_read(arm.UC_ARM_REG_R0))

    def run(self, parameters: ct.Structure, table: np.ndarray, phase: int) -> tuple[np.ndarray, np.ndarray]:
        """What each tick left, as `LawLibrary.run` has it, and its instructions; it begins in a phase."""
        uc = self.uc
        uc.mem_write(PARAMETERS, bytes(parameters))
        assert self.call("law_check", PARAMETERS) == 0
        self.call("law_excitation_begin", WORK, PARAMETERS + Parameters.excitation.offset, TABLE)
        while not self.call("law_excitation_continue", WORK, 1000) & 0xFF:
            pass
        self.call("law_reset", STATE, PARAMETERS, TABLE)
        uc.mem_write(STATE + State.phase.offset, phase.to_bytes(4, "little"))
        rows, spent = np.zeros(len(table), TICKS), np.zeros(len(table), np.int64)
        for k, sample in enumerate(table):
            uc.mem_write(INPUT, sample.tobytes())
            self.call("law_tick", OUTPUT, STATE, PARAMETERS, INPUT)
            spent[k] = self.instructions
            out = Output.from_buffer_copy(bytes(uc.mem_read(OUTPUT, ct.sizeof(Output))))
            state = State.from_buffer_copy(bytes(uc.mem_read(STATE, ct.sizeof(State))))
            rows[k] = (
                out.current,
                out.flags,
                out.phase,
                state.velocity,
                state.limited,
                state.velocity_fixed,
                state.window,
            )
        return rows, spent

    @property
    def stack(self) -> int:
        """Bytes of stack that were ever used."""
        painted = bytes(self.uc.mem_read(STACK_LEAST, STACK - STACK_LEAST))
        return len(painted) - (len(painted) - len(painted.lstrip(PAINT)))
