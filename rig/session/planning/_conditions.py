"""Build the experiments of a protocol: rig and trial, with the changes of each condition.

Settings are applied in this order, later ones replace earlier ones: the preset or the experiment file; the settings for
safety with a person (`SAFE`); ``[study.changes]``; ``[trial]`` and ``[caps]``; sampling scheme and changes of the
condition; damping and stiffness of the wall. A simulated hand keeps the ranges of impact speed and press in
``[trial]``, unless other settings determine how it hits (`rig.session.planning._bands`). Checks and sessions get every
wall from here, so that the presented walls are the checked ones.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rig import config
from rig.config import DEFAULT_PRESET, EXPERIMENT, FREE, Experiment, parameters, presets, shown
from rig.config.checked import Problem, config_error, did_you_mean
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError, RigError
from rig.core.sample import unit_of
from rig.session.planning._bands import BANDS, middle, pressing
from rig.session.planning._protocol import Condition, Protocol
from rig.session.planning._schedule import levels_of

ReachFor = Callable[[Experiment, float], float]

OWNED = {  # keys of the experiment, and the key or section of the protocol that sets each
    "wall.stiffness": "[search]",
    "wall.damping": "damping of each condition",
    "trial.kind": "trial.kind of the protocol",
    "trial.duration_s": "trial.duration_s of the protocol",
    "trial.baseline_s": "trial.baseline_s of the protocol",
    "trial.foreperiod_s": "trial.foreperiod_s of the protocol",
    "trial.hold_s": "trial.hold_s of the protocol",
    "trial.repeats": "order.repeats of the protocol",
    "trial.seed": "study.seed of the protocol",
}


def base_experiment(study: Any, folder: Path) -> Experiment | list[Problem]:
    """Return the preset or experiment that the protocol's section ``[study]`` names, or a list of problems.

    `study` is this section before any check, `folder` the directory of the protocol file.
    """
    study = study if isinstance(study, Mapping) else {}
    preset, file = study.get("preset"), study.get("experiment")
    if (preset is None) == (file is None):
        given, must = "", "is missing, and so is study.experiment: one of the two must name the rig"
        if preset is not None:
            given = shown(preset)
            must = f"must not be given beside study.experiment = {shown(file)}: only one of the two may name the rig"
        choice = f"write preset = {shown(DEFAULT_PRESET)}, or the name of an experiment file"
        return [Problem("study.preset", given, must, choice)]
    if preset is not None:
        if preset not in presets.names():
            choice = did_you_mean(
                str(preset), presets.names(), f"choose one of: {', '.join(presets.names())}"
            )
            return [Problem("study.preset", shown(preset), "is not a preset", choice)]
        return presets.load(preset)
    if not isinstance(file, str):
        return [
            Problem("study.experiment", shown(file), "must be text", "write the name of a file in quotes")
        ]
    try:
        return config.load_experiment(folder / file)
    except ConfigError as error:
        return [
            Problem("study.experiment", shown(file), f"is not an experiment: {error.message}", error.remedy)
        ]


class Walls:
    """The walls of a study as experiments (rig, wall and trial); each experiment is checked once and then cached.

    Parameters
    ----------
    protocol
        Checked protocol.
    base
        Experiment that the protocol names, from `base_of`.
    reach_for
        Function that returns how long (s) a simulated hand must move to the wall, for an experiment and an impact speed
        (`rig.session.planning._simulated_hand`). If None, required impact speeds do not change the simulated hand.
    """

    def __init__(self, protocol: Protocol, base: Experiment, reach_for: ReachFor | None = None) -> None:
        self.protocol = protocol
        self.base = base
        self._known: dict[tuple[str, float, float], Experiment] = {}
        self._reach_for = reach_for
        self._reaches: dict[str, float] = {}  # by condition

    def at(
        self, condition: Condition, damping: float, stiffness: float, *, seed: int | None = None
    ) -> Experiment:
        """Return the experiment with one wall of a condition; raise `ConfigError` if the rig or the trial exclude it.

        `damping` and `stiffness` are B (N·m·s/rad or N·s/m) and K (N·m/rad or N/m) of the wall. `seed` is the seed of
        the trial; by default the study's seed.
        """
        key = (condition.name, damping, stiffness)
        if key not in self._known:
            self._known[key] = self._experiment(condition, damping, stiffness)
        x = self._known[key]
        return x if seed is None else replace(x, trial=replace(x.trial, seed=seed))

    def softest(self, condition: Condition) -> Experiment:
        """Return the experiment with the softest wall of a condition, at the condition's first damping."""
        return self.at(condition, *self._softest(condition))

    def _softest(self, condition: Condition) -> tuple[float, float]:
        return condition.damping[0], levels_of(self.protocol.search_of(condition))[0]

    def _experiment(self, condition: Condition, damping: float, stiffness: float) -> Experiment:
        protocol, name = self.protocol, condition.name
        source = f"condition {shown(name)}"
        experiment = config.override(self.base, _study_changes(protocol), source, check_rules=False)
        if condition.scheme is not None:
            experiment = Scheme.parse(condition.scheme).on(experiment)
            source += f" with scheme {condition.scheme}"
        experiment = config.override(experiment, condition.changes, source, check_rules=False)
        own = {**protocol.study.changes, **condition.changes}

        def at(damping: float, stiffness: float) -> Experiment:
            wall = {"wall.stiffness": stiffness, "wall.damping": damping}
            x = config.override(experiment, wall, source, check_rules=False)
            pressed = {} if "operator.press" in own else pressing(x, protocol.trial)
            return config.override(x, pressed, source, check_rules=False)

        x, speeds, reach = at(damping, stiffness), protocol.trial.impact_speed, {}
        if self._reach_for is not None and speeds and "operator.reach_s" not in own:
            if name not in self._reaches:  # found once for each condition, on its softest wall
                self._reaches[name] = self._reach_for(at(*self._softest(condition)), middle(speeds))
            reach["operator.reach_s"] = self._reaches[name]
        x = config.override(x, reach, source)
        config.check_plugins(x, source)
        return x


