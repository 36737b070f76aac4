"""Build code for a Cortex-M and run it in an instruction-set simulator, with instruction counts and estimated cycles.

The simulator has memory but no peripherals. Instructions are counted exactly, by basic blocks. Cycles are estimated
from the instructions, for code in memory without wait states. For the M33 only instructions are counted, because their
cycles were not looked up. `rig.firmware.cycles` and `tick_budget` use it. Its cycles must not be called measurements.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rig.core.deferred import unicorn
from rig.core.errors import ToolchainError
from rig.firmware._toolchain import find_compiler

FLASH, RAM, SIZE = 0x0800_0000, 0x2000_0000, 0x8_0000
STACK_TOP, STACK_LEAST = RAM + SIZE, RAM + SIZE - 0x4000  # memory below is free for the caller
RETURN = FLASH + SIZE - 0x100  # return address of a called function: empty flash
# The stack is filled with this byte before the first call: bytes that still have it were never used.
PAINT = b"\xa5"
STRICT = (
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wshadow",
    "-Wpedantic",
    "-Wdouble-promotion",
    "-Wstrict-prototypes",
    "-Wmissing-prototypes",
    "-Werror",
    "-ffp-contract=off",
)


@dataclass(frozen=True)
class CortexCore:
    """A processor core: compiler flags, name in the simulator unicorn, and clock frequency of a typical board (Hz)."""

    name: str
    flags: tuple[str, ...]
    model: str
    clock_hz: float = math.nan

    @property
    def cycles_known(self) -> bool:
        """Return True if the cycles of each instruction of this core are known, so that cycles can be estimated."""
        return self.name != "M33F"


CORES = {
    core.name: core
    for core in (
        CortexCore("M0+", ("-mcpu=cortex-m0plus", "-mfloat-abi=soft"), "UC_CPU_ARM_CORTEX_M0", 125e6),
        CortexCore(
            "M4F", ("-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"), "UC_CPU_ARM_CORTEX_M4", 168e6
        ),
        CortexCore(
            "M33F", ("-mcpu=cortex-m33", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"), "UC_CPU_ARM_CORTEX_M33"
        ),
        CortexCore(
            "M7", ("-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"), "UC_CPU_ARM_CORTEX_M7", 600e6
        ),
    )
}


@dataclass(frozen=True)
class Image:
    """A linked program: its bytes in flash, and addresses and sizes (bytes) of its functions and variables by name."""

    core: CortexCore
    code: bytes
    symbols: dict[str, int]
    sizes: dict[str, int]  # bytes of each function


def build(
    core: CortexCore, directory: Path, sources: Sequence[Path], entries: Iterable[str], *more: str
) -> Image:
    """Compile and link C sources for a processor core.

    Raise `ToolchainError` if the compiler is missing or rejects the sources.

    Parameters
    ----------
    core
        Core to compile for.
    directory
        Directory for the files of the compiler.
    sources, entries
        Source files, and the names of functions that the linker must keep because the simulator calls them.
    *more
        Further compiler options, such as include paths or another optimisation.
    """
    compiler = find_compiler()
    elf, raw = directory / "image.elf", directory / "image.bin"
    names = list(entries)
    keep = [f"-Wl,-u,{name}" for name in names]
    link = [
        "-nostartfiles",
        "--specs=nosys.specs",
        f"-Wl,-Ttext={FLASH:#x},-Tbss={RAM:#x},-e,{names[0]}",
        "-Wl,--gc-sections",
    ]
    options = ["-O2", "-mthumb", "-ffunction-sections", "-fdata-sections", "-fno-math-errno", *more]
    listed = [str(path) for path in sources]
    compiler.run([*STRICT, *core.flags, *options, *link, *keep, "-o", str(elf), *listed, "-lm"], directory)
    compiler.tool(
        "objcopy", ["-O", "binary", "-j", ".text*", "-j", ".rodata*", str(elf), str(raw)], directory
    )
    rows = [line.split() for line in compiler.tool("nm", ["-S", str(elf)], directory).splitlines()]
    symbols = {row[-1]: int(row[0], 16) for row in rows if len(row) >= 3}
    sizes = {row[-1]: int(row[1], 16) for row in rows if len(row) == 4}
    return Image(core, raw.read_bytes(), symbols, sizes)


@dataclass
class BasicBlock:
    """A basic block (code without jumps): end address, instructions, cycles, extra cycles if its last jump is taken."""

    end: int
    instructions: int
    cycles: int
    jump: int


@dataclass
class Simulator:
    """A simulated processor core with an image in its flash, which counts instructions and cycles of each call."""

    image: Image
    counts: bool = True  # count instructions and cycles; False is faster
    instructions: int = 0  # of the last call
    cycles: int = 0
    profile: Counter[int] | None = None  # cycles of each block, if wanted
    uc: Any = field(init=False)
    arm: Any = field(init=False)

    def __post_init__(self) -> None:
        try:
            self.arm = arm = unicorn.arm_const
        except ImportError as error:
            raise ToolchainError(
                "the instruction-set simulator unicorn is not installed",
                remedy="pip install haptic-rig[cycles]",
            ) from error
        self.uc = uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(getattr(arm, self.image.core.model))
        uc.mem_map(FLASH, SIZE)
        uc.mem_map(RAM, SIZE)
        uc.mem_write(FLASH, self.image.code)
        uc.mem_write(STACK_LEAST, PAINT * (STACK_TOP - STACK_LEAST))
        self._blocks: dict[tuple[int, int], BasicBlock] = {}
        self._last = BasicBlock(0, 0, 0, 0)
        if self.counts:
            uc.hook_add(unicorn.UC_HOOK_BLOCK, self._count)

    def _count(self, uc: Any, address: int, size: int, user: object) -> None:
        block = self._blocks.get((address, size))
        if block is None:
            words = np.frombuffer(bytes(uc.mem_read(address, size)), "<u2").tolist()
            block = self._blocks[address, size] = _count_block(address, words, self.image.core.name == "M0+")
        last, self._last = self._last, block
        cycles = block.cycles + (last.jump if address != last.end else 0)
        self.instructions += block.instructions
        self.cycles += cycles
        if self.profile is not None:
            self.profile[address] += cycles

    def call(self, name: str, *arguments: int, stack: bytes = b"") -> int:
        """Call a function of the image by name and return its result (32 bits).

        `arguments` are up to four words; `stack` contains the bytes of further arguments.
        """
        uc, arm = self.uc, self.arm
        for register, value in zip(("R0", "R1", "R2", "R3"), arguments, strict=False):
            uc.reg_write(getattr(arm, f"UC_ARM_REG_{register}"), value & 0xFFFF_FFFF)
        top = STACK_TOP - len(stack)
        uc.mem_write(top, stack)
        uc.reg_write(arm.UC_ARM_REG_SP, top)
        uc.reg_write(arm.UC_ARM_REG_LR, RETURN | 1)
        self.instructions = self.cycles = 0
        self._last = BasicBlock(self.image.symbols[name] & ~1, 0, 0, 0)
        uc.emu_start(self.image.symbols[name] | 1, RETURN)
        return int(uc.reg_read(arm.UC_ARM_REG_R0))

    @property
    def stack(self) -> int:
        """Return the largest number of stack bytes that the calls so far have used."""
        return len(bytes(self.uc.mem_read(STACK_LEAST, STACK_TOP - STACK_LEAST)).lstrip(PAINT))


# Cycles of the M0+ (Armv6-M, two stages; Cortex-M0+ Technical Reference Manual, table 3-1): a load or store 2, one of n
# words 1 + n, a taken branch 2, a call 3, a return from the stack 3 + n, everything else 1, also a product (the RP2040
# has the fast multiplier). M4F and M7: a load or store 2, a taken branch 3, a division of integers 8, of floats and a
# root 14, everything else 1; the M7 often issues two instructions per cycle, so its number is an upper bound.
def _count_block(address: int, words: list[int], small: bool) -> BasicBlock:
    """Return instructions and cycles of the basic block `words` (16 bits each) at `address`; `small`: the core M0+."""
    taken = 1 if small else 2  # more for a branch that is taken
    instructions = cycles = at = jump = 0
    while at < len(words):
        word, jump = words[at], 0
        if word >> 11 in (0b11101, 0b11110, 0b11111):
            cycles += 1 + _extra_wide(word, words[at + 1], taken)
            if word >> 11 == 0b11110 and words[at + 1] & 0xD000 == 0x8000:
                jump = taken  # a conditional branch
            at += 2
        else:
            cycles += 1 + _extra(word, taken)
            if (word >> 12 == 0b1101 and word >> 8 & 0xF < 0xE) or word & 0xF500 == 0xB100:
                jump = taken
            at += 1
        instructions += 1
    return BasicBlock(address + 2 * len(words), instructions, cycles, jump)


def _extra(word: int, taken: int) -> int:
    """Return the cycles above 1 of a 16-bit instruction; `taken` is the cost of a jump."""
    if word >> 11 == 0b01001 or word >> 12 in (0b0101, 0b0110, 0b0111, 0b1000, 0b1001):
        return 1
    if word & 0xF600 == 0xB400:  # push and pop
        return (word & 0xFF).bit_count() + (word >> 8 & 1) + (2 if word & 0xFF00 == 0xBD00 else 0)
    if word >> 12 == 0b1100:  # several words
        return (word & 0xFF).bit_count()
    if word >> 11 == 0b11100 or word & 0xFF00 == 0x4700 or word & 0xFF87 == 0x4687:
        return taken
    return 0


class _WideInstruction(NamedTuple):
    """A kind of 32-bit instruction: masks and values of its two halves, cycles above one, and whether it jumps."""

    mask: int
    value: int
    second_mask: int
    second_value: int
    cycles: int
    jumps: bool


_WIDE_INSTRUCTIONS = (
    _WideInstruction(0xF800, 0xF000, 0xD000, 0xD000, 2, False),  # call
    _WideInstruction(0xF800, 0xF000, 0xD000, 0x9000, 0, True),  # jump
    _WideInstruction(0xFFF0, 0xE8D0, 0xFFE0, 0xF000, 2, True),  # jump by table
    _WideInstruction(0xFE40, 0xE840, 0x0000, 0x0000, 2, False),  # two words
    _WideInstruction(0xFE00, 0xF800, 0x0000, 0x0000, 1, False),  # load and store
    _WideInstruction(0xFFD0, 0xFB90, 0x0000, 0x0000, 7, False),  # division
    _WideInstruction(0xFF20, 0xED00, 0x0000, 0x0000, 1, False),  # load and store of a float
    _WideInstruction(0xFFB0, 0xEE80, 0x0000, 0x0000, 13, False),  # its division
    _WideInstruction(0xFFBF, 0xEEB1, 0x00C0, 0x00C0, 13, False),  # its root
)


def _extra_wide(first: int, second: int, taken: int) -> int:
    """Return the cycles above 1 of a 32-bit instruction from its two halves; a jump costs `taken` cycles more."""
    if first & 0xFE40 == 0xE800:
        return second.bit_count()  # several words
    for kind in _WIDE_INSTRUCTIONS:
        if first & kind.mask == kind.value and second & kind.second_mask == kind.second_value:
            return kind.cycles + (taken if kind.jumps else 0)
    return second & 0xFF if first & 0xFE00 == 0xEC00 else 0  # several floats
