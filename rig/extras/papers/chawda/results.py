"""Types of the results of the reproduction of Chawda et al., and their conversion to values for JSON.

`claims`, `derived`, `pictures` and the templates of the report read them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.present import plain
from rig.experiments.mapping.impedance import ImpedanceResult
from rig.experiments.mapping.interface import FrequencyWidth, GridSearch, Spread, ZWidth, trace_grid
from rig.extras.papers.chawda import rigs
from rig.extras.papers.chawda.readings import Readings
from rig.realtime.source_files import code_version


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundarySearch:
    """The paper's search along the boundary of the passive region, applied to one map of one estimator.

    `found` is the stiffest wall that the search finds (N/m; None: no wall), `width` the stiffest passive wall of the
    whole grid (N/m), `wrong` the number of dampings at which the search does not end at the edge of the passive region.
    """

    name: str
    measurement: int
    search: GridSearch
    found: float | None
    width: float
    wrong: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Chawda:
    """All computed results, from which claims, sentences and pictures are derived.

    An *estimator* is one of the four of Table I; a *reading* is a passivity test with one band and one tolerance.

    Attributes
    ----------
    lipschitz
        C of Levant's differentiator identified at the nominal wall (m/s²), used for the gains of Fig. 3.
    constants
        C identified at several walls, see `rig.extras.papers.chawda.parts.identify_wall`.
    hits
        Fig. 3: stiffness limits by hits at 10 kHz; `hit_names` are the names of the sampling schemes.
    adjusted
        The name in `hit_names` of Levant's differentiator with the best gains.
    slow_hits
        Stiffness limits by hits at 1 kHz, for the four estimators in the order of `SCHEMES`.
    read
        Largest passive stiffness and damping, and errors, by estimator: for every reading of measurement 1, then of
        measurement 2, and so on.
    map, frictionless
        Figs. 5 and 7 and Table I: measured walls judged by every reading; and the same walls on a rig without friction,
        with FDM+filter and FOAW.
    variants, variant_names
        Levant's differentiator with other discretisations, outputs and C, on a coarser grid.
    linear
        Limits of linear theory at `linear_dampings` (N·s/m), for each linear estimator.
    controls
        Values on a rig without friction and quantisation, which theory predicts, by estimator.
    impedances
        Figs. 4 and 6: impedance of the rig without a wall, then of one wall with each of `SCHEMES`.
    dual
        Measured walls on Koul's rigs by preset, with the sampling schemes `dual_schemes`.
    """

    scale: rigs.ChawdaScale
    lipschitz: float
    constants: tuple[Mapping[str, float], ...]
    hits: ZWidth
    hit_names: tuple[str, ...]
    adjusted: str
    slow_hits: ZWidth
    map: Readings
    read: Sequence[Mapping[str, FrequencyWidth]]
    frictionless: Readings
    variants: Readings
    variant_names: tuple[str, ...]
    combined: Readings  # with FOAW, with Levant's differentiator, and with both
    linear: Mapping[str, Mapping[str, Any]]
    linear_dampings: tuple[float, ...]
    controls: Mapping[str, Mapping[str, float]]
    impedances: tuple[ImpedanceResult, ...]
    dual: Mapping[str, Readings]
    dual_schemes: tuple[Scheme, ...]

    def widths(self, name: str, reading: int = rigs.MAIN) -> list[FrequencyWidth]:
        """Return the largest passive stiffness and damping, and errors, of one estimator for each measurement.

        `reading` is an index into `rigs.READINGS`, the passivity tests.
        """
        return [of[name] for of in self.read[reading :: len(rigs.READINGS)]]

    def search(self, name: str, measurement: int = 0) -> GridSearch:
        """Apply the paper's boundary search to the passivity map of one estimator and measurement."""
        grid = self.map.grid
        passive = self.map.passive[measurement, rigs.MAIN, list(rigs.SCHEMES).index(name)]
        return trace_grid(passive, grid.dampings, grid.stiffnesses)

    @property
    def figure_3(self) -> list[str]:
        """Return the names of the sampling schemes that Fig. 3 shows."""
        return list(dict.fromkeys((rigs.FILTERED, rigs.HBA_SC, rigs.LFBA, self.adjusted)))

    def searches(self) -> list[BoundarySearch]:
        """Return the boundaries that the paper's search finds in the passivity maps, by estimator and measurement."""
        stiffnesses = self.map.grid.stiffnesses
        return [
            BoundarySearch(
                name=name,
                measurement=measurement + 1,
                search=(search := self.search(name, measurement)),
                found=stiffnesses[search.highest] if search.highest >= 0 else None,
                width=width.stiffness,
                wrong=search.above + search.below + search.unseen,
            )
            for name in rigs.SCHEMES
            for measurement, width in enumerate(self.widths(name))
        ]

    def islands(self, name: str) -> list[int]:
        """Return, per measurement, the number of islands of an estimator: passive walls above a wall that is not."""
        return [len(width.islands) for width in self.widths(name)]

    @property
    def runs(self) -> int:
        """Return the total number of excitations of a rig in the whole reproduction."""
        grids = (self.map, self.frictionless, self.variants, *self.dual.values())
        return sum(found.grid.runs for found in grids)


