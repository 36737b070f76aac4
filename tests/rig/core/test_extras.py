"""Extras and plug-ins: a missing or broken one is refused by name, nothing replaces it, and the others work."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from rig import devices
from rig.cli import _listing as listing
from rig.control import estimators, laws
from rig.core import extras, plugins
from rig.core.errors import ConfigError, RigError
from rig.core.shown import Drawn, plot
from rig.experiments.sweep._executors import executor_for
from rig.realtime.control_words import LOOP_DONE, STOP
from rig.realtime.ring import Ring

Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Yield a function that adds an extra to an empty tree, given its table as text or as JSON data."""

    def folder(name: str, table: Any = None) -> Path:
        place = tmp_path / "extras" / name
        place.mkdir(parents=True)
        (place / "__init__.py").touch()
        if table is not None:
            (place / "table.json").write_text(table if isinstance(table, str) else json.dumps(table))
        extras.tables.cache_clear()
        listing.commands.cache_clear()
        return place

    monkeypatch.setattr(extras, "ROOMS", str(tmp_path))
    extras.tables.cache_clear()
    listing.commands.cache_clear()
    yield folder
    extras.tables.cache_clear()
    listing.commands.cache_clear()


def row(target: str = "json:dumps", **more: Any) -> dict[str, Any]:
    return {"target": target, **more}


BROKEN = {
    "no table": None,
    "no JSON": "{",
    "no table of tables": "[]",
    "no rows": {"schemes": 1},
    "an unknown kind": {"scheme": {"moteus": row()}},
    "no target": {"schemes": {"moteus": {}}},
    "a target that is no name": {"schemes": {"moteus": row("json")}},
    "a target that is no text": {"schemes": {"moteus": row(3)}},  # type: ignore[arg-type]
    "a name that another extra has": {"executors": {"dask": row()}},
}


@pytest.mark.parametrize("table", BROKEN.values(), ids=BROKEN)
def test_a_broken_extra_is_refused_by_name_and_the_others_work(table: Any, install: Install) -> None:
    install("cluster", {"executors": {"dask": row()}})
    install("drives", table)
    assert extras.load("executors", "dask") is json.dumps
    assert list(extras.broken()) == ["drives"]
    with pytest.raises(ConfigError, match=r"the extra drives is broken: .") as caught:
        extras.load("schemes", "moteus")
    assert caught.value.remedy


def test_a_table_that_would_wait_for_a_writer_is_not_read(install: Install) -> None:
    os.mkfifo(install("drives") / "table.json")
    assert list(extras.broken()) == ["drives"]


def test_an_empty_folder_of_a_deleted_extra_is_ignored(install: Install) -> None:
    (install("drives") / "__init__.py").unlink()
    extras.tables.cache_clear()
    assert extras.tables() == ()


