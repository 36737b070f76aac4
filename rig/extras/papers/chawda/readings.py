"""Measure the impedance of many walls, and judge the passivity of each wall in many ways.

Chawda et al. do not state the frequency band and tolerance of their passivity test. A *reading*
(`rig.extras.papers.chawda.rigs.Reading`) is a passivity test with one band and one tolerance; every measurement is
judged by every reading, to count how much a result depends on this choice. A wall passes if Re Z is not below zero by
more than the tolerance, if the residual power is low, and if the coherence is sufficient, as in
`rig.analysis.impedance._verdict`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.analysis.impedance import Floats, Impedance, ideal_wall, periodic
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.deferred import integrate
from rig.experiments.mapping.interface import FrequencyWidth, Spread, connected
from rig.experiments.sweep import Task
from rig.experiments.trials.excitation_run import ExcitedRig, RealisationRun, Signal
from rig.extras.papers.chawda.rigs import COHERENCE, RESIDUAL, Reading
from rig.extras.papers.parts import Part

Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExcitationGrid:
    """Grid of walls (every stiffness with every damping) to excite with some sampling schemes.

    Each measured impedance is judged by all `readings` (passivity tests, each with a band and a tolerance).
    """

    experiment: Experiment  # its excitation has the realisations of all measurements
    schemes: tuple[Scheme, ...]
    stiffnesses: tuple[float, ...]
    dampings: tuple[float, ...]
    readings: tuple[Reading, ...]
    measurements: int
    signal: Signal = "count"

    @property
    def runs(self) -> int:
        """Return the number of excitations of a rig, if the safety guard ends no measurement early."""
        walls = len(self.schemes) * len(self.stiffnesses) * len(self.dampings)
        return walls * self.experiment.excitation.realisations

    def part(self, weight: float = 1.0) -> Part:
        """Return a task of the sweep for each sampling scheme and damping; `weight` is the cost of one excitation."""
        tasks = []
        for number, scheme in enumerate(self.schemes):
            applied = scheme.applied(config.excited(self.experiment))
            for damping in self.dampings:
                payload = {
                    "experiment": config.as_mapping(
                        replace(applied, wall=replace(applied.wall, stiffness=0.0, damping=damping))
                    ),
                    "stiffnesses": list(self.stiffnesses),
                    "readings": [[r.low_hz, r.high_hz, r.tolerance, r.kind] for r in self.readings],
                    "measurements": self.measurements,
                    "signal": self.signal,
                }
                runs = len(self.stiffnesses) * self.experiment.excitation.realisations
                tasks.append(Task(f"{number}/{damping!r}", column, payload, weight=weight * runs))
        return tasks


def column(payload: Mapping[str, Any]) -> list[list[dict[str, Any]]]:
    """Excite all walls of one sampling scheme and damping; return for each stiffness a dict for each measurement.

    `payload` has the experiment, the stiffnesses and the passivity tests. In the result, ``passive`` is a string with
    the digit 1 (passive) or 0 for each passivity test; ``fidelity`` is a list with the rms of |Z| − |K/(jω) + B|
    (N·s/m) in each of `bands`; ``residual`` is the share of the velocity's power beside the excited lines. A
    measurement that the safety guard ended is not passive, and its other values are None.
    """
    experiment = config.restore_experiment(payload["experiment"])
    readings = [
        Reading(low_hz=low, high_hz=high, tolerance=t, kind=k) for low, high, t, k in payload["readings"]
    ]
    bench = ExcitedRig(experiment, signal=payload["signal"])
    each = experiment.excitation.realisations // payload["measurements"]
    damping = experiment.wall.damping
    rows = []
    for stiffness in payload["stiffnesses"]:
        row: list[dict[str, Any]] = []
        for measurement in range(payload["measurements"]):
            runs = _excite(bench, stiffness, damping, range(measurement * each, (measurement + 1) * each))
            records = [run.record for run in runs if run.record is not None]
            if len(records) < len(runs):
                row.append({"passive": "0" * len(readings), "fidelity": None, "residual": None})
                continue
            impedance = periodic(records)
            passes, errors = read(impedance, stiffness, damping, readings)
            row.append(
                {
                    "passive": "".join("1" if passed else "0" for passed in passes),
                    "fidelity": errors.tolist(),
                    "residual": impedance.residual,
                }
            )
        rows.append(row)
    return rows


def _excite(bench: ExcitedRig, stiffness: float, damping: float, numbers: range) -> list[RealisationRun]:
    runs: list[RealisationRun] = []
    for number in numbers:
        runs.append(bench.excite(stiffness, damping, number))
        if runs[-1].record is None:
            break
    return runs


def read(
    impedance: Impedance, stiffness: float, damping: float, readings: Sequence[Reading]
) -> tuple[Flags, Floats]:
    """Judge the measured impedance of one wall: return passive or not by passivity test, and errors by band.

    The error is the rms of |Z| − |K/(jω) + B| (N·s/m) in each of `bands`.
    """
    lines, impedance_z = impedance.lines_hz, impedance.z
    error = impedance.magnitude - np.abs(ideal_wall(stiffness, damping, lines))
    # Lines with a low coherence are unknown: they do not count against a wall.
    coherent = ~(impedance.coherence_motion < COHERENCE)
    is_clean = not impedance.residual > RESIDUAL
    fails = {
        key: ~((impedance_z.real + _tolerance(impedance, *key) >= 0.0) & coherent)
        for key in {(reading.tolerance, reading.kind) for reading in readings}
    }
    lines_of = {band: _band(lines, *band) for band in bands(readings)}
    passes = [
        is_clean and not fails[r.tolerance, r.kind][lines_of[r.low_hz, r.high_hz]].any() for r in readings
    ]
    errors = [float(np.sqrt(np.mean(error[band] ** 2))) for band in lines_of.values()]
    return np.array(passes, np.bool_), np.array(errors)


def bands(readings: Sequence[Reading]) -> list[tuple[float, float]]:
    """Return the distinct frequency bands (lowest, highest frequency in Hz) of passivity tests, in their order."""
    return list(dict.fromkeys((reading.low_hz, reading.high_hz) for reading in readings))


def _tolerance(impedance: Impedance, tolerance: float, kind: str) -> Floats:
    if tolerance == 0.0:
        return np.zeros(len(impedance.z))
    if kind == "deviations":
        return np.nan_to_num(impedance.spread(tolerance))
    return np.asarray(impedance.magnitude * np.sin(np.radians(tolerance)))


def _band(lines: Floats, low: float, high: float) -> slice:
    slack = 1e-9
    return slice(
        int(np.searchsorted(lines, low * (1.0 - slack))), int(np.searchsorted(lines, high * (1.0 + slack)))
    )


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Passivity and fidelity error of all walls of a grid, by measurement and by passivity test (*reading*).

    `passive` and `fidelity` have the shape (measurement, reading, scheme, damping, stiffness); the fidelity error
    (N·s/m) is NaN if the safety guard ended the measurement.
    """

    grid: ExcitationGrid
    passive: Flags
    fidelity: Floats

    @classmethod
    def of(cls, grid: ExcitationGrid, columns: Sequence[list[list[dict[str, Any]]]]) -> Readings:
        """Build the arrays from the results of the tasks (one for each scheme and damping), in their order."""
        shape = (len(grid.schemes), len(grid.dampings), len(grid.stiffnesses), grid.measurements)
        cells = [cell for rows in columns for row in rows for cell in row]
        names = bands(grid.readings)
        none = [float("nan")] * len(names)
        passive = np.array([[digit == "1" for digit in cell["passive"]] for cell in cells], np.bool_)
        fidelity = np.array([none if cell["fidelity"] is None else cell["fidelity"] for cell in cells])
        of_band = [names.index((reading.low_hz, reading.high_hz)) for reading in grid.readings]
        order = (3, 4, 0, 1, 2)
        return cls(
            grid,
            passive.reshape(*shape, -1).transpose(order),
            fidelity.reshape(*shape, -1).transpose(order)[:, of_band].astype(np.float64),
        )

    def width(self, measurement: int, reading: int, scheme: int) -> FrequencyWidth:
        """Return largest passive stiffness and damping, and fidelity errors, of a sampling scheme in one measurement.

        All three arguments are indices; `reading` is the index of the passivity test (band and tolerance).
        """
        place = measurement, reading, scheme
        return FrequencyWidth.of(
            self.passive[place], self.fidelity[place], self.grid.stiffnesses, self.grid.dampings
        )

    def widths(self, reading: int, scheme: int) -> list[FrequencyWidth]:
        """Return largest passive stiffness and damping, and fidelity errors, of a sampling scheme for each measurement.

        `reading` is the index of the passivity test, `scheme` that of the sampling scheme.
        """
        return [self.width(m, reading, scheme) for m in range(self.grid.measurements)]

    def common(self, reading: int, schemes: Sequence[int] | None = None) -> Flags:
        """Return an array (damping, stiffness): True for walls passive in every measurement with all `schemes`.

        A wall counts only if all softer walls of the same damping are passive, too. `schemes` are indices; None: all
        sampling schemes.
        """
        chosen = range(len(self.grid.schemes)) if schemes is None else schemes
        return np.asarray(connected(self.passive[:, reading])[:, list(chosen)].all(axis=(0, 1)))

    def areas(self, reading: int, scheme: int) -> Spread:
        """Return the area of the passive region in the K–B plane (N/m × N·s/m, or the units of a rotary rig).

        The region ends, at each damping, below the softest wall that is not passive. The result has mean and standard
        deviation over the measurements.
        """
        k, b = np.array((0.0, *self.grid.stiffnesses)), np.array(self.grid.dampings)
        held = connected(self.passive[:, reading, scheme]).sum(axis=-1)
        return Spread.of([float(integrate.trapezoid(k[row], b)) for row in held])
