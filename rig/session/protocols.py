"""Prepare a study before its first session: check a protocol, write a template, compute schedule and disk space.

`rig session new`, `check` and `plan`, the page in the browser and the reference pages use this module. It moves no
motor. It opens a device only to check that the device can run the conditions (`rig.session.engine._device_checks`).
"""

from rig.session.engine._check import check
from rig.session.engine._directory import study_directory
from rig.session.planning._disk import format_size
from rig.session.planning._expected import ExpectedRange
from rig.session.planning._load import as_mapping, json_schema, load_protocol, load_walls
from rig.session.planning._plan import CellPlan, StudyPlan
from rig.session.planning._protocol import Protocol
from rig.session.planning._template_files import (
    DEFAULT,
    SCHEMA,
    template_names,
    template_path,
    template_subject,
    write_template,
)

__all__ = [
    "DEFAULT",
    "SCHEMA",
    "CellPlan",
    "ExpectedRange",
    "Protocol",
    "StudyPlan",
    "as_mapping",
    "check",
    "format_size",
    "json_schema",
    "load_protocol",
    "load_walls",
    "study_directory",
    "template_names",
    "template_path",
    "template_subject",
    "write_template",
]
