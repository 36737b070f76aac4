"""Create a checked `Experiment` from a file, a mapping or options; or raise one error that lists all problems.

`rig.config` exports these functions. They must not write a file.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rig.config import homing
from rig.config._files import Table, flatten, nest, overlay, preset_names, preset_table, read_toml, tidy
from rig.config._people import with_human_limits
from rig.config._problems import Problem, config_error, did_you_mean
from rig.config._rules import broken_rules
from rig.config._sections import Experiment
from rig.config._table import parameters, shown
from rig.config.checked import FileKind, apply_changes, parse_table, plain, value_at
from rig.core.errors import ConfigError
from rig.core.operators import GRIPS
from rig.core.sample import UNITS, Motion

DEFAULT_PRESET = "koul-compliant"
DEFAULT_GRIP = "normal"
LOOP = "controller.loop"
# The only table with free keys: the estimator defines them.
FREE = "controller.parameters"

EXPERIMENT = FileKind(
    Experiment,
    "the experiment",
    also=("preset",),
    otherwise=f"start from a preset with preset = {shown(DEFAULT_PRESET)}",
)


def load_experiment(path: str | Path) -> Experiment:
    """Read and check an experiment file.

    The file may begin with ``preset = "koul-compliant"``; then it needs only the keys that differ from the preset.

    Raises
    ------
    ConfigError
        The file has problems. The message has one line for each problem: file, key, value, allowed range with its unit,
        and what to do.
    """
    mapping = read_toml(Path(path))
    if not mapping:
        raise ConfigError(
            f"{path}: is empty",
            remedy='begin with preset = "koul-compliant" (rig experiment preset lists others)',
        )
    return experiment_from_mapping(mapping, str(path))


def experiment_from_mapping(mapping: Mapping[str, Any], source: str) -> Experiment:
    """Return the checked experiment from nested mappings with the structure of an experiment file.

    `source` names the mapping in messages. If the mapping names a preset but another rig, keys of ``[homing]`` that the
    mapping leaves out are computed from the rig's friction, inertia, resolution and delays (`rig.config.homing`).
    """
    table = tidy(mapping)
    if not isinstance(table, dict):
        raise ConfigError(
            f"{source}: must be a table of sections", remedy='give a mapping of sections, like {"wall": {…}}'
        )
    preset, top = None, table
    if "preset" in table:
        name = table.pop("preset")
        preset = _preset(name, source)
        table = _overlay_preset(preset, top)
        source = f"{source} (on preset {name})"
    table = _with_defaults(table)
    with _refuse_arithmetic_errors(source):
        parsed = parse_table(EXPERIMENT, table, _motion(table))
        # Unpacked in a second step: mypy infers None for the experiment when it is unpacked at once.
        experiment, problems = parsed
        problems += _wrong_realtime(table.get("realtime", {}))
        if experiment is not None and not problems:
            if preset is not None:
                experiment = with_human_limits(
                    _with_servo(experiment, _servo_keys_to_compute(preset, top)), _keys_of(top)
                )
            problems = broken_rules(experiment)
    if problems or experiment is None:
        raise config_error(problems, source)
    return experiment


def restore_experiment(mapping: Mapping[str, Any]) -> Experiment:
    """Return the experiment from nested dicts that `as_mapping` made, without a check of the rules between keys."""
    parsed = parse_table(EXPERIMENT, dict(mapping), None)
    experiment, problems = parsed
    if experiment is None:
        raise config_error(problems, "the saved experiment")
    return experiment


def override(
    experiment: Experiment,
    changes: Mapping[str, Any],
    source: str = "command line",
    *,
    check_rules: bool = True,
) -> Experiment:
    """Return the experiment with some keys changed; check each new value, and then the rules between keys.

    A change of the velocity estimator, or of the grip of the simulated hand, drops the settings of the old one. The
    section ``[realtime]`` has values that replace others in a run in real time; a changed key is removed from it, so
    that the change applies there too. If ``trial.kind`` becomes "human", the effort limits for people are set.

    Parameters
    ----------
    changes
        New values by dotted key, like ``{"wall.stiffness": 400.0}``.
    source
        Name of the changes in error messages.
    check_rules
        False skips the rules between keys, for an experiment that further changes will complete.
    """
    wanted = nest(tidy(changes))
    start, meant = _without_replaced_settings(experiment, wanted), _keys_of(wanted)
    if isinstance(wanted.get("realtime", {}), dict):
        kept = {key: value for key, value in start.realtime.items() if key not in meant}
        start = replace(start, realtime=kept)
        if "realtime" in wanted:
            wanted["realtime"] = dict(flatten(wanted["realtime"]))
    with _refuse_arithmetic_errors(source):
        other, problems = apply_changes(EXPERIMENT, start, wanted, _motion(wanted, experiment.rig.motion))
        problems += _wrong_realtime(wanted.get("realtime", {}))
        if not problems:
            other = with_human_limits(other, meant)
            problems = broken_rules(other) if check_rules else []
    if problems:
        raise config_error(problems, source)
    return other


def _keys_of(table: Table) -> set[str]:
    return {key for key, _ in flatten({name: part for name, part in table.items() if name != "realtime"})}


def _without_replaced_settings(experiment: Experiment, wanted: Table) -> Experiment:
    estimator, grip = value_at(wanted, ("controller", "estimator")), value_at(wanted, ("operator", "grip"))
    if estimator is not None and estimator != experiment.controller.estimator:
        experiment = replace(experiment, controller=replace(experiment.controller, parameters={}))
    if isinstance(grip, str) and grip in GRIPS and grip != experiment.operator.grip:
        experiment = replace(experiment, operator=GRIPS[grip])
    return experiment


def realtime_changes(experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return all changes for a run in real time, by dotted key: the section ``[realtime]``, then the user's `changes`.

    If the device runs the force law, only the keys ``host.…`` of ``[realtime]`` apply.
    """
    gentler: dict[str, Any] = dict(experiment.realtime)
    if changes.get(LOOP, experiment.controller.loop) == "device":
        gentler = {key: value for key, value in gentler.items() if key.startswith("host.")}
    return {**gentler, **changes}


