"""Analyse the logs of a study: stiffness limits, differences of conditions, agreement of people, order and fatigue.

    found = analyse([Path("sessions/study")])
    found.over_participants         # K_max by condition and damping
    write_study_tables(found, Path("out"))

Only the logs are needed; recordings are compared with the hashes in the logs.
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
