"""The rate of an identification, chosen from a link whose delay and losses the test supplies."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rig.config import presets
from rig.config.controller import command_lifetime_s, rate_of_lifetime
from rig.core.errors import PlanError
from rig.doctor._ping import EXCHANGE
from rig.experiments.identification._identify_rate import at_rate, choose_rate
from rig.experiments.motion._motion_run import SLOWEST_HZ, TimingError, advice, repeat_if_late
from tests.conformance import made_links

RIG = presets.load("koul-rigid")
RATE = 1000  # of the questions


def link(travel_s: float, *, silences_s: tuple[float, ...] = (), capacity: float | None = None) -> Any:
    """Return a measured link: ten thousand replies, each after `travel_s`, with silences spread evenly between them."""
    number = 10_000
    received = np.arange(number) * 1e9 / RATE
    for place, silence_s in enumerate(silences_s):
        received[(place + 1) * number // (len(silences_s) + 1) :] += 1e9 * silence_s
    exchanges = np.zeros((number, len(EXCHANGE)), np.int64)
    exchanges[:, EXCHANGE.host_received] = received
    measured = made_links.link(travel_s, number=number, capacity=capacity, duration_s=received[-1] * 1e-9)
    return replace(measured, asked_rate_hz=RATE, sent=number, exchanges=exchanges)


@pytest.mark.parametrize(
    ("measured", "rate_hz"),
    [
        (link(2e-4), 1000),
        (link(2e-3), 1000),  # a command lives for five ticks, 5 ms, and may be under way for half of it
        (link(3e-3), 500),
        (link(6e-3), 250),
        (link(2e-4, silences_s=(0.004,)), 500),
        (link(2e-4, silences_s=(0.0095,)), 250),
        # 200 of 10 000 samples are too many, and half of them at 500 Hz.
        (link(2e-4, silences_s=(0.0024,) * 100), 250),
        (link(2e-4, capacity=40_000.0), 500),
    ],
)
def test_the_highest_rate_is_chosen_that_the_link_carries(measured: Any, rate_hz: int) -> None:
    assert choose_rate(RIG, measured, most_hz=1000).rate_hz == rate_hz


def test_a_stated_rate_is_kept_or_refused_with_the_rate_that_works() -> None:
    slow = link(3e-3)
    assert choose_rate(RIG, slow, most_hz=1000, stated_hz=400).rate_hz == 400
    with pytest.raises(PlanError, match="an identification at 2000 Hz would fail") as caught:
        choose_rate(RIG, slow, most_hz=1000, stated_hz=2000)
    assert "`rate` 500" in str(caught.value.remedy)
    works = choose_rate(RIG, slow, most_hz=1000, stated_hz=500)
    assert works.reason == ""


def test_a_link_that_carries_no_rate_is_refused_with_the_numbers() -> None:
    """At 250 Hz, seven whole samples are lost in a silence of 30 ms."""
    with pytest.raises(PlanError, match="sent nothing for 28 ms") as caught:
        choose_rate(RIG, link(2e-4, silences_s=(0.03,)), most_hz=1000)
    assert f"now support 62 Hz, and an identification needs {SLOWEST_HZ} Hz" in str(caught.value.remedy)
    with pytest.raises(PlanError, match="an identification at 250 Hz would fail") as caught:
        choose_rate(RIG, link(2e-4, silences_s=(0.4,) * 10), most_hz=1000)
    assert "now support less than 10 Hz" in str(caught.value.remedy)


def test_a_motion_that_timing_spoils_is_repeated_in_real_time_alone() -> None:
    def after(late: int) -> Any:
        outcomes = iter([*[TimingError("late", remedy="")] * late, "done"])

        def run() -> str:
            outcome = next(outcomes)
            if isinstance(outcome, TimingError):
                raise outcome
            return outcome

        return run

    clocks = (SimpleNamespace(virtual=virtual) for virtual in (False, True))
    real, virtual = (SimpleNamespace(link=SimpleNamespace(clock=clock)) for clock in clocks)
    assert repeat_if_late(real, after(3), 1000) == ("done", 3)
    for device, late in ((real, 4), (virtual, 1)):
        with pytest.raises(TimingError):
            repeat_if_late(device, after(late), 1000)


def test_a_run_that_silence_ended_names_the_rate_that_outlives_it() -> None:
    assert "`rate` 300" in advice(0.008, 1000)
    assert "no rate from 250 Hz up" in advice(0.06, 1000)
    assert "no rate from 250 Hz up" in advice(0.015, 125), "commands of a slower loop live for 20 ms too"


@pytest.mark.parametrize("lifetime_s", [0.002, 0.004, 0.0105, 0.02, 0.03, 0.2])
def test_a_command_lives_for_the_time_of_which_the_rate_is_named(lifetime_s: float) -> None:
    rate = rate_of_lifetime(lifetime_s)
    assert command_lifetime_s(at_rate(RIG, rate, "test")) >= lifetime_s