def with_realtime(experiment: Experiment, changes: Mapping[str, Any] | None = None) -> Experiment:
    """Return the checked experiment for a run in real time: with the values in its ``[realtime]``, then `changes`."""
    wanted = realtime_changes(experiment, changes or {})
    return override(experiment, wanted, f"[realtime] of {experiment.rig.name}")


def as_mapping(experiment: Experiment) -> dict[str, Any]:
    """Return the experiment as nested dicts for JSON, which `experiment_from_mapping` converts back."""
    return plain(experiment)  # type: ignore[no-any-return]


def _preset(name: Any, source: str) -> Table:
    if not isinstance(name, str) or name not in preset_names():
        choice = f"choose one of: {', '.join(preset_names())}"
        raise config_error(
            [
                Problem(
                    "preset",
                    shown(name),
                    "unknown preset",
                    did_you_mean(str(name), preset_names(), choice),
                )
            ],
            source,
        )
    return preset_table(name)


def _overlay_preset(base: Table, top: Table) -> Table:
    merged = overlay(base, top)
    layers = [layer["realtime"] for layer in (base, top) if "realtime" in layer]
    if layers and all(isinstance(layer, dict) for layer in layers):
        meant = _keys_of(top)
        below = base.get("realtime", {})
        kept = {key: value for key, value in flatten(below) if key not in meant}
        merged["realtime"] = {**kept, **dict(flatten(top.get("realtime", {})))}
    return merged


def _servo_keys_to_compute(preset: Table, table: Table) -> frozenset[str]:
    """Return the keys of ``[homing]`` to compute for a rig that is not the preset's rig: those missing in `table`."""
    name, given = value_at(table, ("rig", "name")), table.get("homing", {})
    if name in (None, value_at(preset, ("rig", "name"))) or not isinstance(given, dict):
        return frozenset()
    return frozenset({"stiffness", "damping", "effort", "slew", "tolerance_counts"} - given.keys())


def _with_servo(experiment: Experiment, names: frozenset[str]) -> Experiment:
    if not names:
        return experiment
    servo = asdict(homing.stable_servo(experiment))
    slower = {key: value for key, value in experiment.realtime.items() if key.startswith("controller.")}
    real = asdict(homing.stable_servo(override(experiment, slower, "[realtime]", check_rules=False)))
    gains = {f"homing.{name}": real[name] for name in ("stiffness", "damping") if name in names}
    servo = {name: value for name, value in servo.items() if name in names}
    realtime = {**gains, **experiment.realtime} if slower else experiment.realtime
    return replace(experiment, homing=replace(experiment.homing, **servo), realtime=realtime)


@contextmanager
def _refuse_arithmetic_errors(source: str) -> Iterator[None]:
    try:
        yield
    except ArithmeticError as error:
        raise ConfigError(
            f"{source}: some values are too large or too small to compute with ({error})",
            remedy="check the units and powers of ten of the numbers",
        ) from None


def _with_defaults(table: Table) -> Table:
    """Return `table` with the defaults that depend on other keys.

    Without an effort limit, the limit is the motor's nominal effort, which is safe for people; a setting of the
    simulated hand that is missing is taken from its grip (relaxed, normal or firm).
    """
    limits = value_at(table, ("rig", "limits"))
    if isinstance(limits, dict) and "nominal_effort" in limits and "effort" not in limits:
        table = overlay(table, nest({"rig.limits.effort": limits["nominal_effort"]}))
    operator = table.get("operator")
    if isinstance(operator, dict):
        grip = operator.get("grip", DEFAULT_GRIP)
        known = GRIPS.get(grip) if isinstance(grip, str) else None
        table = {**table, "operator": {**plain(known or GRIPS[DEFAULT_GRIP]), **operator}}
    if isinstance(table.get("realtime"), dict):
        table = {**table, "realtime": dict(flatten(table["realtime"]))}
    return table


def _wrong_realtime(changes: Any) -> Iterator[Problem]:
    """Yield a problem for each unknown key of ``[realtime]``; the values are checked only when a run uses them."""
    for key, value in changes.items() if isinstance(changes, dict) else ():
        section, _, leaf = key.rpartition(".")
        if key not in parameters() and section != FREE:
            yield Problem(
                f"realtime.{key}", shown(value), "is not a known key", EXPERIMENT.known_instead(section, leaf)
            )


def _motion(table: Table, unless_named: Motion | None = None) -> Motion | None:
    named = value_at(table, ("rig", "motion"))
    if named is None:
        return unless_named
    return named if isinstance(named, str) and named in UNITS["position"] else None  # type: ignore[return-value]
