"""Compute the cost of one call of an exported estimator on a microcontroller: instructions, cycles, code and memory.

The export of an estimator reports the cost. It must not be called a measurement, because the processor is emulated.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rig.control.estimators import Ints
from rig.core.scratch import scratch
from rig.firmware._cortex import CORES, Simulator, build
from rig.firmware._estimator_c import FIXED, EstimatorC, c_float, estimator_c

__all__ = ["FIXED", "REPORTED", "Cost", "EstimatorC", "c_float", "cost_of", "estimator_c"]

REPORTED = ("M0+", "M4F", "M33F")
_ENTRIES = ("begin", "velocity")


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of one call of an estimator on one processor core, with memory without wait states (`rig.firmware._cortex`).

    Attributes
    ----------
    core
        Name of the core.
    instructions, most_instructions
        Median and largest number of instructions of a call (exact).
    cycles, most_cycles
        Median and largest number of cycles of a call (estimated); None if the core's cycles are not known.
    code_bytes, memory_bytes
        Size of the code, including functions of the compiler's library, and of the estimator's memory (bytes).
    """

    core: str
    instructions: int
    most_instructions: int
    cycles: int | None
    most_cycles: int | None
    code_bytes: int
    memory_bytes: int


def cost_of(
    estimator: EstimatorC,
    counts: Ints,
    elapsed: Ints,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[Cost, ...]:
    """Return the cost of an estimator on each core in `REPORTED` (M0+, M4F, M33F), from a simulated run.

    `counts` are encoder counts at successive velocity samples, `elapsed` the number of velocity periods between each
    sample and the one before. `on_progress` gets the name of the step and the completed share. Raise `ToolchainError`
    if the cross compiler or the simulator is not installed.
    """
    costs = []
    for number, name in enumerate(REPORTED):
        on_progress("counting instructions", number / len(REPORTED))
        costs.append(_cost(name, estimator, counts, elapsed))
    return tuple(costs)


def _cost(name: str, estimator: EstimatorC, counts: Ints, elapsed: Ints) -> Cost:
    core = CORES[name]
    with scratch("cycles") as place:
        source = place / "called.c"
        source.write_text(estimator.code + _write_harness(estimator), encoding="utf-8")
        image = build(core, place, [source], _ENTRIES)
    simulator = Simulator(image)
    simulator.call("begin")
    spent = []
    for count, periods in zip(counts.astype(np.int32).tolist(), elapsed.tolist(), strict=True):
        simulator.call("velocity", count, periods)
        spent.append((simulator.instructions, simulator.cycles))
    instructions, cycles = zip(*spent, strict=True)
    return Cost(
        core=name,
        instructions=int(np.median(instructions)),
        most_instructions=max(instructions),
        cycles=int(np.median(cycles)) if core.cycles_known else None,
        most_cycles=max(cycles) if core.cycles_known else None,
        code_bytes=len(image.code),
        memory_bytes=image.sizes["memory"],
    )


def _write_harness(estimator: EstimatorC) -> str:
    """Return C code with the functions that the simulator calls, and the estimator's memory."""
    prefix = estimator.prefix
    effort = "0.5f, " if estimator.uses_effort else ""
    return f"""
static {prefix}_estimator memory;
void begin(void);
void begin(void)
{{
    {prefix}_begin(&memory);
}}
{estimator.returns} velocity(int32_t count, uint32_t elapsed);
{estimator.returns} velocity(int32_t count, uint32_t elapsed)
{{
    return {prefix}_velocity(&memory, count, {effort}elapsed);
}}
"""
