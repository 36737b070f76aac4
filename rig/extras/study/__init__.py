"""From the logs of a study to its tables and statistics: limits, intervals, differences, agreement, order and fatigue.

    found = analyse([Path("sessions/study")])
    found.over_participants         # K_max by condition and damping
    write_study_tables(found, Path("out"))

Nothing but the logs is needed; recordings are compared with their hashes.
"""

from rig.extras.study.analyse import AnalysisOptions, StudyAnalysis, analyse, analyse_study
from rig.extras.study.rows import MEASURES, LimitInterval, Measure, RunRow, TrialRow
from rig.extras.study.study import Study, StudySession, read_study
from rig.extras.study.tables import write_study_tables

__all__ = [
    "MEASURES",
    "AnalysisOptions",
    "LimitInterval",
    "Measure",
    "RunRow",
    "Study",
    "StudyAnalysis",
    "StudySession",
    "TrialRow",
    "analyse",
    "analyse_study",
    "read_study",
    "write_study_tables",
]
