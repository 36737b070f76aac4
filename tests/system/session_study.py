"""A short session protocol whose hits are quick to simulate, and helpers of the tests that run it."""

from pathlib import Path
from typing import Any

from rig.session.engine._log import Event
from tests.rig.session.session_fakes import decisions

PROTOCOL = """
[study]
title = "quick"
preset = "koul-rigid"
seed = 11
[study.changes]
"operator.press" = 1.6
"operator.begin_s" = 0.02
"operator.reach_s" = 0.1
"homing.settle_s" = 0.02
"homing.speed" = 0.3
"verdict.tail_s" = 0.1
"verdict.lowpass_hz" = 400.0
"trial.minimum_rest_counts" = 0.0
"trial.release_s" = 0.02
[trial]
duration_s = 0.3
[search]
rule = "staircase"
lowest = 20.0
highest = 120.0
step = 20.0
settings = { turns = 2, most = 3, steps = [2, 1] }
[order]
kind = "fixed"
repeats = 2
[[condition]]
name = "hidden-dual"
scheme = "dual:2k/1k"
damping = [0.211]
[[condition]]
name = "hidden-uniform"
scheme = "uniform:2k"
damping = [0.211]
[[question]]
name = "tired"
text = "How tired?"
"""


def written(directory: Path) -> Path:
    path = directory / "quick.toml"
    path.write_text(PROTOCOL)
    return path


def comparable(events: list[Event]) -> list[tuple[str, dict[str, Any]]]:
    """Return the decisions of a log without hashes and versions.

    Hashes of recordings depend on time and machine; versions change if a file of the checkout changes meanwhile.
    """
    return [
        (kind, {key: value for key, value in content.items() if key not in ("sha256", "versions")})
        for kind, content in decisions(events)
    ]
