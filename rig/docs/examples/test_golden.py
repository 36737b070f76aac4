"""A golden test: a hit must stay equal to the stored recording, row for row.

Run `pytest --rig-golden=update test_golden.py` once, look at the recording, commit tests/golden; then `pytest`.
"""

from rig.testing import Golden, Hits, assert_passive, assert_stable


def test_our_wall_is_stable_and_as_it_was(rig_hit: Hits, rig_golden: Golden) -> None:
    """Fail with the first row, column and unit that differ from the stored recording."""
    hit = rig_hit("koul-compliant", {"wall.stiffness": 300.0, "trial.duration_s": 0.6})
    assert_stable(hit)
    assert_passive(hit)
    rig_golden(hit)
