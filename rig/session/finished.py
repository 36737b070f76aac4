"""What a session's directory contains once it is over: its events, state, trials, protocol and what changed between.

`rig.extras.study` computes tables, reports and exports from it. Nothing here opens a device, holds a session or writes
a file, and it loads neither the loop nor the simulation.
"""

from rig.session.engine.log import Event, log_losses, read
from rig.session.engine.place import device_words, lost_samples
from rig.session.engine.place import differences as place_differences
from rig.session.engine.protocol_changes import (
    Difference,
    is_within,
    listed,
    settings_of,
    value_words,
    walls_in,
)
from rig.session.engine.protocol_changes import differences as protocol_differences
from rig.session.engine.state import END, WALKING, SessionState
from rig.session.planning.bands import asked
from rig.session.planning.names import distinct_names
from rig.session.planning.protocol import Condition, Protocol
from rig.session.planning.schedule import SearchRun, cells_of, levels_of, rows_of, rule
from rig.session.planning.trial import VOIDED, RecordedTrial

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
    "asked",
    "cells_of",
    "device_words",
    "distinct_names",
    "is_within",
    "levels_of",
    "listed",
    "log_losses",
    "lost_samples",
    "place_differences",
    "protocol_differences",
    "read",
    "rows_of",
    "rule",
    "settings_of",
    "value_words",
    "walls_in",
]
