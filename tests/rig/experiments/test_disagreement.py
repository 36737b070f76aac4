"""Where theory and hits differ: the rule that finds why, and that each non-linearity is taken out alone."""

from typing import Any

import numba
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

from rig.experiments.disagreement import (
    CONTACT,
    EACH,
    FOUR,
    FRICTION,
    NONE,
    OTHERS,
    QUANTUM,
    SATURATION,
    cause_of,
    cures,
)

# --- the rule -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("differs", "sets", "cause"),
    [
        (lambda left: FRICTION in left, [(FRICTION,)], FRICTION),
        (lambda left: {FRICTION, QUANTUM} <= left, [(FRICTION,), (QUANTUM,)], EACH),
        (lambda left: bool({FRICTION, CONTACT} & left), [(FRICTION, CONTACT)], OTHERS),
        (bool, [FOUR], OTHERS),
        (lambda left: True, [], NONE),
    ],
)
def test_the_cause_is_read_from_the_smallest_sets_without_which_both_agree(
    differs: Any, sets: Any, cause: str
) -> None:
    found = cures(lambda taken: not differs(set(FOUR) - set(taken)))
    assert list(found) == sets
    assert cause_of(found) == cause


def test_no_more_sets_are_tried_than_it_takes() -> None:
    tried = []
    cures(lambda taken: bool(tried.append(taken)) or SATURATION in taken)
    assert tried == [(one,) for one in FOUR]
