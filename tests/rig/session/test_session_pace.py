"""Samples lost by a computer or link: measured before a session, logged, and rejected if there are too many."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.config import Experiment, VerdictLimits
from rig.config.presets import load as preset
from rig.core.check import Outcome
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.doctor._round_trip import LinkMeasurement
from rig.doctor.pace import Pace, pace_of
from rig.recording.quantiles import Distribution
from rig.session.engine import _device_checks as on_device
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import Event
from rig.session.engine._pace import refuse_lossy, sentence
from rig.session.engine._place import resume_command
from rig.session.engine._telling import line_of_event
from rig.session.planning._conditions import Walls
from tests.rig.session.session_fakes import FakeRunner, protocol_of

LIMITS = VerdictLimits(longest_gap=2, lost_fraction=0.01)


def link_of(stalls_s: Mapping[int, float], usual_s: float = 0.3e-3) -> LinkMeasurement:
    """Return a link measured for two seconds at 1 kHz: replies in 0.3 ms, except those with a stall (s)."""
    travel_s = np.full(2000, usual_s)
    for place, stall in stalls_s.items():
        travel_s[place] = stall
    sent = np.arange(2000) * 1_000_000
    received = sent + np.rint(1e9 * travel_s).astype(np.int64)
    exchanges = np.column_stack([sent, sent, sent, received])
    return LinkMeasurement(
        url="test", virtual=False, simulated=True, duration_s=2.0, asked_rate_hz=1000.0, sent=2000, lost=0, late=0,
        unsent=0, bad_frames=0, round_trip_s=Distribution.of(travel_s), travel_s=Distribution.of(travel_s),
        stamps_trusted=True, bytes_to_device_per_s=0.0, bytes_to_host_per_s=0.0, capacity_bytes_per_s=None, states=0,
        exchanges=exchanges,
    )  # fmt: skip


def test_a_stall_a_late_thread_and_a_missing_answer_lose_samples_and_a_long_way_none() -> None:
    found = pace_of(link_of({700: 11.2e-3}), 1000, LIMITS)
    assert (found.lost_share, found.longest_gap_s) == (10 / 2000, 0.010)  # the samples of its periods
    assert not found.hopeless  # a bad moment is not a bad machine
    assert pace_of(link_of({}), 1000, LIMITS).text == ""
    assert pace_of(link_of({}, usual_s=4.2e-3), 1000, LIMITS).lost_share == 0.0
    woken = link_of({})
    woken.exchanges[900:] += 5_400_000  # asked late, and answered at once
    assert pace_of(woken, 1000, LIMITS).lost_share == 5 / 2000
    link = replace(link_of({}), lost=1, exchanges=np.delete(link_of({}).exchanges, slice(500, 551), axis=0))
    assert pace_of(link, 1000, LIMITS).lost_share == 1 / 2000
    assert pace_of(replace(link, late=1), 1000, LIMITS).lost_share == 51 / 2000  # it came: the host slept


def test_the_rate_that_is_proposed_is_the_highest_that_these_answers_keep() -> None:
    often = dict.fromkeys(range(10, 2000, 50), 2.1e-3)
    found = pace_of(link_of(often), 1000, LIMITS)
    assert found.kept_hz == 500
    assert pace_of(link_of(often), 500, LIMITS).lost_share == 0.0
    assert sentence(found, simulated=True) == (
        "this computer or the link loses 2 % of the samples at 1000 Hz, or is late with them, for up to 1 ms "
        "at a time; run at 500 Hz, or rehearse, or close other programs and run `rig doctor`"
    )
    assert pace_of(link_of({1: 0.1, 900: 0.1}), 1000, LIMITS).kept_hz is None


def test_where_every_quarter_would_spoil_a_trial_it_is_hopeless() -> None:
    gaps = dict.fromkeys((100, 600, 1100, 1600), 4.5e-3)
    assert pace_of(link_of(gaps), 1000, LIMITS).hopeless
    assert not pace_of(link_of(dict(list(gaps.items())[1:])), 1000, LIMITS).hopeless
    single = dict.fromkeys(range(1, 2000, 60), 1.5e-3)  # 1.7 % of the samples, one at a time
    assert pace_of(link_of(single), 1000, LIMITS).hopeless
    assert not pace_of(link_of(dict(list(single.items())[::2])), 1000, LIMITS).hopeless


class SlowRunner(FakeRunner):
    virtual = False

    def __init__(self, pace: Pace, *, lossy_anyway: bool = False) -> None:
        super().__init__()
        self.found, self.lossy_anyway = pace, lossy_anyway
        self.rates: list[int] = []

    def pace(self, experiment: Experiment, changes: Mapping[str, Any]) -> Pace | None:
        self.rates.append(experiment.controller.position_rate)
        return self.found


def test_a_hopeless_session_is_refused_unless_the_operator_accepts_it() -> None:
    bad = pace_of(link_of(dict.fromkeys(range(0, 2000, 100), 4.5e-3)), 1000, LIMITS)
    walls = Walls(protocol_of(), preset("koul-rigid"))
    with pytest.raises(PlanError, match="nearly every trial would be invalid") as refused:
        refuse_lossy(walls, SlowRunner(bad))
    assert "`lossy_anyway`" in refused.value.remedy
    runner = SlowRunner(bad, lossy_anyway=True)
    refuse_lossy(walls, runner)
    assert runner.rates == [20_000]  # the fastest of the session, once
    refuse_lossy(walls, SlowRunner(replace(bad, hopeless=False)))


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({"lost_share": 0.0}, Outcome.OK),
        ({}, Outcome.WARNING),
        ({"hopeless": True}, Outcome.REFUSED),
    ],
)
def test_a_check_of_a_study_on_a_device_reports_lost_samples(
    change: dict[str, Any], outcome: Outcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = Pace(rate_hz=1000, lost_share=0.02, longest_gap_s=0.003, hopeless=False, kept_hz=250)
    monkeypatch.setattr(DeviceRunner, "pace", lambda *_: replace(lost, **change))
    for name in ("fit_checks", "arming_checks"):
        monkeypatch.setattr(on_device, name, lambda *_: [])
    (check,) = on_device.device_checks("sim://", Walls(protocol_of(), preset("koul-rigid")))
    assert (check.name, check.outcome) == ("samples", outcome)
    assert outcome is Outcome.OK or "run at 250 Hz" in check.remedy


def test_the_measured_loss_is_in_the_log_and_its_line() -> None:
    bad = pace_of(link_of(dict.fromkeys(range(0, 2000, 100), 4.5e-3)), 1000, LIMITS)
    pace = {**plain(bad), "said": sentence(bad, simulated=True)}
    opened = Event(1, 0.0, "opened", {"pace": pace, "place": {"url": None, "realtime": True}})
    assert sentence(bad, simulated=True).partition(";")[0] in line_of_event(opened)
    assert "nearly every trial will be invalid, which the operator accepted" in line_of_event(opened)
    assert resume_command(Path("P01"), [opened]).endswith("--lossy-anyway")
    assert line_of_event(Event(1, 0.0, "opened", {"pace": None})) == "opened"
