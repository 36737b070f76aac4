"""The view of recordings: list, cut, replay, export and delete them; pages cannot name files elsewhere."""

import io
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from rig import config
from rig.config import presets
from rig.core.errors import ConfigError, RecordingError
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.trials.replay import replay
from rig.extras.console import recording_errands
from rig.extras.console.follow import Followed
from rig.extras.console.live import Live
from rig.extras.console.recordings import TRASH, Recordings
from rig.extras.console.terminal import Terminal
from rig.realtime.hand import SharedHand
from rig.recording._capture import write_capture
from rig.recording._parquet import write_parquet
from rig.recording.data import Recording
from rig.recording.export import export
from rig.recording.reader import open_recording
from rig.views.plots import style
from tests.conformance.tiers import first_by_default
from tests.extras.console.console_fakes import Page, ask, frame_of, run, shared

SHORT = {"trial.duration_s": 0.3, "verdict.tail_s": 0.1, "homing.settle_s": 0.02}
SHORT |= {"controller.position_rate": 10_000, "controller.velocity_rate": 2000}  # fewer rows
HOSTILE = [
    "../x.parquet", "/etc/passwd", "", ".", "..", "trash", "link.parquet", ".hidden.parquet", "a\0b",
    "x" * 999,
]  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    experiment = config.override(presets.load("koul-compliant"), SHORT)
    (done,) = hit(HitRequest(experiment=experiment, output=tmp_path_factory.mktemp("hit"), name="one"), admit)
    return done.path


@pytest.fixture
def output(recorded: Path, tmp_path: Path) -> Path:
    """A directory with one recording and its picture."""
    output = tmp_path / "recordings"
    output.mkdir()
    shutil.copy(recorded, output / "one.parquet")
    (output / "one.png").write_bytes(b"a picture")
    return output


def fetch(output: Path, path: str) -> Any:
    return run(lambda: Recordings(shared(output)).download(path))


def asked(output: Path, do: str, **content: Any) -> Any:
    return run(lambda: ask(Recordings(shared(output)), Page(), do, **content))


# The list -------------------------------------------------------------------------------------------


def listed(output: Path, **options: Any) -> Any:
    return asked(output, "recordings", **options)


def test_the_list_shows_verdict_settings_and_whether_there_is_a_picture(output: Path, recorded: Path) -> None:
    (one,) = listed(output)["recordings"]
    whole = open_recording(recorded)
    wall, rates = whole.experiment["wall"], whole.experiment["controller"]
    assert (one["name"], one["problem"], one["picture"]) == ("one.parquet", None, True)
    assert one["kind"] == (whole.trailer or {})["verdict"]["kind"]
    assert (one["stiffness"], one["damping"]) == (wall["stiffness"], wall["damping"])
    assert (one["position_rate"], one["estimator"]) == (rates["position_rate"], rates["estimator"])


def test_an_unreadable_file_is_listed_with_its_reason_and_its_name_stays_text(output: Path) -> None:
    (output / "<script>alert(1)<.parquet").write_bytes(b"no recording")
    (output / "empty.rigcap").write_bytes(b"")
    (output / "notes.txt").write_text("not listed")
    (output / "link.parquet").symlink_to(output / "one.parquet")
    listed_problems = {one["name"]: one["problem"] for one in listed(output)["recordings"]}
    assert listed_problems.pop("one.parquet") is None
    assert set(listed_problems) == {"<script>alert(1)<.parquet", "empty.rigcap", "link.parquet"}
    assert "is not a recording" in listed_problems["<script>alert(1)<.parquet"]
    assert "is empty" in listed_problems["empty.rigcap"]
    assert "link" in listed_problems["link.parquet"]


def test_the_list_comes_newest_first_page_by_page_and_a_search_wants_every_word(
    output: Path, recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_errands, "PAGE", 2)
    whole = open_recording(recorded)
    for number, kind in enumerate(("stable", "unstable", "stable")):
        trailer = {**(whole.trailer or {}), "verdict": {"kind": kind, "reasons": []}}
        with open(output / f"hit-{number}.parquet", "wb") as file:
            write_parquet(file, replace(whole, trailer=trailer))
    names = [one["name"] for one in listed(output)["recordings"]]
    assert names == ["hit-2.parquet", "hit-1.parquet"]
    rest = listed(output, first=2)
    assert ([one["name"] for one in rest["recordings"]], rest["more"]) == (
        ["hit-0.parquet", "one.parquet"],
        False,
    )
    found = listed(output, search=f"UNSTABLE k={whole.experiment['wall']['stiffness']:g}")["recordings"]
    assert [one["name"] for one in found] == ["hit-1.parquet"]
    assert listed(output, search="unstable hit-2")["recordings"] == []


