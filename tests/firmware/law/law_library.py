"""The C law for tests: its structures in ctypes, its compiler, and a library object that runs it."""

import ctypes as ct
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from tests.firmware.build import compiler, content, identity, kept

SOURCES = Path(__file__).parents[3] / "firmware_protocol" / "firmware" / "law"
DRIVER = Path(__file__).with_name("law_driver.c")
STRICT = [
    "-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Wdouble-promotion",
    "-Wstrict-prototypes", "-Wmissing-prototypes", "-Werror", "-ffp-contract=off",
]  # fmt: skip
WINDOW, RING, SECTIONS = 64, 128, 4

i32, u32, i64, u64, f32 = ct.c_int32, ct.c_uint32, ct.c_int64, ct.c_uint64, ct.c_float
i8, u8, i16, u16 = ct.c_int8, ct.c_uint8, ct.c_int16, ct.c_uint16


def kept_law(name: str, *options: str) -> Path:
    """Return the law with its driver, compiled now or in an earlier run."""
    read = content([*SOURCES.iterdir(), DRIVER])

    def make(output: Path) -> None:
        sources = [str(path) for path in (*sorted(SOURCES.glob("*.c")), DRIVER)]
        command = [compiler(), *STRICT, *options, f"-I{SOURCES}", "-o", name, *sources, "-lm"]
        run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=output)
        assert run.returncode == 0, run.stderr

    return kept(f"law {name} {identity(compiler())} {STRICT} {options} {read}", make) / name


def structure(name: str, *fields: tuple[type, str]) -> type[ct.Structure]:
    """Return a structure from (type, "names in order") pairs, in the layout of law.h."""
    listed = [(word, kind) for kind, words in fields for word in words.split()]
    return type(name, (ct.Structure,), {"_fields_": listed})


Biquad = structure("Biquad", (i32, "b0 b1 b2 a1 a2 coefficient_bits state_bits word_bits rounding"))
Section = structure("Section", (f32, "inner band low"), (i32, "order"))
LowPass = structure("LowPass", (i32, "sections"), (Section * SECTIONS, "section"))
Foaw = structure("Foaw", (i32, "band limit stop_first least_squares"))
Levant = structure("Levant", (f32, "alpha lambda_"), (i32, "discretisation integrator"))
Kalman = structure("Kalman", (f32, "gain_position gain_velocity gain_acceleration input"))
TwoMass = structure(
    "TwoMass",
    (f32, "spring_motor spring_link gain_position gain_velocity gain_twist gain_link gain_hand input"),
)
Fixed = structure(
    "Fixed",
    (i64, "constant home_effort"),
    (i32, "trial_slew homing_slew speed_limit slow_speed direction side surface stiffness damping shift"),
    (i32, "home_stiffness home_damping home_shift reserved"),
)
Wall = structure(
    "Wall",
    (f32, "surface_fraction side stiffness damping constant trial_slew homing_slew speed_limit slow_speed"),
    (f32, "velocity_lsb home_stiffness home_damping home_effort passive_damping"),
    (i32, "surface_whole"),
)
Excitation = structure("Excitation", (u32, "lines first step period ramp amplitude bits phases seed"))
Parameters = structure(
    "Parameters",
    (i64, "home_target home_step"),
    (i32, "arithmetic estimator reference sense window_minimum window_maximum home_minimum home_maximum"),
    (i32, "free_minimum free_maximum"),
    (i32, "current_limit may_pull entry_only bilateral extrapolate estimated_position"),
    (u32, "velocity_divider slow_multiple settle_ticks home_timeout_ticks"),
    (u32, "free_ticks trial_ticks hold_ticks release_ticks"),
    (Biquad, "biquad"),
    (LowPass, "low_pass"),
    (Foaw, "foaw"),
    (Levant, "levant"),
    (Kalman, "kalman"),
    (TwoMass, "two_mass"),
    (Wall, "wall"),
    (Fixed, "fixed_wall"),
    (Excitation, "excitation"),
)
ExcitationState = structure("ExcitationState", (i32, "at"), (u32, "rising rise"), (ct.c_void_p, "table"))
FoawState = structure(
    "FoawState",
    (u32, "samples newest period"),
    (i32 * RING, "count"),
    (u32 * RING, "taken"),
    (i32 * (WINDOW + 1), "rise span"),
)
LevantState = structure("LevantState", (f32, "error integrator"))


class Memory(ct.Union):
    _fields_ = (("foaw", FoawState), ("levant", LevantState))  # the largest, and what tests look into