def read_all(found: Readings) -> tuple[dict[str, FrequencyWidth], ...]:
    """Return the largest passive stiffness and damping by estimator, for every passivity test of each measurement."""
    grid = found.grid
    return tuple(
        {name: found.width(m, r, s) for s, name in enumerate(rigs.SCHEMES)}
        for m in range(grid.measurements)
        for r in range(len(grid.readings))
    )


def spread(widths: Sequence[FrequencyWidth], name: str) -> Spread:
    """Return mean and standard deviation over the measurements of one field of `widths`, such as "stiffness"."""
    return Spread.of([getattr(width, name) for width in widths])


def numbers(chawda: Chawda) -> dict[str, Any]:
    """Return every computed number of the reproduction by name, for the JSON file."""
    return {
        "identified": list(chawda.constants),
        "lipschitz": chawda.lipschitz,
        "hits_10_kHz": {
            "names": list(chawda.hit_names),
            "adjusted": chawda.adjusted,
            **chawda.hits.as_mapping(),
        },
        "hits_1_kHz": {"names": list(rigs.SCHEMES), **chawda.slow_hits.as_mapping()},
        "map": _grid(chawda.map, list(rigs.SCHEMES)),
        "searches": {
            name: [plain(chawda.search(name, m)) for m in range(chawda.map.grid.measurements)]
            for name in rigs.SCHEMES
        },
        "readings": {
            rigs.READINGS[number].text: {
                name: [_width(width) for width in chawda.widths(name, number)] for name in rigs.SCHEMES
            }
            for number in range(len(rigs.READINGS))
        },
        "frictionless": _grid(chawda.frictionless, [s.text for s in chawda.frictionless.grid.schemes]),
        "variants": _grid(chawda.variants, chawda.variant_names),
        "combined": _grid(chawda.combined, [rigs.FOAW, rigs.LEVANT, rigs.COMBINED]),
        "linear": {"dampings": list(chawda.linear_dampings), **chawda.linear},
        "controls": chawda.controls,
        "impedances": [_impedance(result) for result in chawda.impedances],
        "dual": {
            preset: {
                reading.text: _areas(found, number) for number, reading in enumerate(found.grid.readings)
            }
            for preset, found in chawda.dual.items()
        },
    }


def _grid(found: Readings, names: Sequence[str]) -> dict[str, Any]:
    reading = _main(found)
    return {
        "stiffnesses": list(found.grid.stiffnesses),
        "dampings": list(found.grid.dampings),
        "reading": found.grid.readings[reading].text,
        "schemes": {
            name: {
                "widths": [plain(width) for width in found.widths(reading, number)],
                "passive": [
                    [
                        "".join("1" if cell else "0" for cell in row)
                        for row in found.passive[m, reading, number]
                    ]
                    for m in range(found.grid.measurements)
                ],
                "fidelity": plain(np.round(_mean(found.fidelity[:, reading, number]), 4)),
            }
            for number, name in enumerate(names)
        },
    }


def _mean(values: Any) -> Any:
    return np.mean(values, axis=0)


def _main(found: Readings) -> int:
    return found.grid.readings.index(rigs.READINGS[rigs.MAIN])


def _width(width: FrequencyWidth) -> list[float | None]:
    values = (width.stiffness, width.damping, width.worst_fidelity)
    return [value if np.isfinite(value) else None for value in values]


def _areas(found: Readings, reading: int) -> dict[str, Any]:
    return {
        scheme.text: {
            "area": plain(found.areas(reading, number)),
            "widths": [_width(width) for width in found.widths(reading, number)],
        }
        for number, scheme in enumerate(found.grid.schemes)
    }


def _impedance(result: ImpedanceResult) -> dict[str, Any]:
    return {key: value for key, value in plain(result).items() if key != "impedance"}


def provenance(chawda: Chawda) -> dict[str, Any]:
    """Return where the numbers come from: code version, grid sizes, seed, settings; the same on every machine."""
    experiment = rigs.excited_rig(chawda.scale)
    return {
        "haptic-rig": code_version(),
        "scale": asdict(chawda.scale),
        "seed": rigs.SEED,
        "runs": chawda.runs,
        "hits": chawda.hits.hits + chawda.slow_hits.hits,
        "schemes": {name: scheme.text for name, scheme in rigs.SCHEMES.items()},
        "readings": [reading.text for reading in rigs.READINGS],
        "excitation": asdict(experiment.excitation),
        "push": dict(rigs.PUSH),
        "presets": {name: config.as_mapping(presets.load(name)) for name in (rigs.RIG, *rigs.KOUL)},
    }
