"""Reproduce Chawda, Celik and O'Malley's comparison of velocity estimators: its figures, Table I, and every claim.

About ten thousand walls are excited and some thousand more are hit, in one sweep. Rules compute verdicts from the
numbers, and templates write the sentences. The paper does not give band and tolerance of its passivity test, and the
results depend on both: each wall is judged by many passivity tests (`rig.extras.papers.chawda.readings`), and a claim
is judged by the number of tests in which it holds. No value is tuned to match Table I.

Source: Chawda et al., "Evaluation of Velocity Estimation Methods Based on their Effect on Haptic Device Performance".
"""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.control.estimators import levant_regions
from rig.experiments.estimation.interface import AFTER_CONTACT_S, BEFORE_CONTACT_S
from rig.experiments.mapping.impedance import measure_impedance
from rig.experiments.mapping.interface import MapPlan, StiffnessSearch, ZWidth, search_for
from rig.experiments.trials import excitation_run
from rig.extras.papers.chawda import derived, rigs, rules
from rig.extras.papers.chawda import parts as chawda_parts
from rig.extras.papers.chawda.claims import rulings
from rig.extras.papers.chawda.pictures import PICTURES
from rig.extras.papers.chawda.readings import ExcitationGrid, Readings
from rig.extras.papers.chawda.results import Chawda, numbers, provenance, read_all
from rig.extras.papers.koul import parts as koul_parts
from rig.extras.papers.parts import Part, Parts, part
from rig.extras.papers.reproduction import Paper
from rig.extras.papers.rules import MOST

# Walls at which C is identified, the nominal one first.
WALLS = ((20_000.0, 60.0), (50_000.0, 60.0), (100_000.0, 100.0))
SHOWN_WALL = (20_000.0, 60.0)  # of figures 4 and 6: inside the main reading's region of three estimators
CONTROL_SEARCH = StiffnessSearch(way="bisection", lowest=13_000.0, highest=53_000.0, ratio=1.005)


