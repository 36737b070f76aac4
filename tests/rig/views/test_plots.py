"""Pictures of any recording and any latency ledger: without a display, units in every label."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import presets
from rig.core.clock_fit import ClockFit
from rig.core.sample import ROW, Phase, RowFlag
from rig.core.shown import Picture
from rig.devices.framed import FramedDevice
from rig.experiments.trials.replay import replay
from rig.recording._timing_summary import summarise
from rig.recording.reader import open_recording
from rig.recording.timing import NO_AGE, ledger
from rig.recording.timing_report import Timing
from rig.views.plots.hit import BEFORE_CONTACT_S, draw_hit, hit_figure
from rig.views.plots.replay import replay_figure
from sim_backend.board.make_device import make_device
from sim_backend.ends.link import MemoryLink
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on
from tests.rig.views.conftest import check_axes


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Any:
    experiment = config.override(
        presets.load("koul-compliant"),
        {"trial.duration_s": 0.15, "trial.release_s": 0.02, "homing.settle_s": 0.01, "verdict.tail_s": 0.05},
    )
    directory = tmp_path_factory.mktemp("plots")
    with FramedDevice(MemoryLink(make_device(config.rig_model(experiment), None)[0])) as device:
        return trial_on(device, experiment, directory / "hit.rigcap").recording


@pytest.fixture(scope="module")
def recording(path: Any) -> Any:
    return open_recording(path)


@pytest.fixture(scope="module")
def figure(recording: Any) -> Any:
    return hit_figure(recording)


def without_truth(recording: Any) -> Any:
    """Return the recording as a real rig has it."""
    measured = [name for name in recording.names if not name.endswith("_true")]
    return replace(recording, rows=recording.rows[measured])


def changed(recording: Any, **columns: Any) -> Any:
    rows = recording.rows.copy()
    for name, value in columns.items():
        rows[name] = value
    return replace(recording, rows=rows)


def line(axes: Any, label: Any) -> Any:
    (found,) = [candidate for candidate in axes.lines if candidate.get_label() == label]
    return found


def panels(figure: Any) -> Any:
    """Return the panels of position, velocity and effort: those of the impact, and those of the whole push."""
    return np.reshape(figure.axes, (3, 2)).T


# ---------------------------------------------------------------------- the picture of a hit


def test_a_hit_is_drawn_beside_its_recording_as_a_png(path: Any) -> None:
    picture = draw_hit(path)
    assert picture == path.with_suffix(".png")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert 20_000 < picture.stat().st_size < 500_000


def test_the_picture_shows_the_hit_from_shortly_before_contact(recording: Any, figure: Any) -> None:
    impact, push = panels(figure)
    measured = line(push[0], "measured")
    time_s = measured.get_xdata()
    touches = (recording.rows["phase"] == Phase.TRIAL) & (recording.rows["penetration"] > 0)
    contact = np.flatnonzero(touches)[0]
    assert -BEFORE_CONTACT_S - 1e-3 <= time_s[0] < 0.0
    zero = np.flatnonzero(time_s == 0.0)
    assert len(zero) == 1
    first = contact - zero[0]
    shown = recording.rows[first : first + len(time_s)]
    np.testing.assert_allclose(measured.get_ydata(), 1e3 * shown["position"])
    assert shown["phase"][-1] == Phase.TRIAL
    assert recording.rows["phase"][first + len(time_s)] == Phase.RELEASE
    earlier = line(impact[0], "measured")
    np.testing.assert_array_equal(earlier.get_ydata(), measured.get_ydata()[: len(earlier.get_ydata())])
    assert [axes.get_ylabel() for axes in impact] == ["position (mrad)", "velocity (rad/s)", "effort (N·m)"]


def test_the_effort_of_the_wall_is_drawn_with_the_sign_of_what_is_sent(recording: Any, figure: Any) -> None:
    effort = panels(figure)[1][2]
    wall, sent = line(effort, "wall alone"), line(effort, "sent: wall and push").get_ydata()
    pushed = wall.get_xdata() >= 0.0
    assert wall.get_ydata().min() < 0.0, "against the push, which is positive"
    push = recording.experiment["trial"]["effort"]
    quantum = np.min(np.diff(np.unique(sent)))
    np.testing.assert_allclose(sent[pushed], push + wall.get_ydata()[pushed], atol=0.501 * quantum)


def test_the_title_has_the_verdict_and_its_reason(recording: Any) -> None:
    verdict = {"kind": "limit cycle", "reasons": ["heard"]}
    judged = replace(recording, trailer={**recording.trailer, "verdict": verdict})
    assert hit_figure(judged)._suptitle.get_text().startswith("koul-compliant: limit cycle: heard\n")
    assert "not finished" in hit_figure(replace(recording, trailer=None))._suptitle.get_text()


def test_saturation_and_gaps_are_marked(recording: Any, figure: Any) -> None:
    flags = recording.rows["flags"].copy()
    flags[-3000::100] |= int(RowFlag.SATURATED | RowFlag.GAP)
    calm, marked = (
        {drawn.get_label() for axes in one.axes for drawn in axes.lines}
        for one in (figure, hit_figure(changed(recording, flags=flags)))
    )
    assert {one for one in marked - calm if one[0] != "_"} == {
        f"at ±{recording.experiment['rig']['limits']['effort']:g}",
        "gap in the samples",
    }


# ---------------------------------------------------------------------- recordings that are not whole


def test_a_run_that_ended_in_homing_is_not_labelled_as_an_impact(recording: Any) -> None:
    homing = changed(recording, penetration=-1.0, phase=np.full(len(recording.rows), Phase.HOMING))
    columns = panels(hit_figure(homing))
    titles = [column[0].get_title() for column in columns]
    assert titles == ["beginning", "whole run: no contact, it ended in homing"]
    assert {column[2].get_xlabel() for column in columns} == {"time (s)"}
    _, whole = panels(check_axes(hit_figure(changed(recording, penetration=-1.0))))
    assert len(line(whole[0], "measured").get_xdata()) == len(recording)


def broken_off(rows: int) -> Any:
    return lambda recording: replace(recording, rows=recording.rows[:rows], trailer=None, complete=False)


def with_law_that_went_wrong(recording: Any) -> Any:
    wrong = recording.rows["effort_wall"].copy()
    wrong[-20:], wrong[-5:] = np.nan, np.inf
    return changed(recording, effort_wall=wrong, velocity=wrong)


def with_partial_truth(recording: Any) -> Any:
    gone = recording.rows["handle_position_true"].copy()
    gone[10:] = np.nan
    return changed(recording, handle_position_true=gone, velocity_true=gone)


def at_rest(position: float) -> Any:
    def still(recording: Any) -> Any:
        rests = changed(recording, position=position, handle_position_true=position, velocity=0.0)
        experiment = {**recording.experiment, "wall": {**recording.experiment["wall"], "position": position}}
        return replace(rests, header={**recording.header, "experiment": experiment})

    return still


@pytest.mark.parametrize(
    "odd",
    first_by_default([
        without_truth, *map(broken_off, (0, 2, 1500, 1)), with_law_that_went_wrong, with_partial_truth,
        *map(at_rest, (0.0, 0.01, -0.3)),
    ], 4),
)  # fmt: skip
def test_any_recording_is_drawn(odd: Any, recording: Any) -> None:
    check_axes(hit_figure(odd(recording)))


def test_a_linear_rig_is_drawn_in_its_units(recording: Any) -> None:
    linear, _ = panels(hit_figure(replace(recording, header={**recording.header, "motion": "linear"})))
    assert [axes.get_ylabel() for axes in linear] == ["position (mm)", "velocity (m/s)", "effort (N)"]


def test_a_replay_is_drawn_against_its_recording(recording: Any, tmp_path: Path) -> None:
    result = replay(recording, {"controller.estimator": "fdm"})
    assert result.plot().save(tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
    check_axes(replay_figure(replay(replace(recording, rows=recording.rows[:0]))))


# ---------------------------------------------------------------------- the latency ledger

FIT = ClockFit(0, 10**12, 0.0, 10.0, 0.01, 1_000, 2_000, 0.0, 5.0, 10**9, 50, 1)


def rows_of(count: Any, *, spread: float = 1.0, seed: int = 1) -> Any:
    rows = np.zeros(count, ROW)
    number = np.arange(count)
    noise = np.random.default_rng(seed).exponential(5e4, (4, count)) * spread
    rows["tick"] = rows["sample_index"] = number
    rows["device_time"] = number * 1_000_000
    stamps = ("device_time", "received_at", "computed_at", "sent_at")
    for (before, name), wait in zip(itertools.pairwise(stamps), noise, strict=False):
        rows[name] = rows[before] + wait.astype(np.int64)
    for name in stamps[1:]:
        rows[name] += 10**12
    rows["lateness"] = noise[3]
    rows["command_sequence"] = number % 65536
    rows["command_active"] = (number - 2) % 65536
    rows["command_age"] = np.where(number < 2, NO_AGE, 1)
    return rows


def draw(rows: Any, fit: Any, name: str) -> Picture:
    found = ledger(rows, fit, 1e6)
    return Timing(found, summarise(found, None), name=name).plot()


@pytest.mark.parametrize(
    ("fit", "count", "spread"),
    first_by_default([(FIT, 0, 0.0), *itertools.product((FIT, None), (1, 2_001), (0.0, 1.0, -3.0))], 4),
)
def test_any_ledger_can_be_composed(count: int, fit: Any, spread: float) -> None:
    """No tick, one tick, no elapsed time (virtual time), or effects before causes (wrong clocks)."""
    figure = check_axes(draw(rows_of(count, spread=spread), fit, "\udcff").figure)
    assert figure._suptitle.get_text() == "\udcff"
    assert all(axes.lines or axes.patches or axes.texts for axes in figure.axes[:2]), "or it says why not"