State = structure(
    "State",
    (i64, "setpoint wall_energy active_sum"),
    (i32, "limited_fixed"),
    (f32, "limited velocity velocity_sampled velocity_slope"),
    (i32, "velocity_fixed"),
    (u32, "window since velocity_ticks sampled phase phase_ticks rest_ticks contact_ticks"),
    (u32, "release_share release_rest release_step release_step_rest"),
    (i32, "previous travel"),
    (u32, "flags"),
    (Memory, "of"),
    (ExcitationState, "excitation"),
)
Input = structure("Input", (i32, "count"), (u32, "elapsed_ticks"), (i32, "active"))
Output = structure("Output", (i32, "current"), (u32, "flags phase"))

INPUTS = np.dtype([("count", "<i4"), ("elapsed_ticks", "<u4"), ("active", "<i4")])
TICKS = np.dtype([  # what the driver leaves of a tick
    ("current", "<i4"), ("flags", "<u4"), ("phase", "<u4"), ("velocity", "<f4"), ("limited", "<f4"),
    ("velocity_fixed", "<i4"), ("window", "<u4"),
])  # fmt: skip


def inputs(counts: Sequence[int] | np.ndarray, elapsed: Sequence[int] | np.ndarray | int = 1) -> np.ndarray:
    """Return the inputs of these ticks; counts wrap at 32 bits as an encoder's do."""
    table = np.zeros(len(counts), INPUTS)
    table["count"] = np.asarray(counts, np.int64).astype(np.uint32).view(np.int32)
    table["elapsed_ticks"] = elapsed
    return table


class LawLibrary:
    @classmethod
    def built(cls) -> Self:
        return cls(kept_law("law.so", "-O2", "-fPIC", "-shared"))

    def __init__(self, path: Path) -> None:
        self.so = so = ct.CDLL(str(path))
        so.law_tick.restype = Output
        so.law_tick.argtypes = so.driver_run.argtypes = None
        so.law_line_phase.restype = u32
        so.law_line_phase.argtypes = [u32, u32]
        so.law_cosine.argtypes = [u32]
        so.law_excitation_continue.restype = ct.c_bool
        so.driver_size.restype = ct.c_size_t
        for number, kind in enumerate((Parameters, State, Input, Output)):
            assert so.driver_size(number) == ct.sizeof(kind), kind.__name__
        assert so.driver_size(4) == TICKS.itemsize

    def check(self, parameters: ct.Structure) -> int:
        """Return the result of law_check: 0 for valid parameters."""
        return int(self.so.law_check(ct.byref(parameters)))

    def reset(self, parameters: ct.Structure) -> ct.Structure:
        """Return the initial state of a law with valid parameters and its excitation."""
        assert self.check(parameters) == 0
        state, table = State(), self.excitation(parameters)
        self.so.law_reset(ct.byref(state), ct.byref(parameters), table.ctypes.data_as(ct.c_void_p))
        state.keeps = table  # alive: the law points into it
        return state

    def excitation(self, parameters: ct.Structure, cosines: int = 1000) -> np.ndarray:
        """Compute one period of the excitation, in pieces of `cosines`."""
        p, work = parameters.excitation, ct.create_string_buffer(self.so.driver_size(5))
        table = np.zeros(p.period if p.lines else 0, np.int16)
        self.so.law_excitation_begin(work, ct.byref(p), table.ctypes.data_as(ct.c_void_p))
        while not self.so.law_excitation_continue(work, u32(cosines)):
            pass
        return table

    def tick(
        self, state: Any, parameters: Any, count: int, elapsed: int = 1, active: int = 0
    ) -> ct.Structure:
        sample = Input(count, elapsed, active)
        return self.so.law_tick(ct.byref(state), ct.byref(parameters), ct.byref(sample))

    def run(self, parameters: Any, table: np.ndarray, state: ct.Structure | None = None) -> np.ndarray:
        """Run a law (a new one by default) over a table of inputs; return the output of each tick."""
        state = self.reset(parameters) if state is None else state
        out = np.zeros(len(table), TICKS)
        self.so.driver_run(
            ct.byref(state), ct.byref(parameters), table.ctypes.data_as(ct.c_void_p),
            ct.c_size_t(len(table)), out.ctypes.data_as(ct.c_void_p),
        )  # fmt: skip
        return out


def case_bytes(cases: Iterable[tuple[ct.Structure, np.ndarray]]) -> bytes:
    """Return the input of the driver program: for each case parameters, number of ticks, inputs."""
    return b"".join(
        bytes(parameters) + len(table).to_bytes(8, "little") + table.tobytes() for parameters, table in cases
    )
