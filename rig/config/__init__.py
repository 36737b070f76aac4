"""An experiment file becomes the numbers of a run.

* `sections`: the dataclasses, with range, unit and meaning of every key;
* `table`: the same as a table, from which messages, listings and the editors' schema are made;
* `rules`: what ties keys together;
* `files`: TOML and presets as raw tables;
* `checked`: types and ranges of every key, for this and other kinds of files;
* `people`: the limits of a trial in which a person holds the handle;
* `load`: the way to an `Experiment`;
* `derive`: what others make of it.

pydantic is loaded when something is validated, not by this import.
"""

from rig.config.derive import (
    check_plugins,
    excitation_s,
    excitation_size,
    excited,
    motor_push,
    press_for,
    push_at_rest,
    push_s,
    rig_model,
    verdict_thresholds,
)
from rig.config.load import (
    LOOP,
    as_mapping,
    experiment_from_mapping,
    load_experiment,
    override,
    realtime_changes,
    restore_experiment,
    with_realtime,
)
from rig.config.people import human_limits_exceeded
from rig.config.sections import (
    Controller,
    Excitation,
    Experiment,
    Homing,
    Limits,
    Rig,
    Trial,
    VerdictLimits,
    Wall,
)
from rig.config.table import ListedKey, describe, json_schema

__all__ = [
    "LOOP",
    "Controller",
    "Excitation",
    "Experiment",
    "Homing",
    "Limits",
    "ListedKey",
    "Rig",
    "Trial",
    "VerdictLimits",
    "Wall",
    "as_mapping",
    "check_plugins",
    "describe",
    "excitation_s",
    "excitation_size",
    "excited",
    "experiment_from_mapping",
    "human_limits_exceeded",
    "json_schema",
    "load_experiment",
    "motor_push",
    "override",
    "press_for",
    "push_at_rest",
    "push_s",
    "realtime_changes",
    "restore_experiment",
    "rig_model",
    "verdict_thresholds",
    "with_realtime",
]