def own_rates(condition: Condition, experiment: Experiment) -> dict[str, Any]:
    """Return the sampling rates (Hz, by key) that a condition prescribes for every device; {} if it prescribes none."""
    if condition.scheme is None:
        return {}
    rates = experiment.controller
    return {"controller.position_rate": rates.position_rate, "controller.velocity_rate": rates.velocity_rate}


def base_of(protocol: Protocol, folder: Path) -> Experiment:
    """Return the experiment that a protocol in the directory `folder` names; raise `ConfigError` if it is not valid."""
    study = {"preset": protocol.study.preset, "experiment": protocol.study.experiment}
    found = base_experiment(study, folder)
    if isinstance(found, list):
        problems = found
        raise config_error(problems, f"the protocol {protocol.study.title}")
    return found


def broken_conditions(walls: Walls) -> list[Problem]:
    """Return the problems of conditions whose walls the rig, the trial or an estimator does not allow."""
    protocol, base = walls.protocol, walls.base
    problems = [*_find_misplaced(protocol), *_wide_caps(protocol, base), *_wide_bands(protocol, base)]
    return problems or list(_find_refused(walls))


def _study_changes(protocol: Protocol) -> dict[str, Any]:
    return {**protocol.study.changes, **_trial_and_caps(protocol)}


def _trial_and_caps(protocol: Protocol) -> dict[str, Any]:
    trial, caps = protocol.trial, protocol.caps
    values = {
        "trial.duration_s": trial.duration_s,
        "trial.baseline_s": trial.baseline_s or None,
        "trial.foreperiod_s": trial.foreperiod_s or None,
        "trial.hold_s": trial.hold_s,
        "rig.limits.effort": caps.effort,
        "rig.limits.speed": caps.speed,
        "rig.limits.energy": caps.energy,
    }
    given = {key: value for key, value in values.items() if value is not None}
    return {"trial.kind": trial.kind, "trial.repeats": 1, "trial.seed": protocol.study.seed, **given}


def _find_misplaced(protocol: Protocol) -> Iterator[Problem]:
    places: list[tuple[str, Mapping[str, Any]]] = [("study.changes", protocol.study.changes)]
    places += [(f"condition {n}.changes", one.changes) for n, one in enumerate(protocol.condition, 1)]
    for place, changes in places:
        for key, value in changes.items():
            name = f"{place}.{key}"
            if key in OWNED:
                yield Problem(
                    name, shown(value), f"is set by {OWNED[key]}", f"omit it here, and set {OWNED[key]}"
                )
            elif key not in parameters() and not key.startswith(f"{FREE}."):
                section, _, leaf = key.rpartition(".")
                instead = EXPERIMENT.known_instead(section, leaf)
                yield Problem(name, shown(value), "is not a key of an experiment", instead)


def _wide_caps(protocol: Protocol, base: Experiment) -> Iterator[Problem]:
    limits = {name: getattr(base.rig.limits, name) for name in ("effort", "speed", "energy")}
    for name, quantity in (("effort", "effort"), ("speed", "velocity"), ("energy", "J")):
        cap, unit = getattr(protocol.caps, name), unit_of(quantity, base.rig.motion)
        limit = protocol.study.changes.get(f"rig.limits.{name}", limits[name])
        if cap is not None and isinstance(limit, int | float) and cap > limit:
            yield Problem(
                f"caps.{name}",
                f"{cap:g} {unit}",
                f"must be at most rig.limits.{name} of the rig, {limit:g} {unit}",
                "lower it, or omit it",
            )


def _wide_bands(protocol: Protocol, base: Experiment) -> Iterator[Problem]:
    studied, kind = _study_changes(protocol), {"trial.kind": protocol.trial.kind}
    limits = config.override(base, kind, "the study", check_rules=False).rig.limits
    for name, (quantity, _, _) in BANDS.items():
        band, limited = getattr(protocol.trial, name), "effort" if name == "press" else "speed"
        unit = unit_of(quantity, base.rig.motion)
        limit = studied.get(f"rig.limits.{limited}", getattr(limits, limited))
        if band and isinstance(limit, int | float) and band[-1] > limit:
            must = f"must end at rig.limits.{limited} at most, {limit:g} {unit}"
            yield Problem(f"trial.{name}", f"{shown(band)} {unit}", must, "lower its upper end")


def _find_refused(walls: Walls) -> Iterator[Problem]:
    protocol, unit = walls.protocol, unit_of("stiffness", walls.base.rig.motion)
    for number, condition in enumerate(protocol.condition, 1):
        levels = levels_of(protocol.search_of(condition))
        asked = [(b, k) for k in (levels[0], levels[-1]) for b in condition.damping]
        if condition.name == (protocol.practice.condition or protocol.condition[0].name):
            asked += [(condition.damping[0], k) for k in protocol.practice.stiffness]
        for damping, stiffness in asked:
            try:
                walls.at(condition, damping, stiffness)
            except RigError as error:
                name = f"condition {number}, {shown(condition.name)}"
                where = f"cannot be run at K = {stiffness:g} {unit}: {error.message}"
                yield Problem(name, "", where, error.remedy)
                break
