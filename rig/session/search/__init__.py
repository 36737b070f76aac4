"""Search rules: choose the stiffness that a person judges next, and estimate the highest stiffness of a stable wall.

    rule = search.make("staircase", levels=range(100, 900, 25), seed=7)
    probe = rule.next(answers)          # None when the search is finished
    estimate = rule.estimate(answers)   # with a 95 % interval

A rule stores nothing between calls: each call receives all answers so far. Sessions use the rules; the analysis of
finished sessions uses their psychometric function. This package presents no wall, reads no log, and uses random numbers
only with a given seed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rig.core.errors import ConfigError
from rig.session.search._ascending import Ascending
from rig.session.search._catching import Catching, CatchTrials
from rig.session.search._grid import LevelGrid
from rig.session.search._interleaved import Interleaved
from rig.session.search._psi import Psi
from rig.session.search._psychometric import (
    LAPSE_RATES,
    Located,
    PsychometricGrid,
    locate,
    of_levels,
    share_stable,
)
from rig.session.search._resolution import (
    FLOATING,
    is_resolved,
    rounding_deviation,
    step_at,
    unresolved_words,
)
from rig.session.search._rule import Censored, Estimate, JudgedProbe, Probe, Rule, contradiction, verdicts_of
from rig.session.search._staircase import EDGE_VERDICTS, Staircase

__all__ = [
    "EDGE_VERDICTS",
    "FLOATING",
    "LAPSE_RATES",
    "RULES",
    "Ascending",
    "CatchTrials",
    "Catching",
    "Censored",
    "Estimate",
    "JudgedProbe",
    "Located",
    "Probe",
    "PsychometricGrid",
    "Rule",
    "contradiction",
    "is_resolved",
    "locate",
    "make",
    "of_levels",
    "rounding_deviation",
    "share_stable",
    "step_at",
    "unresolved_words",
    "verdicts_of",
]

RULES: dict[str, Callable[..., Rule]] = {
    "ascending": Ascending,
    "staircase": Staircase,
    "interleaved": Interleaved,
    "psi": Psi,
    "grid": LevelGrid,
}


def make(name: str, **settings: Any) -> Rule:
    """Return a search rule, which chooses the walls to judge, by its name (a key of `RULES`) and its settings.

    Settings are e.g. levels (stiffnesses) and seed. Raise `rig.core.errors.ConfigError` for an unknown name, an unknown
    setting or an invalid value.
    """
    rule = RULES.get(name)
    if rule is None:
        raise ConfigError(f"unknown search rule {name!r}", remedy=f"choose one of {', '.join(sorted(RULES))}")
    try:
        return rule(**settings)
    except TypeError as error:
        raise ConfigError(
            f"search rule {name}: {error}",
            remedy="remove or correct this setting; rig/session/search/README.md lists the settings of each rule",
        ) from error