def test_a_capture_that_was_cut_off_is_listed_by_its_header(output: Path, recorded: Path) -> None:
    with open(output / "torn.rigcap", "wb") as file:
        write_capture(file, replace(open_recording(recorded), complete=False))
    (one,) = listed(output, search="torn")["recordings"]
    assert (one["problem"], one["kind"], one["rig"]) == (None, None, "koul-compliant")


@pytest.mark.parametrize(
    "odd",
    [{}, {"wall": [1], "controller": None, "trial": 3}, {"wall": {"stiffness": "soft", "damping": 10**400}}],
)
def test_a_header_that_another_program_wrote_does_not_keep_the_list_from_the_others(
    output: Path, recorded: Path, odd: dict[str, Any]
) -> None:
    whole = open_recording(recorded)
    with open(output / "odd.parquet", "wb") as file:
        write_parquet(file, replace(whole, header={**whole.header, "experiment": odd}))
    by_name = {one["name"]: one for one in listed(output, search="koul")["recordings"]}
    assert set(by_name) == {"one.parquet", "odd.parquet"}
    assert by_name["odd.parquet"]["stiffness"] is None


# One recording --------------------------------------------------------------------------------------


def test_a_cut_of_a_whole_recording_loses_no_spike_and_a_zoom_shows_every_row(output: Path) -> None:
    whole = open_recording(output / "one.parquet")
    columns = "velocity,effort_sent,handle_position_true"
    data = fetch(output, f"/recordings/one.parquet/cut?columns={columns}&first=0&last=1e9").body
    header, low, high, times = frame_of(data)
    assert header["step"] == -(-len(whole) // recording_errands.POINTS) > 1
    assert len(times) <= recording_errands.POINTS
    for name in columns.split(","):
        assert low[name].min() == np.nanmin(whole.rows[name])
        assert high[name].max() == np.nanmax(whole.rows[name])
        assert (low[name] <= high[name]).all()
    first, last = whole.time_s[[100, 200]].tolist()
    header, low, high, times = frame_of(
        fetch(output, f"/recordings/one.parquet/cut?columns=velocity&first={first!r}&last={last!r}").body
    )
    assert header["step"] == 1
    assert times.tolist() == whole.time_s[100:201].tolist()
    assert low["velocity"].tolist() == high["velocity"].tolist() == whole.rows["velocity"][100:201].tolist()


def test_a_replay_lies_over_the_same_times_and_says_how_far_it_is_apart(output: Path) -> None:
    whole = open_recording(output / "one.parquet")
    stretch = "first=0.1&last=0.12"
    for estimator, exact in ((whole.experiment["controller"]["estimator"], True), ("fdm", False)):
        data = fetch(output, f"/recordings/one.parquet/cut?{stretch}&estimator={estimator}").body
        header, low, _, times = frame_of(data)
        expected = replay(whole, {"controller.estimator": estimator})
        shown = (whole.time_s >= 0.1) & (whole.time_s <= 0.12)
        assert (header["exact"], header["estimator"]) == (exact, estimator)
        assert header["velocity_difference"] == expected.velocity_difference
        assert times.tolist() == whole.time_s[shown].tolist()
        assert low["velocity"].tolist() == expected.rows["velocity"][shown].tolist()
        assert low["effort_sent"].tolist() == expected.rows["effort_sent"][shown].tolist()


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("cut", "no valid time span"),
        ("cut?first=0&last=x", "no valid time span"),
        ("cut?first=0&last=1&columns=nothing", "no column 'nothing'"),
        ("cut?first=0&last=1&estimator=unknown", "unknown"),
        ("export?form=exe", "'exe' is not an export format"),
    ],
)
def test_a_wrong_request_is_refused_with_a_remedy(output: Path, what: str, reason: str) -> None:
    with pytest.raises((ConfigError, RecordingError), match=reason) as refused:
        fetch(output, f"/recordings/one.parquet/{what}")
    assert refused.value.remedy


@pytest.mark.parametrize("form", first_by_default(["csv", "mat", "parquet"]))
def test_an_export_is_that_of_the_command(output: Path, tmp_path: Path, form: str) -> None:
    path = export(output / "one.parquet", tmp_path / f"exported.{form}")
    found = fetch(output, f"/recordings/one.parquet/export?form={form}").body
    if form == "mat":  # its text header has the time of day
        assert len(found) == path.stat().st_size
    else:
        assert found == path.read_bytes()
    if form == "csv":
        sidecar = fetch(output, "/recordings/one.parquet/export?form=json")
        assert sidecar.body == (tmp_path / "exported.csv.json").read_bytes()


