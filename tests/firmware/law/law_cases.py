"""Parameters of the C law for tests: valid ones, invalid ones, and noise."""

import ctypes as ct
from collections.abc import Iterator
from functools import partial

import numpy as np

from rig.control.excitation_table import ExcitationTable
from tests.conformance.fixed_law import GoldenVectors, golden_vectors
from tests.firmware.law import law_design as design
from tests.firmware.law.law_library import Parameters, inputs
from tests.firmware.law.law_rigs import DUAL, SHORT, controller_of, experiment_of

EDGES = np.array([0, 1, -1, 2**31 - 1, -(2**31), 2**30, -(2**30), 255, 2**15])
GAPS = (1, 1, 1, 2, 7, 1500, 2**32 - 1, 0)


def golden_parameters(vectors: GoldenVectors) -> ct.Structure:
    """Return parameters without homing and limits, with the filter and the wall of golden vectors."""
    p = Parameters(arithmetic=design.FIXED, velocity_divider=vectors.velocity_divider, slow_multiple=1)
    p.window_minimum, p.window_maximum = -(2**31), 2**31 - 1
    p.home_minimum, p.home_maximum = p.window_minimum, p.window_maximum
    p.home_step, p.trial_ticks, p.release_ticks = 2**40, 2**32 - 1, 1
    p.home_timeout_ticks = 2**32 - 1
    design.copy_wall(p, vectors.wall)
    w, f = p.fixed_wall, vectors.filter
    w.trial_slew = w.homing_slew = 2**31 - 1
    w.speed_limit, w.home_shift = 2**31 - 1, 1
    design.copy_filter(p, f)
    return p


def excited(arithmetic: int, excitation: ExcitationTable) -> ct.Structure:
    """Return parameters of a trial that plays an excitation, without a wall or constant effort."""
    p = golden_parameters(golden_vectors(1))
    p.arithmetic, p.bilateral, p.current_limit = arithmetic, 1, 32767
    p.fixed_wall.stiffness = p.fixed_wall.damping = p.fixed_wall.constant = 0
    p.wall.side, p.wall.trial_slew, p.wall.homing_slew, p.wall.speed_limit = p.fixed_wall.side, 1e9, 1e9, 1e9
    for name, value in excitation.parameters().items():
        setattr(p.excitation, name.removeprefix("excitation_"), value)
    return p


# In the order of law_verdict: what must be refused.
BREAKS = {
    "choice": [
        ("estimator", 8), ("estimator", 3), ("arithmetic", 3), ("sense", 0), ("extrapolate", 1), ("may_pull", 2),
    ],
    "rate": [("velocity_divider", 0), ("velocity_divider", 2**17), ("slow_multiple", 0)],
    "limit": [
        ("current_limit", -1), ("current_limit", 32768), ("release_ticks", 0), ("home_step", -1),
        ("home_target", 2**60), ("window_maximum", -(2**31)),
    ],
    "filter": [
        ("biquad.word_bits", 33), ("biquad.rounding", 3), ("biquad.state_bits", -1), ("biquad.coefficient_bits", 31),
    ],
    "wall": [
        ("fixed_wall.shift", 41), ("fixed_wall.stiffness", -1), ("fixed_wall.constant", 2**63 - 1),
        ("fixed_wall.constant", -(2**63)), ("fixed_wall.direction", 0), ("fixed_wall.trial_slew", -1),
    ],
    "excitation": [("excitation.lines", 4097), ("excitation.lines", 1)],
}  # fmt: skip
BROKEN_FLOATS = (
    ("fdm-butterworth", "low_pass.sections", 5), ("foaw-end", "foaw.limit", 65), ("levant", "levant.discretisation", 3),
    ("fdm", "wall.side", 0.5), ("fdm", "wall.stiffness", float("nan")), ("fdm", "wall.trial_slew", float("nan")),
    ("fdm", "wall.passive_damping", float("nan")), ("fdm", "estimated_position", 1),
)  # fmt: skip


def set_field(p: ct.Structure, field: str, value: float) -> None:
    """Set a field, with dots for its owners."""
    owner, _, name = field.rpartition(".")
    setattr(getattr(p, owner) if owner else p, name, value)


def broken(field: str, value: int) -> ct.Structure:
    p = golden_parameters(golden_vectors(1))
    p.window_minimum += field == "window_maximum"
    set_field(p, field, value)
    return p


def of_estimator(name: str, **settings: float | str) -> ct.Structure:
    """Return the float law with an estimator, in a trial of a few ticks without limits."""
    settings |= design.OWN.get(name, {})
    p = design.parameters_of(controller_of(experiment_of(name, settings, DUAL, SHORT)))
    p.settle_ticks, p.trial_ticks, p.release_ticks, p.home_step = 2, 20, 7, 2**34
    p.window_minimum, p.window_maximum = p.home_minimum, p.home_maximum = -(2**31), 2**31 - 1
    p.wall.speed_limit, p.slow_multiple, p.wall.slow_speed = 3e38, 3, 1.0
    return p