@pytest.mark.parametrize("table", [None, "{"], ids=["missing", "broken"])
def test_a_drive_whose_extra_is_gone_is_refused_and_never_another_rig(
    table: str | None, install: Install, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if table is not None:
        install("drives", table)

    def entry(name: str) -> Any:
        return type(
            "Point", (), {"name": name, "value": "json:dumps", "dist": None, "load": lambda _: json.dumps}
        )()

    monkeypatch.setattr(plugins, "entry_points", lambda group: (entry("moteus"), entry("odrive")))
    listed = {backend.scheme for backend in devices.backends()}
    assert listed == {*devices.BUILT_IN, *(devices.RESERVED if extras.broken() else ())}
    for scheme in devices.RESERVED:
        for opens in (devices.open_link, devices.is_made_for_a_rig):
            with pytest.raises(ConfigError, match=rf"URL scheme {scheme}: .*the extra drives"):
                opens(f"{scheme}://can0")
        assert "the extra drives" in devices.broken(scheme)
    assert rig.cli.run(["hit", "--url", "moteus:///dev/fdcanusb", "--verified"]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert "the extra drives" in output.err
    assert "install haptic-rig" in output.err


def test_no_table_replaces_a_built_in_scheme(install: Install) -> None:
    install("drives", {"schemes": {"sim": row(), "serial": row()}})
    assert {one.scheme: one.target for one in devices.backends()} == devices.BUILT_IN
    assert devices.load_backend("sim://") is devices.loaded(devices.BUILT_IN["sim"])
    assert devices.is_made_for_a_rig("sim://")
    assert not devices.is_made_for_a_rig("serial:///dev/ttyACM0")


def test_a_scheme_has_its_system_and_whether_it_is_made_for_a_rig(install: Install) -> None:
    rows = {"odrive": row(platform="plan9", made_for_a_rig=True), "can": row(platform=sys.platform)}
    install("drives", {"schemes": rows})
    assert {backend.scheme for backend in devices.backends()} == {*devices.BUILT_IN, "can"}
    assert devices.is_made_for_a_rig("odrive://can0")
    assert not devices.is_made_for_a_rig("can://0")
    with pytest.raises(ConfigError, match="no backend for odrive://"):
        devices.open_link("odrive://can0")


def test_a_scheduler_is_refused_without_its_extra_or_a_target_that_loads(install: Install) -> None:
    with pytest.raises(ConfigError, match="executor of sweeps dask: no installed extra has it"):
        executor_for("tcp://127.0.0.1:1", None)
    install("cluster", {"executors": {"dask": row("no_such_module_here:Cluster")}})
    with pytest.raises(ConfigError, match="cannot import no_such_module_here:Cluster of the extra cluster"):
        executor_for("tcp://127.0.0.1:1", None)


# ---------------------------------------------------------------------- commands, each in a process of its own


def run(rooms: Path, *words: str | Path, before: str = "") -> subprocess.CompletedProcess[str]:
    """Run ``rig`` with the extras of another tree."""
    other = f"from rig.core import extras; extras.ROOMS = {str(rooms)!r}"
    code = f"{other}\n{before}\nfrom rig.__main__ import main; main()"
    return subprocess.run(
        [sys.executable, "-P", "-c", code, *words], capture_output=True, text=True, timeout=60, check=False
    )


def test_help_works_beside_broken_extras_and_names_them(install: Install, tmp_path: Path) -> None:
    install("console", "{")
    install("lsl", {"commands": {"serve lsl": row("no_such_module_here:lsl", before="docs")}})
    shown = run(tmp_path, "--help")
    assert shown.returncode == 0, shown.stderr
    assert "Broken extras:\n  console" in shown.stdout
    refused = run(tmp_path, "serve", "lsl")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "of the extra lsl" in refused.stderr


@pytest.mark.exhaustive("tests/test_house.py::test_no_way_around_the_contracts_by_string")
def test_the_core_hits_where_no_extra_can_be_imported(tmp_path: Path) -> None:
    hidden = f"import os, sys; sys.modules['rig.extras'] = None; os.chdir({str(tmp_path)!r})"
    hit = run(tmp_path, "hit", "--json", "--no-plot", before=hidden)
    assert hit.returncode == 0, hit.stderr
    (recording,) = tmp_path.glob("recordings/*.parquet")
    replay = run(tmp_path, "recording", "replay", recording, before=hidden)
    assert replay.returncode == 0, replay.stderr


def test_stop_waits_for_no_extra(install: Install, tmp_path: Path) -> None:
    hang = "import time; extras.tables = lambda: time.sleep(1e9)"
    with Ring.allocate(10, info={"url": "sim://"}, shared=True) as ring, ThreadPoolExecutor(1) as thread:
        stopped = thread.submit(run, tmp_path, "stop", str(os.getpid()), "--json", before=hang)
        while ring.peek(STOP) == 0 and not stopped.done():
            time.sleep(0.005)
        ring.put(LOOP_DONE, 1)  # as a loop that stops: the command waits for it
        assert stopped.result().returncode == 0, stopped.result().stderr


# ---------------------------------------------------------------------- the tables of this tree


def rows() -> list[tuple[str, extras.ExtraRow]]:
    return [
        (kind, one) for table in extras.tables() for kind in table.rows for one in table.rows[kind].values()
    ]


def test_every_table_of_this_tree_is_whole() -> None:
    assert extras.broken() == {}
    for kind, one in rows():
        assert callable(extras.load(kind, one.name)), one
        assert one.target.startswith((f"rig.extras.{one.extra}.", f"rig.{one.extra}.")), one
    assert set(extras.added("schemes")) <= set(devices.RESERVED)


def test_every_result_that_can_be_drawn_has_a_picture() -> None:
    def kinds(kind: type) -> set[str]:
        return {kind.__name__}.union(*map(kinds, kind.__subclasses__()))

    for name in rig.__all__:
        getattr(rig, name)
    for name in extras.added("pictures"):
        extras.load("pictures", name)
    assert kinds(Drawn) - {"Drawn"} == set(extras.added("pictures"))
    with pytest.raises(ConfigError, match="a dict cannot be drawn"):
        plot({})
    assert issubclass(ConfigError, RigError)


SOURCES = {
    "raises": "raise RuntimeError('built for another version')",
    "leaves": "raise SystemExit(3)",
    "empty": "",
    "wrong": "PART = 3",
}


@pytest.fixture(params=SOURCES)
def broken(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the name of a plug-in, offered to every group, that has no usable part."""
    name = f"theirs_{request.param}"
    (tmp_path / f"{name}.py").write_text(SOURCES[request.param])
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [EntryPoint("theirs", f"{name}:PART", group)])
    return name


@pytest.mark.parametrize("get", [estimators.get, laws.get])
def test_a_broken_plug_in_is_an_error_that_names_it(get: object, broken: str) -> None:
    assert callable(get)
    with pytest.raises(ConfigError, match=f"{broken}:PART") as caught:
        get("theirs")
    assert caught.value.remedy


@pytest.mark.parametrize("broken", ["raises"], indirect=True)
def test_the_lists_show_a_broken_plug_in_with_the_reason(
    broken: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rig.cli.run(["estimators", "list", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [fact["name"] for fact in shown] == [*estimators.BUILT_IN, "theirs"]
    assert [f"{broken}:PART" in fact.get("broken", "") for fact in shown] == [False] * (len(shown) - 1) + [
        True
    ]
    assert rig.cli.run(["estimators", "list", "theirs"]) == 2
    assert rig.cli.run(["device", "list", "--json"]) == 0
    backends = json.loads(capsys.readouterr().out)["backends"]
    assert [one["scheme"] for one in backends if one["broken"]] == ["theirs"]
    assert rig.cli.run(["device", "show", "theirs://x"]) == 2


def test_a_part_stays_registered_while_another_of_that_name_comes_and_goes() -> None:
    """Two programs in one process may run their laws at the same time, and end in any order."""
    one, two = laws.get("bilateral"), laws.get("excited")
    first = plugins.register_temporarily("rig.laws", laws.BUILT_IN, "ours", one)
    second = plugins.register_temporarily("rig.laws", laws.BUILT_IN, "ours", two)
    first.__enter__()
    second.__enter__()
    assert laws.get("ours") is two
    assert laws.names().count("ours") == 1
    first.__exit__(None, None, None)
    assert laws.get("ours") is two
    second.__exit__(None, None, None)
    with pytest.raises(ConfigError, match="unknown law 'ours'"):
        laws.get("ours")
    with (
        pytest.raises(ConfigError, match="'bilateral' is already the name"),
        plugins.register_temporarily("rig.laws", laws.BUILT_IN, "bilateral", one),
    ):
        pass
