"""An experiment file becomes the numbers of a run.

Every room above calls it: read and check a file, change keys, list them, and derive the numbers that several of them
decide. It prepares no run (`controller`), knows no device, and keeps nothing between two calls.

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
    DEFAULT_PRESET,
    EXPERIMENT,
    FREE,
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
    BOARD_ARITHMETICS,
    Controller,
    Excitation,
    Experiment,
    Homing,
    Host,
    Limits,
    Rig,
    SchemeCutoff,
    Trial,
    VerdictLimits,
    Wall,
)
from rig.config.table import (
    ConfigKey,
    ListedKey,
    describe,
    json_schema,
    parameters,
    parameters_of,
    schema_of,
    shown,
)

__all__ = [
    "BOARD_ARITHMETICS",
    "DEFAULT_PRESET",
    "EXPERIMENT",
    "FREE",
    "LOOP",
    "ConfigKey",
    "Controller",
    "Excitation",
    "Experiment",
    "Homing",
    "Host",
    "Limits",
    "ListedKey",
    "Rig",
    "SchemeCutoff",
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
    "parameters",
    "parameters_of",
    "press_for",
    "push_at_rest",
    "push_s",
    "realtime_changes",
    "restore_experiment",
    "rig_model",
    "schema_of",
    "shown",
    "verdict_thresholds",
    "with_realtime",
]
