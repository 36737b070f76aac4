"""A map on a device: recorded hits in place of simulated ones, a person who confirms them, and how a session ends."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.faults import Fault
from rig import config, devices
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError, GuardError, LinkLostError, PlanError, RigError, StoppedError
from rig.core.sample import Phase
from rig.devices.fault_script import DeviceFault, Faults
from rig.devices.framed import FramedDevice
from rig.experiments.hits import _on_device as on_device
from rig.experiments.hits._on_device import OnDevice
from rig.experiments.hits.hit import HitResult
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.experiments.mapping import _zwidth_rig as zwidth_rig
from rig.experiments.mapping._maps import zwidth
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping._zwidth_rig import DeviceMap, cooling_s, zwidth_on_rig
from rig.experiments.mapping.zwidth import TRUE, MapPlan
from rig.recording.reader import open_recording

SHORT = {"trial.duration_s": 0.4, "verdict.tail_s": 0.1, "homing.settle_s": 0.02, "trial.release_s": 0.01}
OFFSET = 0.25


def plan_map(changes: Any = None, **others: Any) -> Any:
    experiment = config.override(presets.load("koul-compliant"), {**SHORT, **(changes or {})})
    given = {
        "schemes": (Scheme.parse("dual:5k/1k"),),
        "dampings": (0.1, 0.4),
        "search": StiffnessSearch(way="bisection", lowest=20.0, highest=450.0, ratio=4.7),
        "offsets": (OFFSET,),
        "judged": "recorded",
    }
    return MapPlan(experiment=experiment, **{**given, **others})


class Person:
    """A simulated person who confirms `patience` hits and records requests, results and waiting times."""

    def __init__(self, patience: int = 10_000) -> None:
        self.patience = patience
        self.asked, self.results, self.waited_s = [], [], []

    def session(self, directory: Any, url: str = "sim://", **others: Any) -> Any:
        return DeviceMap(
            where=OnDevice(url=url, recordings=directory / "hits", **others),
            agrees=self._agrees,
            report=lambda asked, done, valid: self.results.append(str(done.kind)),
            pause=self.waited_s.append,
        )

    def _agrees(self, asked: Any) -> Any:
        self.asked.append(asked)
        return len(self.asked) <= self.patience


def kinds(found: Any, suffix: str = "") -> Any:
    return [(row["damping"], row["stiffness"], row[f"kind{suffix}"]) for row in found.table()]


# --- the same map ---------------------------------------------------------------------------------------------


START = HitSimulator(plan_map().experiment).start
# Within homing's tolerance a hit without bytes starts where its seed says; the device starts where it is.
URL = f"sim://?initial_position={START!r}"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a map over the byte link, the person who confirmed its hits, and the directory of their recordings."""
    place, person = tmp_path_factory.mktemp("whole"), Person()
    return zwidth_on_rig(plan_map(), person.session(place, URL)), person, place / "hits"


def test_over_the_byte_link_a_map_is_that_of_the_hits_without_bytes(whole: Any) -> None:
    found, person, hits = whole
    without_bytes = zwidth(plan_map())
    assert kinds(found) == kinds(without_bytes)
    assert kinds(found, TRUE) == kinds(without_bytes, TRUE)
    assert [b.stiffness for b in found.boundaries] == [b.stiffness for b in without_bytes.boundaries]
    assert len(person.asked) == len(person.results) == found.hits
    assert len(list(hits.glob("*.parquet"))) == found.hits
    # The next hit waits until the rig is calm.
    assert len(person.waited_s) == len(person.results)
    assert min(person.waited_s) >= zwidth_rig.CALM_S


# --- a person ---------------------------------------------------------------------------------------------------


