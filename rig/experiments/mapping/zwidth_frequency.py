"""Map the Z-width in the frequency domain: for which walls (K, B) the impedance is passive, and its fidelity.

    found = zwidth(frequency_plan(presets.load("chawda-linear")))  # rig.experiments.mapping._maps, .ranges
    table_one(found)  # rig.experiments.mapping.table_one

`_maps` uses this module for `rig impedance map`. A map tests every wall of a grid, in parallel tasks: each is a column
of the grid with one sampling scheme and one damping. Source: Chawda et al., section V, Figs. 5 to 8. Verdict and
fidelity are computed by `rig.analysis.impedance._verdict`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.analysis.impedance import Floats
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.present import Item, Row, plain
from rig.core.sample import unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments import sweep
from rig.experiments.mapping._searches import check_values
from rig.experiments.mapping.impedance import ImpedanceResult, Judging, conclude, refuse_excitations
from rig.experiments.trials.excitation_run import ExcitedRig, RealisationRun, Signal

TOGETHER = -1  # number of the row for all realisations together
NUMBERS = (
    "margin",  # smallest Re Z + tolerance over all excited frequencies
    "worst_hz",  # frequency of this smallest value
    "residual",  # fraction of the motion's power at frequencies that are not excited
    "coherence",  # smallest coherence of the motion
    "fidelity",  # rms of |Z| − |K/(jω) + B|
    "fidelity_deviation",
    "stiffness_percent",  # effective stiffness relative to the wall's stiffness
    "damping_percent",
    "saturated",  # fraction of ticks with clipped effort
    "ended_s",
)


@dataclass(frozen=True, kw_only=True)  # without slots: `tasks` is cached
class FrequencyPlan:
    """A plan of a map of passive walls, found by measured impedances.

    Attributes
    ----------
    experiment
        Rig and excitation; the map varies its controller and its wall's stiffness and damping.
    schemes
        Sampling schemes, one map each.
    stiffnesses, dampings
        Values of the grid, ascending (N·m/rad or N/m, N·m·s/rad or N·s/m).
    judging
        Band and thresholds of the verdict.
    signal
        Measured position: encoder counts ("count"), or the true position of the simulated handle ("truth").
    """

    experiment: Experiment
    schemes: tuple[Scheme, ...]
    stiffnesses: tuple[float, ...]
    dampings: tuple[float, ...]
    judging: Judging = Judging()  # noqa: RUF009  (frozen)
    signal: Signal = "count"

    unit: ClassVar[str] = "runs"

    def __post_init__(self) -> None:
        """Raise `PlanError` if schemes, stiffnesses or dampings are empty, repeated, negative or not ascending."""
        check_values("schemes", [scheme.text for scheme in self.schemes], "scheme")
        check_values("stiffnesses", self.stiffnesses, "stiffness", rising=True)
        check_values("dampings", self.dampings, "damping", rising=True)

    @property
    def realisations(self) -> int:
        """Return the number of realisations of the excitation (draws of its phases) for each wall."""
        return self.experiment.excitation.realisations

    @property
    def band_hz(self) -> tuple[float, float]:
        """Return the lowest and the highest frequency at which the impedance is judged (Hz)."""
        excitation = self.experiment.excitation
        return self.judging.band_hz or (excitation.low_hz, excitation.high_hz)

    def columns(self) -> list[tuple[int, float]]:
        """Return index of the sampling scheme and damping (N·m·s/rad or N·s/m) of each column of the grid of walls."""
        return [(number, damping) for number in range(len(self.schemes)) for damping in self.dampings]

    @cached_property
    def tasks(self) -> list[sweep.Task]:
        """Return the function call that measures the walls of each column of the grid (one scheme, one damping).

        Raise `PlanError` if the excitation exceeds a limit of the rig at the softest wall of a scheme.
        """
        applied = [scheme.applied(config.excited(self.experiment)) for scheme in self.schemes]
        refuse_excitations([_set_wall(one, self.stiffnesses[0], self.dampings[0]) for one in applied])
        return [
            sweep.Task(
                f"{number}/{damping!r}",
                run_column,
                {
                    "experiment": config.as_mapping(_set_wall(applied[number], 0.0, damping)),
                    "stiffnesses": list(self.stiffnesses),
                    "judging": asdict(self.judging),
                    "signal": self.signal,
                },
                weight=float(self.schemes[number].position_rate),
            )
            for number, damping in self.columns()
        ]

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan of the map of walls as JSON values by name, from which `from_mapping` restores the plan."""
        own = {"judging": asdict(self.judging), "schemes": [scheme.text for scheme in self.schemes]}
        named = {name: getattr(self, name) for name in ("stiffnesses", "dampings", "signal")}
        return {**plain(named), **own, "experiment": config.as_mapping(self.experiment)}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> FrequencyPlan:
        """Return the plan of a map of walls from JSON values; `where` names their source in error messages."""
        return cls(
            experiment=config.experiment_from_mapping(mapping["experiment"], where),
            schemes=tuple(Scheme.parse(text) for text in mapping["schemes"]),
            stiffnesses=tuple(mapping["stiffnesses"]),
            dampings=tuple(mapping["dampings"]),
            judging=_restore_judging(mapping["judging"]),
            signal=mapping["signal"],
        )

    def found(self, results: Sequence[Any]) -> FrequencyMap:
        """Return the map of passive walls, computed from the measured columns in the order of `tasks`."""
        return FrequencyMap.of(self, results)


