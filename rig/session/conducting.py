"""Conduct a session with a rig or a simulated hand: begin, rehearse, resume or correct it, and print its log as text.

`rig session run` and the page in the browser use this module, each with its own desk (the operator's user interface).
This module displays nothing itself. Callers must write to a session's directory only through these functions.
"""

from rig.session.engine._desk import Desk, DeskView
from rig.session.engine._device_checks import device_checks
from rig.session.engine._directory import LOG, REHEARSALS, SESSIONS, amend, event_of_trial
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import DamagedLineError, Event, read, set_damaged_line_aside
from rig.session.engine._place import last_opened, list_lost_samples
from rig.session.engine._protocol_changes import ChangedProtocolError
from rig.session.engine._rehearsal import Person, thresholds_of
from rig.session.engine._run import (
    DeskFor,
    SessionResult,
    compare_with_study,
    read_person,
    rehearsal_desk,
    resume_session,
    run_session,
    session_state,
    summary,
    took_place,
)
from rig.session.engine._runner import TrialRunner
from rig.session.engine._state import SessionState
from rig.session.engine._telling import line_of_event, whole_line

__all__ = [
    "LOG",
    "REHEARSALS",
    "SESSIONS",
    "ChangedProtocolError",
    "DamagedLineError",
    "Desk",
    "DeskFor",
    "DeskView",
    "DeviceRunner",
    "Event",
    "Person",
    "SessionResult",
    "SessionState",
    "TrialRunner",
    "amend",
    "compare_with_study",
    "device_checks",
    "event_of_trial",
    "last_opened",
    "line_of_event",
    "list_lost_samples",
    "read",
    "read_person",
    "rehearsal_desk",
    "resume_session",
    "run_session",
    "session_state",
    "set_damaged_line_aside",
    "summary",
    "thresholds_of",
    "took_place",
    "whole_line",
]