def test_a_picture_is_given_or_drawn_on_request(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "DPI", 10)
    # The layout engine would draw everything once more.
    monkeypatch.setattr("matplotlib.figure.Figure.get_layout_engine", lambda _: None)
    assert fetch(output, "/recordings/one.parquet/picture").body == b"a picture"
    (output / "one.png").unlink()
    with pytest.raises(ConfigError, match="no picture"):
        fetch(output, "/recordings/one.parquet/picture")
    drawn = fetch(output, "/recordings/one.parquet/picture?draw=1")
    assert (drawn.kind, drawn.body) == ("image/png", (output / "one.png").read_bytes())
    assert drawn.body.startswith(b"\x89PNG")


# Cuts --------------------------------------------------------------------------------------------


async def test_the_visible_part_of_a_recording_is_saved_as_one(output: Path) -> None:
    service, page = Recordings(shared(output)), Page("operator")
    saved = await ask(service, page, "recording-cut", name="one.parquet", first_s=0.05, last_s=0.15)
    with pytest.raises(RecordingError, match="fewer than 2 rows"):
        await ask(service, page, "recording-cut", name="one.parquet", first_s=50.0, last_s=60.0)
    with pytest.raises(ConfigError, match="another page operates"):
        await ask(service, Page("another"), "recording-cut", name="one.parquet", first_s=0.0, last_s=1.0)
    facts = await ask(service, page, "recording", name=saved["name"])
    assert (saved["name"], saved["no_replay"]) == ("one-cut.parquet", "")
    assert (facts["kind"], facts["ended"], facts["rows"]) == (None, "cut", saved["rows"])
    assert facts["cut"]["recording"] == "one.parquet"
    assert facts["length_s"] == pytest.approx(0.1, abs=0.002)


async def test_a_live_run_is_cut_from_its_recording_once_it_has_ended(output: Path) -> None:
    whole = open_recording(output / "one.parquet")
    page = Page()
    with SharedHand.create(output / "hand") as hand:
        live = Live(shared(output), hand, Terminal(), own=True)
        with pytest.raises(ConfigError, match="no run with a recording"):
            await ask(live, page, "cut", first_s=0.0, last_s=1.0)
        seen = SimpleNamespace(ended=False, info={"recording": str(output / "one.rigcap")})
        live._followed = cast("Followed", seen)
        with pytest.raises(ConfigError, match="only a part of a complete recording can be saved"):
            await ask(live, page, "cut", first_s=0.0, last_s=1.0)
        seen.ended = True
        live._history.start_ns = int(whole.rows["device_time"][30])  # the first row that we saw
        saved = await ask(live, page, "cut", first_s=0.0, last_s=0.1)
    made = open_recording(output / saved["name"])
    assert made.rows["tick"][0] == 30
    assert made.time_s[-1] == pytest.approx(0.1, abs=0.002)


# Names and the trash --------------------------------------------------------------------------------


@pytest.mark.parametrize("do", ["recording", "throw-away", "restore"])
def test_a_name_is_of_a_file_in_the_directory_or_nothing_happens(output: Path, do: str) -> None:
    outside = output.parent / "x.parquet"
    outside.write_bytes(b"another file")
    (output / "link.parquet").symlink_to(outside)
    (output / ".hidden.parquet").write_bytes(b"hidden")
    (output / TRASH).mkdir()
    before = sorted(output.parent.rglob("*"))
    for name in HOSTILE:
        with pytest.raises(ConfigError, match="is not the name of a file in"):
            asked(output, do, name=name)
    assert sorted(output.parent.rglob("*")) == before


@pytest.mark.parametrize(
    "path",
    [
        "/recordings/..%2Fx.parquet/picture", "/recordings/%2Fetc%2Fpasswd/picture", "/recordings/link.parquet/picture",
        "/recordings/one.parquet/picture?map=..", "/recordings/one.parquet/picture?map=..%2F..", "/recordings/%00/cut",
    ],
)  # fmt: skip
def test_a_download_leads_out_of_no_directory(output: Path, path: str) -> None:
    (output.parent / "x.parquet").write_bytes(b"another file")
    (output / "link.parquet").symlink_to(output.parent / "x.parquet")
    with pytest.raises(ConfigError, match=r"is not the name of a (file|directory) in"):
        fetch(output, path)