class ChawdaPlan:
    """Tasks that compute everything for the paper of Chawda et al., and the conversion of their results to `Chawda`."""

    def __init__(self, scale: rigs.ChawdaScale) -> None:
        self._scale = scale
        # Computed here, not in the sweep, because the schemes of the hits need its C.
        self._nominal = chawda_parts.identify_wall(*WALLS[0])
        self._named_hits = self._hit_schemes()
        self._hits = self._hit_plan(rigs.FIGURE_3_RATE, tuple(self._named_hits.values()), scale.hit_ratio)
        self._slow_hits = self._hit_plan(1000, tuple(rigs.SCHEMES.values()), scale.hit_ratio**0.5)
        self._variants = {
            f"C = {c:g} m/s², {form}, {out}": rigs.levant(1000, c, rigs.GAINS[rigs.HBA_SC], form, out)
            for c, form, out in product(rigs.VARIANT_CONSTANTS, rigs.VARIANT_FORMS, rigs.VARIANT_OUTPUTS)
        }
        self._grids = self._all_grids()

    def parts(self) -> dict[str, Part]:
        """Return all tasks of the computation, grouped by the name of the result that they compute."""
        parts = {name: grid.part(self._weight(name)) for name, grid in self._grids.items()}
        parts["hits"] = koul_parts.map_part(self._hits)
        parts["slow-hits"] = koul_parts.map_part(self._slow_hits)
        for stiffness, damping in WALLS[1:]:
            payload: dict[str, Any] = {"stiffness": stiffness, "damping": damping}
            parts[f"constant/{stiffness:g}"] = part(chawda_parts.constant, payload, 300.0)
        rig = config.excited(rigs.excited_rig(self._scale))
        for name in (rigs.FDM, rigs.AKF):
            payload = {
                "experiment": config.as_mapping(rig),
                "scheme": rigs.SCHEMES[name].text,
                "dampings": self._linear_dampings(),
                "low_hz": rigs.LOWEST_HZ[0],
                "highest_hz": list(rigs.HIGHEST_HZ),
            }
            parts[f"linear/{name}"] = part(chawda_parts.linear, payload, 500.0)
        # The printed process noise allows no fine encoder; without damping any filter does.
        for name, scheme in {**rigs.SCHEMES, rigs.AKF: Scheme.parse("uniform:1k,estimator=kalman")}.items():
            payload = chawda_parts.control_payload(rig, scheme, CONTROL_SEARCH, rigs.CONTROL_BAND)
            parts[f"control/{name}"] = part(chawda_parts.control, payload, 20.0)
        return parts

    def results(self, done: Parts) -> Chawda:
        """Convert the results of all tasks of the computation to one typed object."""
        found = {name: Readings.of(grid, done.results[name]) for name, grid in self._grids.items()}
        hits = ZWidth.of(self._hits, done.results["hits"])
        return Chawda(
            scale=self._scale,
            lipschitz=self._nominal["lipschitz"],
            constants=(self._nominal, *(done.one(f"constant/{stiffness:g}") for stiffness, _ in WALLS[1:])),
            hits=hits,
            hit_names=tuple(self._named_hits),
            adjusted=_choose_gains(hits, tuple(self._named_hits)),
            slow_hits=ZWidth.of(self._slow_hits, done.results["slow-hits"]),
            map=found["map"],
            read=read_all(found["map"]),
            frictionless=found["frictionless"],
            variants=found["variants"],
            combined=found["combined"],
            variant_names=tuple(self._variants),
            linear={name: done.one(f"linear/{name}") for name in (rigs.FDM, rigs.AKF)},
            linear_dampings=tuple(self._linear_dampings()),
            controls={name: done.one(f"control/{name}") for name in rigs.SCHEMES},
            impedances=_impedances(self._scale),
            dual={preset: found[f"dual/{preset}"] for preset in rigs.KOUL},
            dual_schemes=rigs.dual_schemes(),
        )

    def _hit_schemes(self) -> dict[str, Scheme]:
        """Return the schemes of Fig. 3 by name: filtered difference, then Levant's estimator with each constant C."""
        named = {rigs.FILTERED: rigs.FILTERED_SCHEME}
        named |= {
            name: rigs.levant(rigs.FIGURE_3_RATE, self._nominal["lipschitz"], gains)
            for name, gains in rigs.GAINS.items()
        }
        for (name, gains), constant in product(rigs.GAINS.items(), self._scale.constants):
            named[f"{name}, C = {constant:g} m/s²"] = rigs.levant(rigs.FIGURE_3_RATE, constant, gains)
        return named

    def _hit_plan(self, rate: int, schemes: tuple[Scheme, ...], ratio: float) -> MapPlan:
        experiment = rigs.pushed_rig(rate)
        return MapPlan(
            experiment=experiment,
            schemes=schemes,
            dampings=self._scale.hit_dampings,
            search=search_for(experiment, "ladder", ratio=ratio, lowest=rigs.LOWEST_STIFFNESS),
            offsets=self._scale.offsets,
            judged="true",
        )

    def _all_grids(self) -> dict[str, ExcitationGrid]:
        scale, main = self._scale, (rigs.READINGS[rigs.MAIN],)
        soft = tuple(b for b in scale.dampings if b <= 200.0)
        grids = {
            "map": ExcitationGrid(
                experiment=rigs.excited_rig(scale),
                schemes=tuple(rigs.SCHEMES.values()),
                stiffnesses=scale.stiffnesses,
                dampings=scale.dampings,
                readings=rigs.READINGS,
                measurements=scale.measurements,
            ),
            "frictionless": ExcitationGrid(
                experiment=rigs.excited_rig(replace(scale, measurements=2), rigs.FRICTIONLESS),
                schemes=(rigs.SCHEMES[rigs.FDM], rigs.SCHEMES[rigs.FOAW]),
                stiffnesses=scale.stiffnesses,
                dampings=soft,
                readings=rigs.READINGS,
                measurements=2,
            ),
            "variants": ExcitationGrid(
                experiment=rigs.excited_rig(replace(scale, measurements=1)),
                schemes=tuple(self._variants.values()),
                stiffnesses=scale.stiffnesses[:: scale.coarse],
                dampings=rigs.VARIANT_DAMPINGS,
                readings=main,
                measurements=1,
            ),
        }
        grids["combined"] = replace(
            grids["variants"],
            schemes=(rigs.SCHEMES[rigs.FOAW], rigs.SCHEMES[rigs.LEVANT], rigs.COMBINED_SCHEME),
        )
        for preset in rigs.KOUL:
            rig = rigs.dual_rig(preset, scale)
            grids[f"dual/{preset}"] = ExcitationGrid(
                experiment=rig,
                schemes=rigs.dual_schemes(),
                stiffnesses=scale.dual_stiffnesses,
                dampings=scale.dual_dampings,
                readings=rigs.DUAL_READINGS,
                measurements=scale.dual_measurements,
                signal="count" if rig.rig.mechanics.structure == "rigid" else "truth",
            )
        return grids

    def _weight(self, name: str) -> float:
        return 2.0 if name.startswith("dual") else 2.2

    def _linear_dampings(self) -> list[float]:
        return [float(b) for b in np.linspace(0.0, 400.0, self._scale.theory_points)]


def _choose_gains(hits: ZWidth, names: tuple[str, ...]) -> str:
    tried = [number for number, name in enumerate(names) if name != rigs.FILTERED]
    return names[max(tried, key=lambda number: hits.width(number, "felt").area)]


def _impedances(scale: rigs.ChawdaScale) -> tuple[Any, ...]:
    rig = rigs.excited_rig(replace(scale, measurements=1))
    (bare,) = measure_impedance(rig, walls=[(0.0, 0.0)], schemes=[rigs.SCHEMES[rigs.FDM]])
    return (bare, *measure_impedance(rig, walls=[SHOWN_WALL], schemes=tuple(rigs.SCHEMES.values())))


def words(chawda: Chawda) -> dict[str, Any]:
    """Return the values that the templates of the report use, by name."""
    return {
        "chawda": chawda,
        "rigs": rigs,
        "rules": rules,
        "of": derived,
        "most_share": MOST,
        "acquisition_hz": excitation_run.ACQUISITION_HZ,
        "levant": levant_regions,
        "around_contact_s": (BEFORE_CONTACT_S, AFTER_CONTACT_S),
        "nominal_wall": WALLS[0],
        "verdict": presets.load(rigs.RIG).verdict,
    }


CHAWDA = Paper(
    name="chawda",
    quick=rigs.QUICK,
    full=rigs.FULL,
    plan=ChawdaPlan,
    rulings=rulings,
    words=words,
    numbers=numbers,
    provenance=provenance,
    pictures=PICTURES,
)
