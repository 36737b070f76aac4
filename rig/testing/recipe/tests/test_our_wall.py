"""Our wall on a simulated rig; on the real one: pytest --rig-url serial:///dev/ttyACM0 --rig-verified."""

import pytest

from rig.testing import Experiments, FaultWords, Golden, Hits, assert_limit, assert_safe, assert_stable

WALL = "../wall.toml"


def test_it_is_stable_and_within_the_motors_reach(rig_hit: Hits) -> None:
    hit = rig_hit(WALL)
    assert_stable(hit)
    assert_limit(hit, effort_sent=1.2, velocity=2.0)


def test_a_lost_sample_is_counted_and_does_no_harm(
    rig_hit: Hits, rig_faults: FaultWords, rig_experiment: Experiments
) -> None:
    rig_faults.link("drop", to="host", tick=30)
    hit = rig_hit(rig_experiment.short(WALL))
    assert hit.counters["lost"] == 1
    assert hit.error is None


def test_an_emergency_stop_ends_it_at_once(
    rig_hit: Hits, rig_faults: FaultWords, rig_experiment: Experiments
) -> None:
    rig_faults.device("EMERGENCY_STOP", tick=30)
    hit = rig_hit(rig_experiment.short(WALL))
    assert "emergency stop" in str(hit.error)
    assert_safe(hit, within_ms=1.0)


@pytest.mark.rig_every_frame("unplug", to="device")
def test_whenever_the_plug_is_pulled_the_effort_ends(rig_hit: Hits, rig_experiment: Experiments) -> None:
    assert_safe(rig_hit(rig_experiment.short(WALL)), within_ms=20.0)


def test_a_hit_is_what_it_was(rig_hit: Hits, rig_experiment: Experiments, rig_golden: Golden) -> None:
    rig_golden(rig_hit(rig_experiment.short(WALL)))
