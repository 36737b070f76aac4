"""The view of maps: a page receives each cell of a growing map once, and starts the same map as the command."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import rig.cli
from rig.core.errors import ConfigError, RecordingError
from rig.experiments.mapping import _maps as maps
from rig.experiments.mapping import interface
from rig.experiments.sweep import run_here
from rig.experiments.sweep._journal import Journal, read_on
from rig.extras.console import map_errands, map_jobs
from rig.extras.console.maps import MapService
from rig.extras.console.requests import request_of
from rig.recording.reader import open_recording
from tests.conformance.maps import SHORT, short_map
from tests.conformance.tiers import first_by_default
from tests.extras.console.console_fakes import Page, ask, run, shared

PLAN = short_map(0.1, 0.6)
NAME = "zwidth-of-a-test"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory of a console with a finished map."""
    root = tmp_path_factory.mktemp("console")
    maps.map_into(PLAN, root / "maps" / NAME)
    return root


class FakeTalk:
    """A fake of a job's connection to its console."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, dict[str, Any]]] = []

    def tell(self, say: str, **content: Any) -> None:
        self.sent.append((say, content))

    def progress(self, **content: Any) -> None:
        self.sent.append(("progress", content))


def job_content(**fields: Any) -> dict[str, Any]:
    """Return the content of the job that a page's request starts."""
    request = request_of(
        json.dumps({"do": "map-run", **fields}),
        {"map-run": MapService(shared(Path("out"))).handlers()["map-run"][0]},
    )
    return asdict(request)


async def test_a_page_receives_the_plan_then_every_cell_by_criterion(root: Path) -> None:
    page, service = Page(), MapService(shared(root / "recordings"))
    facts = await ask(service, page, "map-watch", map=NAME)
    while not page.messages:
        await ask(service, page, "maps")
    await service.close()
    assert (facts["dampings"], facts["ratio"], facts["stripes"]) == (
        [0.0, 0.3], 3.0, ["zero at 0.1 count", "zero at 0.6 count"],
    )  # fmt: skip
    assert facts["units"] == {"stiffness": "N·m/rad", "damping": "N·m·s/rad"}
    (cells,) = page.messages
    assert (cells["say"], cells["map"], cells["anew"]) == ("cells", NAME, True)
    assert (cells["state"], cells["done"], cells["total"]) == ("finished", 4, 4)
    found = maps.map_into(PLAN, root / "maps" / NAME)
    by_key = {series.key: (series, rows) for series, rows in zip(PLAN.series(), found.series, strict=True)}
    for column in cells["columns"]:  # in the order in which they were done
        series, rows = by_key.pop(column["key"])
        place = PLAN.dampings[column["damping"]], PLAN.offsets[column["stripe"]]
        assert place == (series.damping, series.offset)
        for cell, row in zip(column["cells"], rows, strict=True):
            assert cell[0] == row["stiffness"]
            assert map_errands.KINDS[cell[1]] == row["kind_true"]
            passes = {True: 0, None: 3, False: 2 if row["kind_true"] == "unstable" else 1}
            assert cell[2:] == [passes[row[f"passes_{name}_true"]] for name in facts["criteria"]]


def test_lines_of_a_journal_are_sent_once_and_its_writer_makes_it_running(root: Path, tmp_path: Path) -> None:
    there, growing = root / "maps" / NAME, tmp_path / "growing"
    growing.mkdir()
    (growing / maps.PLAN).write_bytes((there / maps.PLAN).read_bytes())
    lines = (there / maps.JOURNAL).read_bytes().splitlines(keepends=True)
    first = map_errands.growth(str(growing), 0)
    assert (first["columns"], first["place"], first["state"]) == ([], 0, "stopped")
    (growing / maps.JOURNAL).write_bytes(b"".join(lines[:2]))
    one = map_errands.growth(str(growing), first["place"])
    assert [column["key"] for column in one["columns"]] == [json.loads(lines[1][9:])["key"]]
    (growing / maps.JOURNAL).write_bytes(b"".join(lines))
    tasks = PLAN.tasks
    plan = json.loads(lines[0][9:])
    held = Journal(
        growing / maps.JOURNAL, {k: v for k, v in plan.items() if k != "sweep"}, [t.key for t in tasks]
    )
    try:
        rest = map_errands.growth(str(growing), one["place"])
    finally:
        held.close()
    assert (len(rest["columns"]), rest["state"]) == (3, "running")
    assert map_errands.growth(str(growing), rest["place"])["state"] == "stopped"


def test_theory_is_sent_along_the_dampings_of_the_map(root: Path) -> None:
    (curve,) = map_errands.theory(str(root / "maps" / NAME))
    assert (curve["damping"][0], curve["damping"][-1]) == (0.0, 0.3)
    assert min(curve["stiffness"]) > 0.0


async def test_a_click_on_a_cell_makes_that_hit_a_recording_where_the_others_are(root: Path) -> None:
    ((key, rows), *_), _ = read_on(root / "maps" / NAME / maps.JOURNAL)
    service = MapService(shared(root / "recordings"))
    which = await ask(service, Page(), "map-hit", map=NAME, key=key, stiffness=rows[-1]["stiffness"])
    assert which["map"] == ""
    opened = open_recording(root / "recordings" / which["name"])
    assert (opened.trailer or {})["verdict"]["peak_penetration"] == rows[-1]["peak_penetration"]