def cases() -> Iterator[tuple[ct.Structure, np.ndarray]]:
    """Yield valid parameters with extreme inputs, then invalid ones, then noise."""
    random = np.random.default_rng(9)

    def wild(ticks: int) -> np.ndarray:
        near = random.integers(-400, 400, ticks)
        counts = np.where(random.random(ticks) < 0.3, random.choice(EDGES, ticks), near)
        table = inputs(counts, random.choice(GAPS, ticks))
        table["active"] = random.integers(-32768, 32768, ticks)
        return table

    good = []
    for seed in range(30):
        vectors = golden_vectors(seed)
        p = golden_parameters(vectors)
        yield p, inputs(vectors.counts)
        p.bilateral, p.slow_multiple, p.fixed_wall.slow_speed = seed % 2, 1 + seed % 3, 1 << 20
        good.append(p)
    for name in design.ESTIMATORS:
        for divider, stop, scheme in ((1, 0, 0), (10, 1, 1), (1, 1, 2)):
            p = of_estimator(name)
            p.velocity_divider, p.bilateral, p.extrapolate = divider, int(scheme == 1), stop
            p.may_pull, p.entry_only = stop, int(scheme == 2)
            p.foaw.stop_first = p.foaw.least_squares = stop
            p.levant.discretisation, p.levant.integrator = scheme, stop
            good.append(p)
    good.append(of_estimator("disturbance"))
    for name in ("kalman", "disturbance-two-mass"):
        passive = of_estimator(name)  # and the position of the estimator, on which it acts
        passive.estimated_position, passive.velocity_divider = 1, 1
        passive.wall.passive_damping, passive.wall.constant = 1e3, 1e9
        good.append(passive)
    elsewhere = of_estimator("kalman")
    elsewhere.arithmetic = design.ELSEWHERE
    good.append(elsewhere)
    good.append(of_estimator("fdm-butterworth", order=3))
    low_pass = partial(of_estimator, "fdm-butterworth-fixed")  # the other short cuts of the low pass
    good += [
        low_pass(cutoff_hz=900.0),
        low_pass(cutoff_hz=20.0, coefficient_bits=20),
        low_pass(rounding="floor"),
    ]
    for arithmetic, phases in ((design.FIXED, "schroeder"), (design.FLOAT, "hashed")):
        table = ExcitationTable(2, 1, 498, 1000, 2**30, ramp=9, phases=phases, bits=arithmetic)
        p = excited(arithmetic, table)
        p.release_ticks, p.trial_ticks = 50, 100
        good.append(p)
    bound = golden_parameters(golden_vectors(2))
    bound.fixed_wall.homing_slew = bound.fixed_wall.trial_slew = 3 << 13
    good.append(bound)
    for p in good:
        yield p, wild(300)
        calm = np.cumsum(random.integers(-1, 3, 300)) + p.reference - 100
        yield p, inputs(calm, random.choice(GAPS[:6], 300))
    for field, value in (change for changes in BREAKS.values() for change in changes):
        yield broken(field, value), wild(3)
    for field, value in (
        ("first", 500), ("first", 0), ("step", 0), ("period", 2**16 + 1), ("period", 0), ("amplitude", 2**31),
        ("bits", 16), ("phases", 2), ("ramp", 2**24 + 1), ("lines", 2**31),
    ):  # fmt: skip
        p = excited(design.FIXED, ExcitationTable(400, 1, 1, 1000, 2**16))
        setattr(p.excitation, field, value)
        yield p, wild(3)
    third_order = of_estimator("fdm-butterworth")
    third_order.low_pass.section[0].order = 3
    yield third_order, wild(3)
    short = of_estimator("fdm")
    short.home_timeout_ticks, short.home_minimum = 5, 2**31 - 1
    yield short, wild(10)
    for name, field, value in BROKEN_FLOATS:
        p = of_estimator(name)
        set_field(p, field, value)
        yield p, wild(3)
    for _ in range(600):
        noise = bytearray(good[int(random.integers(len(good)))])
        for _ in range(random.integers(1, 6)):
            word = int(random.integers(0, 80 if random.random() < 0.8 else len(noise) // 4))
            value = int(random.choice([*EDGES, 2, 3, 16, 40, *random.integers(-(2**31), 2**31, 4)]))
            noise[4 * word : 4 * word + 4] = value.to_bytes(4, "little", signed=True)
        yield Parameters.from_buffer_copy(noise), wild(40)