def run_column(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Excite a simulated rig at all stiffnesses of one sampling scheme and damping; return a row for each result.

    Each wall has a row for each realisation (draw of the phases), and one for all together; all are JSON values.
    """
    experiment = config.restore_experiment(payload["experiment"])
    judging = _restore_judging(payload["judging"])
    bench = ExcitedRig(experiment, signal=payload["signal"])
    rows: list[dict[str, Any]] = []
    for stiffness in payload["stiffnesses"]:
        walled = _set_wall(bench.experiment, stiffness, experiment.wall.damping)
        rows += wall_rows(bench, walled, judging, payload["signal"])
    return rows


def wall_rows(
    bench: ExcitedRig, walled: Experiment, judging: Judging, signal: Signal
) -> Iterator[dict[str, Any]]:
    """Excite one wall; yield the results of each realisation (random phases), and last of all realisations together."""
    wall = walled.wall
    runs: list[RealisationRun] = []
    for realisation in range(walled.excitation.realisations):
        runs.append(bench.excite(wall.stiffness, wall.damping, realisation))
        # First each realisation alone, with the variance between its periods (which misses effects of friction that are
        # equal in all periods): the spread over realisations is the uncertainty of a single measurement.
        yield _row(conclude(walled, runs[-1:], signal=signal, judging=judging), realisation, 1)
    yield _row(conclude(walled, runs, signal=signal, judging=judging), TOGETHER, 0)


def _row(result: ImpedanceResult, realisation: int, runs: int) -> dict[str, Any]:
    judgement, fidelity = result.judgement, result.fidelity
    row: dict[str, Any] = {
        "stiffness": result.wall[0],
        "realisation": realisation,
        "runs": runs,
        "passive": judgement is not None and judgement.passive,
        "reason": result.ended or ("" if judgement is None else "; ".join(judgement.reasons)),
    }
    numbers: dict[str, float] = dict.fromkeys(NUMBERS, math.nan) | {"saturated": result.saturated}
    if judgement is None or fidelity is None:
        numbers["ended_s"] = result.ended_s or 0.0
    else:
        numbers |= {
            "margin": judgement.passivity.margin,
            "worst_hz": judgement.passivity.worst_hz,
            "residual": judgement.residual,
            "coherence": judgement.least_coherence,
            "fidelity": fidelity.rms,
            "fidelity_deviation": fidelity.rms_deviation,
            "stiffness_percent": fidelity.stiffness_percent,
            "damping_percent": fidelity.damping_percent,
        }
    return row | {name: value if math.isfinite(value) else None for name, value in numbers.items()}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FrequencyMap(Shown, Drawn):
    """A finished map of passive walls.

    Attributes
    ----------
    plan
        Plan of the map.
    columns
        Rows of `run_column`, in the order of `FrequencyPlan.columns`.
    passive
        True for passive walls, ``passive[scheme, realisation, damping, stiffness]``; a realisation is a draw of the
        random phases, its last index means all together.
    fidelity
        Rms fidelity error (N·m·s/rad or N·s/m) with the same axes; NaN if the safety guard ended the run.
    """

    table_name: ClassVar[str] = "walls.parquet"

    plan: FrequencyPlan
    columns: Sequence[list[dict[str, Any]]]
    passive: NDArray[np.bool_]
    fidelity: Floats

    @classmethod
    def of(cls, plan: FrequencyPlan, columns: Sequence[list[dict[str, Any]]]) -> FrequencyMap:
        """Return the map of passive walls from the measured columns of its grid."""
        each = plan.realisations + 1
        shape = (len(plan.schemes), len(plan.dampings), len(plan.stiffnesses), each)

        def arranged(name: str, dtype: Any) -> Any:
            values = [row[name] for rows in columns for row in rows]
            array = np.array([math.nan if value is None else value for value in values], dtype=dtype)
            return np.ascontiguousarray(np.moveaxis(array.reshape(shape), 3, 1))

        return cls(plan, columns, arranged("passive", np.bool_), arranged("fidelity", np.float64))

    def brief(self) -> list[Item]:
        """Return the lines of a short report: number of passive walls for each sampling scheme."""
        plan, (low, high) = self.plan, self.plan.band_hz
        walls = len(plan.dampings) * len(plan.stiffnesses)
        rows = [
            Row(scheme.label(plan.experiment), f"{int(passive.sum())} of {walls} walls passive")
            for scheme, passive in zip(plan.schemes, self.passive[:, -1], strict=True)
        ]
        return [f"impedances of {plan.experiment.rig.name}, from {low:g} to {high:g} Hz", *rows]

    def table(self) -> Iterator[dict[str, Any]]:
        """Yield a row for each wall and realisation (draw of the phases); realisation None: all together."""
        for (number, damping), rows in zip(self.plan.columns(), self.columns, strict=True):
            for row in rows:
                of_row = {key: value for key, value in row.items() if key != "runs"}
                if row["realisation"] == TOGETHER:
                    of_row["realisation"] = None
                yield {"scheme": self.plan.schemes[number].text, "damping": damping} | of_row

    def units(self) -> dict[str, str]:
        """Return the unit of each column of the table by name, without the columns that have no unit."""
        motion = self.plan.experiment.rig.motion
        damping = unit_of("damping", motion)
        return {
            "damping": damping,
            "stiffness": unit_of("stiffness", motion),
            "worst_hz": "Hz",
            "ended_s": "s",
            "stiffness_percent": "%",
            "damping_percent": "%",
            **dict.fromkeys(("margin", "fidelity", "fidelity_deviation"), damping),
        }

    def as_mapping(self) -> dict[str, Any]:
        """Return plan and verdicts as JSON values by name, without single results and without the paper's Table I."""
        plan, experiment = self.plan, self.plan.experiment
        mapping = config.as_mapping(experiment)
        return {
            "domain": "frequency",
            "rig": experiment.rig.name,
            "motion": experiment.rig.motion,
            "stiffnesses": list(plan.stiffnesses),
            "dampings": list(plan.dampings),
            "judging": {**asdict(plan.judging), "band_hz": list(plan.band_hz)},
            "excitation": {**mapping["excitation"], **config.excitation_size(experiment)},
            "signal": plan.signal,
            "passive": self.passive[:, -1].tolist(),
            "experiment": mapping,
        }


def _set_wall(experiment: Experiment, stiffness: float, damping: float) -> Experiment:
    return replace(experiment, wall=replace(experiment.wall, stiffness=stiffness, damping=damping))


def _restore_judging(mapping: Mapping[str, Any]) -> Judging:
    band = mapping["band_hz"]
    return Judging(**{**mapping, "band_hz": None if band is None else tuple(band)})
