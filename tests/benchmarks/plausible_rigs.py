"""Check that a hit does what its plan promises, on random rigs that a lab might build, in simulation.

    python -m tests.benchmarks.plausible_rigs              # 400 rigs and the table; some minutes
    python -m tests.benchmarks.plausible_rigs --rigs 50 --first 1000

Each rig is described as a user describes a first own one: a file over a preset, with the keys of two data sheets, and
two thirds of them with a name of their own, the others as changes of the preset. The ranges, all drawn independently
(log-uniform unless stated):

* motion: four of five rotary, over `koul-rigid`; one of five linear, over `chawda-linear` (ratio 1);
* peak of the motor at its shaft: 0.005 to 0.2 N·m with 1 to 10 A; linear 2 to 100 N; nominal effort half of the peak;
* ratio of the transmission: 1 to 20;
* inertia: peak effort over an acceleration of 200 to 5000 rad/s²; linear over 10 to 200 m/s²; half of it the motor's;
* Coulomb friction: 0.3 to 8 % of the peak effort; viscous damping: inertia over 0.1 to 10 s;
* encoder: 100, 360, 500, 1000, 2048, 4096 lines, four edges each, on the motor; linear 0.5, 1, 5, 20 µm;
* amplifier: current drive, lag 20 µs to 1 ms, quantum 0.2, 1 or 5 mA and at least a 30 000th of the peak, as 16 bits
  hold it, sensor noise 0 to 1 % of the peak (uniform);
* delay of the set-point: 0, 20, 30, 100, 250 µs or 1 ms;
* rate: uniform 1, 2, 4, 10 or 20 kHz, the estimator's cut-off a tenth of it, at most 200 Hz;
* push: 3 to 30 % of the peak; wall: the push rests 2.5 to 50 counts deep in it, damping ratio 0 to 0.7 (uniform).

All else is the preset's, but in changes of a preset `homing.effort` is at most half of the peak, as its rule asks.

**Reached** is a wall that the handle touches in the trial proper; what its verdict says of
the wall afterwards is no matter of this comparison. Where the plan refuses, the changes that its checks name are made,
and it is planned again, at most three times in all.

The rule was written before the results: where the plan says ok, at least 99 of 100 reach the wall; where it refuses, at
least 95 of 100 reach it after the named changes. Seeds 7000 to 7399: 271 of 271, and 129 of 129.
"""

import argparse
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment, presets
from rig.config import _load as load
from rig.core.check import Check, refused
from rig.core.errors import ConfigError, RigError
from rig.core.sample import Phase
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit, left_by
from rig.experiments.trials.plan import make_plan

PLANS = 3


@dataclass(frozen=True)
class Outcome:
    """The result of one rig: the checks that refused at first, and how the hit ended."""

    refused: tuple[str, ...]
    unnamed: bool  # a check refused and named no change
    reached: bool
    message: str  # of what ended the hit early, or still refused it


def draw_rig(seed: int) -> tuple[str, dict[str, Any]]:
    """Draw a random rig; return its preset and the keys that change it."""
    random = np.random.default_rng(seed)

    def log(low: float, high: float) -> float:
        return float(math.exp(random.uniform(math.log(low), math.log(high))))

    def one(*values: Any) -> Any:
        return values[int(random.integers(len(values)))]

    linear = random.random() < 0.2
    ratio = 1.0 if linear else log(1.0, 20.0)
    peak_a = log(1.0, 10.0)
    peak = log(2.0, 100.0) if linear else log(0.005, 0.2) * ratio
    inertia = peak / (log(10.0, 200.0) if linear else log(200.0, 5000.0))
    rate = one(1_000, 2_000, 4_000, 10_000, 20_000)
    push = peak * log(0.03, 0.3)
    lines = one(100, 360, 500, 1_000, 2_048, 4_096)
    quantum = one(0.5e-6, 1e-6, 5e-6, 20e-6)
    resolution = quantum if linear else 2.0 * math.pi / (4.0 * lines * ratio)
    stiffness = push / (resolution * log(2.5, 50.0))
    rotary = {"rig.encoder.counts_per_revolution": lines, "rig.encoder.ratio": ratio}
    encoder = {"rig.encoder.quantum": quantum} if linear else rotary
    keys = {
        "rig.mechanics.motor_inertia": 0.5 * inertia,
        "rig.mechanics.link_inertia": 0.5 * inertia,
        "rig.mechanics.end_mass": 0.0,
        "rig.mechanics.motor_coulomb": peak * log(0.003, 0.08),
        "rig.mechanics.motor_damping": inertia / log(0.1, 10.0),
        "rig.mechanics.link_damping": 0.0,
        "rig.amplifier.effort_per_ampere": peak / peak_a,
        "rig.amplifier.effort_limit": peak,
        "rig.amplifier.lag_s": log(2e-5, 1e-3),
        "rig.amplifier.current_quantum_a": max(one(2e-4, 1e-3, 5e-3), peak_a / 30_000.0),
        "rig.amplifier.current_noise_a": float(random.uniform(0.0, 0.01)) * peak_a,
        "rig.amplifier.set_point_delay_s": one(0.0, 2e-5, 3e-5, 1e-4, 2.5e-4, 1e-3),
        "rig.limits.nominal_effort": 0.5 * peak,
        "rig.limits.effort": peak,
        "controller.position_rate": rate,
        "controller.velocity_rate": rate,
        "controller.parameters.cutoff_hz": min(0.1 * rate, 200.0),
        "trial.effort": push,
        "wall.stiffness": stiffness,
        "wall.damping": 2.0 * float(random.uniform(0.0, 0.7)) * math.sqrt(stiffness * inertia),
        **encoder,
    }
    if random.random() < 2.0 / 3.0:
        keys["rig.name"] = f"own-{seed}"
    else:
        keys["homing.effort"] = min(10.0 if linear else 0.15, 0.5 * peak)
    return "chawda-linear" if linear else "koul-rigid", keys