def test_a_hit_of_a_device_is_the_recording_that_it_left(tmp_path: Path) -> None:
    place, series = tmp_path / "maps" / "of-a-rig", PLAN.series()[0]
    maps._write_plan(PLAN, place, "serial:///dev/rig")
    row = {"stiffness": 10.0, "recording": "koul-1.parquet", "kind": "stable"}
    task = replace(PLAN.tasks[0], key=series.key)
    run_here("serial:///dev/rig", lambda task: [row], [task], journal=place / maps.JOURNAL)
    with pytest.raises(RecordingError, match=r"recording koul-1\.parquet is missing"):
        map_errands.find_recording(str(place), series.key, 10.0, str(tmp_path / "out"))
    (place / maps.RECORDINGS).mkdir()
    (place / maps.RECORDINGS / "koul-1.parquet").touch()
    found = map_errands.find_recording(str(place), series.key, 10.0, str(tmp_path / "out"))
    assert found == {"name": "koul-1.parquet", "map": "of-a-rig"}
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("key", "stiffness"), [("9/0.0/0.1/0", 10.0), ("0/0.0/0.1/0", 10.5), ("../x", 10.0)])
def test_a_hit_that_the_map_does_not_have_is_refused(root: Path, key: str, stiffness: float) -> None:
    with pytest.raises(ConfigError, match="no hit"):
        map_errands.find_recording(str(root / "maps" / NAME), key, stiffness, str(root / "nowhere"))
    assert not (root / "nowhere").exists()


def test_a_map_is_named_inside_its_directory_or_not_at_all(root: Path) -> None:
    (root / "maps" / "link").symlink_to(root / "maps" / NAME)
    hostile = ("..", "../maps", "/etc", ".", f"{NAME}/..", "a\0b", "<script>", "link")
    for do, names in (("map-watch", hostile), ("map-theory", ("", *hostile))):
        for name in names:
            with pytest.raises(ConfigError, match="is not the name of a directory in"):
                run(
                    lambda do=do, name=name: ask(
                        MapService(shared(root / "recordings")), Page(), do, map=name
                    )
                )


def test_a_damaged_plan_is_listed_with_its_reason(root: Path) -> None:
    broken = root / "maps" / "<b>broken"
    broken.mkdir()
    (broken / maps.PLAN).write_text("{")
    listed = {one["name"]: one for one in map_errands.directories(str(root / "maps"))}
    assert "is damaged" in listed["<b>broken"]["problem"]
    assert (listed[NAME]["problem"], listed[NAME]["state"]) == (None, "finished")


@pytest.mark.parametrize(
    ("options", "fields"),
    first_by_default([
        (["zwidth", "-B", "0"], {"damping": "0"}),
        (["zwidth", "-B", "0,0.3", "--scheme", "uniform:20k"], {"damping": "0,0.3", "schemes": ["uniform:20k"]}),
        (
            ["zwidth", "-B", "0:1:3", "--scheme", "dual:20k/2k", "-K", "20:200", "--search", "grid", "--ratio", "1.5",
             "--offsets", "0.2", "--repeats", "2", "--judge", "recorded", "--set", "trial.seed=3"],
            {"damping": "0:1:3", "schemes": ["dual:20k/2k"], "stiffness": "20:200", "way": "grid", "ratio": 1.5,
             "offsets": "0.2", "repeats": 2, "judged": "recorded", "changes": {"trial.seed": 3}},
        ),
        (
            ["impedance", "map", "-K", "500:5000:4", "-B", "0:4:3", "--realisations", "1"],
            {"domain": "frequency", "rig": "chawda-linear", "stiffness": "500:5000:4", "damping": "0:4:3",
             "changes": {"excitation.realisations": 1}},
        ),
    ], 3),
)  # fmt: skip
def test_the_page_starts_the_map_that_the_command_starts(
    options: list[str], fields: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, Path]] = []

    def map_into(plan: Any, place: Path, **_: Any) -> Any:
        asked.append((plan, place))
        raise ConfigError("not in this test")

    monkeypatch.setattr(interface, "map_into", map_into)
    CliRunner().invoke(rig.cli.rig, [*options, "-o", str(tmp_path)])
    # The page's choice.
    held = {} if fields.get("domain") else {"trial.kind": "human", "operator.grip": "normal"}
    content = job_content(**{**fields, "changes": {**held, **fields.get("changes", {})}})
    with pytest.raises(ConfigError, match="not in this test"):
        map_jobs.zwidth({**content, "output": str(tmp_path)}, FakeTalk())
    (by_command, there), (by_page, here) = asked
    assert by_page == by_command
    assert here == there


def test_a_job_names_its_directory_once_it_is_there_and_ends_with_it(tmp_path: Path) -> None:
    fields = {
        "damping": "0",
        "schemes": ["uniform:20k"],
        "stiffness": "10:20",
        "ratio": 3.0,
        "offsets": "0.1",
    }
    talk = FakeTalk()
    done = map_jobs.zwidth({**job_content(**fields, changes=SHORT), "output": str(tmp_path)}, talk)
    (named,) = [content["map"] for say, content in talk.sent if say == "mapping"]
    assert done == {"map": named}
    assert map_errands.growth(str(tmp_path / named), 0)["state"] == "finished"


async def test_only_the_operating_page_starts_and_ends_maps_and_no_page_chooses_a_program(root: Path) -> None:
    common = shared(root / "recordings")
    service = MapService(common)
    with pytest.raises(ConfigError, match=r"wall\.law cannot be changed from a page"):
        await ask(service, Page("operator"), "map-run", changes={"wall.law": "x"})
    with pytest.raises(ConfigError, match="no map started by this console"):
        await ask(service, Page("operator"), "map-end")
    for do in ("map-run", "map-end"):
        with pytest.raises(ConfigError, match="another page operates"):
            await ask(service, Page("another"), do)
    assert common.jobs.running is None
