"""Read the directory of a finished session: events, state, trials, protocol, and differences between sessions.

`rig.extras.study` computes tables, reports and exports from these data. This module opens no device, conducts no
session, writes no file, and imports neither the control loop nor the simulation.
"""

from rig.session.engine._log import Event, log_losses, read
from rig.session.engine._place import device_words, list_lost_samples
from rig.session.engine._place import differences as place_differences
from rig.session.engine._protocol_changes import (
    Difference,
    is_within,
    list_names,
    settings_of,
    value_words,
    walls_in,
)
from rig.session.engine._protocol_changes import differences as protocol_differences
from rig.session.engine._state import END, WALKING, SessionState
from rig.session.planning._bands import describe_task
from rig.session.planning._names import distinct_names
from rig.session.planning._protocol import Condition, Protocol
from rig.session.planning._schedule import SearchRun, cells_of, levels_of, rows_of, rule
from rig.session.planning._trial import VOIDED, RecordedTrial

__all__ = [
    "END",
    "VOIDED",
    "WALKING",
    "Condition",
    "Difference",
    "Event",
    "Protocol",
    "RecordedTrial",
    "SearchRun",
    "SessionState",
    "cells_of",
    "describe_task",
    "device_words",
    "distinct_names",
    "is_within",
    "levels_of",
    "list_lost_samples",
    "list_names",
    "log_losses",
    "place_differences",
    "protocol_differences",
    "read",
    "rows_of",
    "rule",
    "settings_of",
    "value_words",
    "walls_in",
]
