"""Golden vectors: the outputs of the Python law for the counts of a simulated hit, in one format for every processor.

A law in integers must have them to the bit; a law in float32 must have the currents of the host's law in float64 within
`tolerance`, its phases and, but for one, its flags. `crc` is the CRC-32 of the outputs of this computer's build, which
every processor must have.

A file, little-endian: 64 bytes of header, `parameters` bytes of law_parameters (law.h; no pointer is in it, so it
is laid out alike everywhere), then a record for each tick.

    header  0  4 bytes  "HRGV"
            4  u16      version, 1
            6  u16      bytes of the header, 64
            8  u32      bytes of the parameters
           12  u32      ticks
           16  i32      tolerance (quanta); below zero: currents are not compared
           20  u32      flags that must be equal
           24  u32      CRC-32 of the answers: current i32, flags u32, phase u32 of each tick
           28  4 bytes  0
           32  32 bytes name, ASCII, zeros behind it
    record  0  i32      count
            4  u32      elapsed ticks
            8  i32      current (quanta)
           12  u32      flags
           16  u32      phase

`golden.c` runs one; `vectors` makes them anew.
"""

import ctypes as ct
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rig.core.sample import RowFlag
from tests.firmware.law.exact_law import ExactLaw
from tests.firmware.law.law_design import FIXED, FLOAT, parameters_of
from tests.firmware.law.law_library import LawLibrary, inputs
from tests.firmware.law.law_rigs import DUAL, SHORT, START, UNIFORM, controller_of, experiment_of, on_the_host

HEADER = struct.Struct("<4sHHIIiII4x32s")
RECORD = np.dtype(
    [("count", "<i4"), ("elapsed", "<u4"), ("current", "<i4"), ("flags", "<u4"), ("phase", "<u4")]
)
ANSWER = ["current", "flags", "phase"]
VERSION = 1
EVERY_FLAG = 0xFFFF_FFFF
UNCOMPARED = -1

ESTIMATORS: dict[str, dict[str, float | str]] = {
    "fdm-butterworth-fixed": {},
    "fdm": {},
    "fdm-butterworth": {},
    "foaw-end": {},
    "foaw-best": {"window_limit": 24.0},
    "levant": {},
    "kalman": {"gain": "steady"},
}
SCHEMES = {"dual": DUAL, "uniform": UNIFORM}
TIMES = {**SHORT, "trial.duration_s": 0.04, "trial.release_s": 0.01}
SIDES = (1, -1)


@dataclass(frozen=True)
class Vector:
    name: str
    parameters: ct.Structure
    records: np.ndarray  # dtype RECORD
    tolerance: int
    flags: int
    crc: int

    @property
    def inputs(self) -> np.ndarray:
        return inputs(self.records["count"], self.records["elapsed"])

    def to_bytes(self) -> bytes:
        parameters = bytes(self.parameters)
        head = HEADER.pack(
            b"HRGV", VERSION, HEADER.size, len(parameters), len(self.records), self.tolerance, self.flags,
            self.crc, self.name.encode(),
        )  # fmt: skip
        return head + parameters + self.records.tobytes()


def vectors(law: LawLibrary) -> Iterator[Vector]:
    """Yield a vector for every estimator, scheme, arithmetic and side of the wall; `law` is this computer's build."""
    for scheme in SCHEMES:
        for side in SIDES:
            for estimator in ESTIMATORS:
                for arithmetic in (FIXED, FLOAT) if estimator == "fdm-butterworth-fixed" else (FLOAT,):
                    yield vector(law, estimator, scheme, side, arithmetic)


def vector(law: LawLibrary, estimator: str, scheme: str, side: int, arithmetic: int) -> Vector:
    experiment = experiment_of(estimator, ESTIMATORS[estimator], SCHEMES[scheme], TIMES)
    changes = {"wall.side": side, "trial.start": START * side, "trial.effort": experiment.trial.effort * side}
    experiment = experiment_of(estimator, ESTIMATORS[estimator], SCHEMES[scheme], TIMES, changes)
    run = on_the_host(experiment, START * side)
    parameters = parameters_of(controller_of(experiment), arithmetic)
    records = np.zeros(len(run.counts), RECORD)
    records["count"], records["elapsed"] = run.counts, 1
    if arithmetic == FIXED:
        exact = ExactLaw(parameters)
        answers = [exact.tick(count) for count in run.counts.tolist()]
        records["current"], records["flags"], records["phase"] = zip(*answers, strict=True)
        tolerance, flags = 0, EVERY_FLAG
    else:
        records["current"], records["flags"], records["phase"] = run.currents, run.flags, run.phases
        tolerance, flags = 1, EVERY_FLAG & ~int(RowFlag.CLAMPED)
        if (estimator, scheme) == ("levant", "uniform"):  # its copy swings, and one rounding grows
            tolerance, flags = UNCOMPARED, EVERY_FLAG & ~int(RowFlag.CLAMPED | RowFlag.SATURATED)
    kind = "fixed" if arithmetic == FIXED else "float"
    name = f"{estimator}/{scheme}/{'+' if side > 0 else '-'}/{kind}"
    ours = law.run(parameters, inputs(run.counts))
    crc = zlib.crc32(np.ascontiguousarray(_answers(ours)).tobytes())
    return Vector(name, parameters, records, tolerance, flags, crc)


def _answers(ticks: np.ndarray) -> np.ndarray:
    answers = np.zeros(len(ticks), [("current", "<i4"), ("flags", "<u4"), ("phase", "<u4")])
    for field in ANSWER:
        answers[field] = ticks[field]
    return answers