def experiment_of(seed: int) -> Experiment:
    """Return the experiment as its user loads it: a file of its own, or a preset with changes."""
    preset, keys = draw_rig(seed)
    if "rig.name" in keys:
        return load.experiment_from_mapping({"preset": preset, **load.nest(keys)}, f"rig {seed}")
    return config.override(presets.load(preset), keys)


def named_changes(checks: tuple[Check, ...]) -> dict[str, Any]:
    return {key: value for check in checks for key, value in check.changes.items()}


def reaches(experiment: Experiment, seed: int) -> tuple[bool, str]:
    """Hit the wall in virtual time over the byte link; return whether it was touched, and an early end's message."""
    seeded = config.override(experiment, {"trial.seed": seed})
    with TemporaryDirectory() as directory:
        message = ""
        try:
            (result,) = hit(HitRequest(experiment=seeded, output=Path(directory)), admit)
            recorded = result.recorded
        except RigError as error:
            message = error.message
            if (found := left_by(error)) is None:
                return False, message
            recorded = found
        rows = recorded.recording.rows
        proper = rows[rows["phase"] == Phase.TRIAL]
        depth = seeded.wall.side * (proper["position"] - seeded.wall.position)
        return bool((depth > 0.0).any()), message


def outcome(seed: int) -> Outcome:
    try:
        experiment = experiment_of(seed)
    except ConfigError as error:
        return Outcome(("rules",), True, False, error.message)
    first: tuple[str, ...] = ()
    for number in range(PLANS + 1):
        found = refused(make_plan(experiment).checks)
        first = first or tuple(check.name for check in found)
        if not found:
            reached, message = reaches(experiment, seed)
            return Outcome(first, False, reached, message)
        changes = named_changes(found)
        if not changes or number == PLANS:
            text = "; ".join(f"{check.name}: {check.text}" for check in found)
            return Outcome(first, not changes, False, text)
        try:
            experiment = config.override(experiment, changes)
        except ConfigError as error:
            return Outcome(first, False, False, error.message)
    raise AssertionError("the last plan returns")


def table(outcomes: Mapping[int, Outcome]) -> str:
    """Return the table of rigs that reached the wall: planned ok, refused in all, and by the check that refused."""
    lines = ["| plan | rigs | reached the wall |", "|---|---|---|"]
    groups = {
        "ok": [each for each in outcomes.values() if not each.refused],
        "refused, then changed": [each for each in outcomes.values() if each.refused],
    }
    for name, _ in Counter(name for each in outcomes.values() for name in each.refused).most_common():
        groups[f"refused for {name}"] = [each for each in outcomes.values() if name in each.refused]
    for name, members in groups.items():
        lines.append(f"| {name} | {len(members)} | {sum(each.reached for each in members)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table, and each rig that did not reach its wall."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rigs", type=int, default=400)
    parser.add_argument("--first", type=int, default=0, help="seed of the first rig")
    options = parser.parse_args()
    outcomes = {}
    for seed in range(options.first, options.first + options.rigs):
        outcomes[seed] = found = outcome(seed)
        if not found.reached:
            refused_first = ", ".join(found.refused) or "ok"
            print(f"rig {seed}: planned {refused_first}; {found.message or 'not touched'}", flush=True)
    print(table(outcomes))


if __name__ == "__main__":
    main()