def test_a_person_who_declines_ends_the_session_and_the_same_plan_resumes(whole: Any, tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    uninterrupted, confirming, _ = whole
    of_first_series = sum(asked.series == 1 for asked in confirming.asked)

    person = Person(patience=of_first_series + 1)
    with pytest.raises(StoppedError, match=r"1 of 2 series are done .*journal.*resumes from there"):
        zwidth_on_rig(plan_map(), person.session(tmp_path, URL), journal=journal)
    assert len(person.results) == of_first_series + 1, "nothing moves after the person has declined"
    assert json.loads(journal.read_bytes().split(b"\n")[0][9:])["work"] == URL
    with pytest.raises(ConfigError, match="another plan: work"):
        zwidth_on_rig(plan_map(), Person().session(tmp_path, "sim://koul-compliant"), journal=journal)

    again = Person()
    found = zwidth_on_rig(plan_map(), again.session(tmp_path, URL), journal=journal)
    assert again.asked[0].series == 2
    assert kinds(found) == kinds(uninterrupted)


def test_ctrl_c_at_the_question_is_a_stop_like_any_other(tmp_path: Path) -> None:
    def interrupted(asked: Any) -> None:
        raise KeyboardInterrupt

    session = replace(Person().session(tmp_path), agrees=interrupted)
    with pytest.raises(StoppedError, match="0 of 2 series are done"):
        zwidth_on_rig(plan_map(), session)


# --- hits that end otherwise ----------------------------------------------------------------------------------------


def test_a_wall_that_throws_the_handle_out_fails_and_the_session_continues(tmp_path: Path) -> None:
    narrow = {"rig.limits.position_minimum": -0.02, "rig.limits.position_maximum": 0.05, "trial.effort": 0.3}
    rungs = StiffnessSearch(lowest=38.0, highest=80.0, ratio=1.9)
    plan = plan_map(narrow, schemes=(Scheme.parse("uniform:1k"),), dampings=(0.0, 0.01), search=rungs)
    person = Person()
    found = zwidth_on_rig(plan, person.session(tmp_path))
    recordings = [open_recording(path) for path in sorted((tmp_path / "hits").glob("*.parquet"))]
    reasons = [recording.trailer["reason"] for recording in recordings]
    assert "out_of_window" in reasons or "device_fault" in reasons
    assert found.hits == len(person.asked) == 2
    assert [(row["kind"], row["passes_felt"]) for row in found.table()] == [("unstable", False)] * 2
    assert kinds(found) == kinds(zwidth(plan))


@pytest.mark.parametrize("error", [GuardError("did not reach the start"), LinkLostError("gone")])
def test_an_error_that_the_wall_did_not_cause_ends_the_session(
    error: RigError, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(request: Any, admit: Any) -> None:
        raise error

    monkeypatch.setattr(on_device, "hit", failing)
    with pytest.raises(type(error), match=str(error)):
        zwidth_on_rig(plan_map(), Person().session(tmp_path))


def test_a_hit_that_missed_ticks_ended_is_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The device misses ticks in the middle of the push; the map still equals that of an undisturbed session."""
    plan = plan_map(dampings=(0.1,), search=StiffnessSearch(lowest=100.0, highest=110.0, ratio=1.2))
    undisturbed = zwidth_on_rig(plan, Person().session(tmp_path / "undisturbed"))
    (path,) = (tmp_path / "undisturbed" / "hits").glob("*.parquet")
    rows = open_recording(path).rows
    middle = int(np.median(rows["sample_index"][rows["phase"] == Phase.TRIAL]))
    late = Faults(device=(DeviceFault(middle, Fault.TICK_OVERRUN),))
    hit, scripts = on_device.hit, [late]

    def disturbed(request: Any, admit: Any) -> Iterator[HitResult]:
        if not scripts:
            yield from hit(request, admit)
            return
        model = config.rig_model(request.experiment)
        with FramedDevice(devices.open_watched("sim://", model, scripts.pop())) as device:
            yield from hit(replace(request, device=device, reference_count=0), admit)

    monkeypatch.setattr(on_device, "hit", disturbed)
    person = Person()
    found = zwidth_on_rig(plan, person.session(tmp_path))
    assert [asked.attempt for asked in person.asked] == [1, 2]
    assert kinds(found) == kinds(undisturbed)
    reasons = [open_recording(one).trailer["reason"] for one in (tmp_path / "hits").glob("*.parquet")]
    assert sorted(reasons) == ["device_fault", "finished"]


def test_three_invalid_hits_of_one_wall_end_the_session_with_the_reason(tmp_path: Path) -> None:
    # A slew limit that binds in every hit makes another wall of it.
    person = Person()
    rungs = StiffnessSearch(lowest=400.0, highest=420.0, ratio=1.5)
    plan = plan_map({"rig.limits.slew": 200.0}, dampings=(0.0,), search=rungs)
    with pytest.raises(RigError, match=r"3 hits at K = 400, B = 0 were invalid.*slew limit acted") as caught:
        zwidth_on_rig(plan, person.session(tmp_path))
    assert not isinstance(caught.value, StoppedError)
    assert [asked.attempt for asked in person.asked] == [1, 2, 3]
    assert caught.value.recording.exists()


# --- the motor's heat ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rms", "nominal", "duration", "rest"),
    [(0.3, 0.1, 1.0, 8.0), (0.2, 0.1, 2.0, 6.0), (0.1, 0.1, 1.0, 0.0), (0.05, 0.1, 1.0, 0.0)],
)
def test_the_mean_heat_over_push_and_rest_is_that_of_the_nominal_effort(
    rms: float, nominal: float, duration: float, rest: float
) -> None:
    assert cooling_s(rms, nominal, duration) == pytest.approx(rest)


# --- a real device --------------------------------------------------------------------------------------------------


@pytest.fixture
def real_devices(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Open simulated devices that claim to be real, in virtual time; return the list of those opened."""
    open_simulated = devices.open_device
    opened = []

    def open_device(url: Any, model: Any = None) -> Any:
        device = open_simulated("sim://?initial_position=-0.004", model)
        device._dictionary = replace(device.dictionary, simulated=False)
        opened.append(device)
        return device

    monkeypatch.setattr(devices, "open_device", open_device)
    return opened


def test_a_real_device_stays_open_and_its_zero_where_it_was(tmp_path: Path, real_devices: Any) -> None:
    plan = plan_map(dampings=(0.1,))
    found = zwidth_on_rig(plan, Person().session(tmp_path, "serial:///dev/rig", verified=True))
    assert len(real_devices) == 1
    paths = sorted((tmp_path / "hits").glob("*.parquet"))
    recordings = [open_recording(path) for path in paths]
    assert len(recordings) == found.hits > 1
    assert {row["recording"] for row in found.table()} == {path.name for path in paths}
    zeros = {recording.header["identity"]["parameters"]["reference_count"] for recording in recordings}
    assert len(zeros) == 1
    assert zeros != {0}


def test_a_real_device_of_unverified_polarity_is_not_moved(tmp_path: Path, real_devices: Any) -> None:
    with pytest.raises(ConfigError, match="is not verified"):
        zwidth_on_rig(plan_map(), Person().session(tmp_path, "serial:///dev/rig"))
    assert not (tmp_path / "hits").exists()


# --- what is refused before anything moves -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plan", "text"),
    [
        ({"judged": "true"}, "set `judge` to recorded"),
        ({"offsets": (0.1, 0.6)}, "2 encoder offsets"),
        ({"schemes": (Scheme.parse("uniform:20k"),)}, r"uniform:20k.*20000.*`rate` 8000"),
        (
            {"search": StiffnessSearch(lowest=0.1, highest=10.0, ratio=2.0)},
            "K from 0.1 to .*peak penetration",
        ),
    ],
)
def test_a_map_beyond_the_device_is_refused_before_a_question(tmp_path: Path, plan: Any, text: str) -> None:
    person = Person()
    url = "sim://?position_rate_maximum=8000&position_rate_default=1000"
    with pytest.raises(PlanError, match=text):
        zwidth_on_rig(plan_map(**plan), person.session(tmp_path, url))
    assert person.asked == []
    assert not (tmp_path / "hits").exists()