def test_a_recording_of_a_map_on_a_device_is_found_with_its_map(output: Path) -> None:
    hits = output.parent / "maps" / "zwidth-of-a-rig" / "hits"
    hits.mkdir(parents=True)
    shutil.copy(output / "one.parquet", hits / "hit.parquet")
    facts = asked(output, "recording", name="hit.parquet", map="zwidth-of-a-rig")
    assert (facts["name"], facts["map"], facts["complete"]) == ("hit.parquet", "zwidth-of-a-rig", True)
    assert {"fdm", "kalman"} <= set(facts["estimators"])


async def test_nothing_is_deleted_a_recording_moves_with_its_picture_and_comes_back(output: Path) -> None:
    kept = {name: (output / name).read_bytes() for name in ("one.parquet", "one.png")}
    trash = output / TRASH

    service, page = Recordings(shared(output)), Page()
    await ask(service, page, "throw-away", name="one.parquet")
    assert {path.name: path.read_bytes() for path in trash.iterdir()} == kept
    assert [path.name for path in output.iterdir()] == [TRASH]
    listed = await ask(service, page, "recordings", trash=True)
    assert [one["name"] for one in listed["recordings"]] == ["one.parquet"]
    await ask(service, page, "restore", name="one.parquet")
    assert {path.name: path.read_bytes() for path in output.iterdir() if path.is_file()} == kept
    assert list(trash.iterdir()) == []


@pytest.mark.parametrize("do", ["throw-away", "restore", "recording"])
@pytest.mark.parametrize("name", ["one.png", "notes.txt"])
def test_a_file_that_is_no_recording_is_out_of_reach_of_a_page(name: str, do: str, output: Path) -> None:
    place = output / TRASH if do == "restore" else output
    place.mkdir(exist_ok=True)
    (place / name).write_bytes(b"another file")
    with pytest.raises(ConfigError, match="is not a recording"):
        asked(output, do, name=name)
    assert (place / name).read_bytes() == b"another file"


async def test_neither_way_goes_over_a_file_of_that_name(output: Path) -> None:
    service, page = Recordings(shared(output)), Page()
    await ask(service, page, "throw-away", name="one.parquet")
    (output / "one.parquet").write_bytes(b"another")
    with pytest.raises(RecordingError, match="exists"):
        await ask(service, page, "restore", name="one.parquet")
    await ask(service, page, "throw-away", name="one.parquet")
    assert {path.name for path in (output / TRASH).iterdir()} == {"one.parquet", "one.png", "one-2.parquet"}
    assert (output / TRASH / "one-2.parquet").read_bytes() == b"another"


def test_a_trash_that_leads_elsewhere_takes_and_gives_nothing(output: Path) -> None:
    (output / TRASH).symlink_to(output.parent)
    (output.parent / "of-another.parquet").write_bytes(b"elsewhere")
    with pytest.raises(ConfigError, match="is a symbolic link"):
        asked(output, "restore", name="of-another.parquet")
    assert (output.parent / "of-another.parquet").exists()
    with pytest.raises(ConfigError, match="is a symbolic link"):
        asked(output, "throw-away", name="one.parquet")
    assert (output / "one.parquet").exists()


def test_a_file_that_is_being_recorded_stays(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Loop:
        info = {"recording": str((output / "one.parquet").resolve())}  # noqa: RUF012

    monkeypatch.setattr("rig.extras.console.recordings.running", lambda *, done: [Loop()])
    with pytest.raises(ConfigError, match="is still being recorded"):
        asked(output, "throw-away", name="one.parquet")
    assert (output / "one.parquet").exists()


async def test_a_page_that_does_not_operate_moves_nothing(output: Path) -> None:
    service = Recordings(shared(output))
    await ask(service, Page("operator"), "throw-away", name="one.parquet")
    for do in ("throw-away", "restore"):
        with pytest.raises(ConfigError, match="another page operates"):
            await ask(service, Page("another"), do, name="one.parquet")


def test_a_recording_with_gaps_of_truth_is_cut_where_there_are_numbers(output: Path) -> None:
    whole = open_recording(output / "one.parquet")
    rows = whole.rows.copy()
    rows["handle_position_true"][::3] = np.nan
    holed = Recording(whole.header, rows, whole.trailer, path=output / "holed.parquet")
    file = io.BytesIO()
    write_parquet(file, holed)
    (output / "holed.parquet").write_bytes(file.getvalue())
    data = fetch(output, "/recordings/holed.parquet/cut?columns=handle_position_true&first=0&last=9").body
    header, low, *_ = frame_of(data)
    assert header["step"] > 3
    assert not np.isnan(low["handle_position_true"]).any()
