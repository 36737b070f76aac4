"""The law in the instruction-set simulator, with the runner of golden vectors beside it."""

from __future__ import annotations

import ctypes as ct
from pathlib import Path

import numpy as np

from tests.firmware import cortex
from tests.firmware.cortex import CORES, RAM, CortexCore, Image
from tests.firmware.law.law_library import SOURCES, TICKS, Output, Parameters, State

OUTPUT, INPUT, STATE, PARAMETERS, WORK, TABLE = (
    RAM + offset for offset in (0x8000, 0x8040, 0x8100, 0x9000, 0x9800, 0xA000)
)
ENTRIES = (
    "law_tick",
    "law_check",
    "law_reset",
    "law_excitation_begin",
    "law_excitation_continue",
    "golden_run",
)
RUNNER = Path(__file__).parents[1] / "golden.c"

__all__ = ["CORES", "Simulator", "build"]


def build(core: CortexCore) -> Image:
    """Compile and link the law for a core; the test is skipped where there is no compiler for it."""
    image = cortex.build(core, [*sorted(SOURCES.glob("*.c")), RUNNER], ENTRIES)
    held = [name for name, at in image.symbols.items() if at >= RAM and "law" in name]
    assert not held, f"globals: {held}"
    return image


class Simulator(cortex.Simulator):
    """One core with the law in its flash."""

    def prepare(self, parameters: ct.Structure) -> None:
        """Check parameters, work out the excitation's table, reset the law."""
        self.uc.mem_write(PARAMETERS, bytes(parameters))
        assert self.call("law_check", PARAMETERS) == 0
        self.call("law_excitation_begin", WORK, PARAMETERS + Parameters.excitation.offset, TABLE)
        while not self.call("law_excitation_continue", WORK, 1000) & 0xFF:
            pass
        self.call("law_reset", STATE, PARAMETERS, TABLE)

    def run(
        self, parameters: ct.Structure, table: np.ndarray, phase: int | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What each tick left, as `LawLibrary.run` has it, its instructions and its cycles.

        It begins in a phase of the trial if one is given.
        """
        uc = self.uc
        self.prepare(parameters)
        if phase is not None:
            uc.mem_write(STATE + State.phase.offset, phase.to_bytes(4, "little"))
        rows, spent = np.zeros(len(table), TICKS), np.zeros((2, len(table)), np.int64)
        for k, sample in enumerate(table):
            uc.mem_write(INPUT, sample.tobytes())
            self.call("law_tick", OUTPUT, STATE, PARAMETERS, INPUT)
            spent[:, k] = self.instructions, self.cycles
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
        return rows, *spent
