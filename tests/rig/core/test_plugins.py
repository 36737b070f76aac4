"""Third-party plug-ins: a broken one is listed with the reason, and does not break the others."""

import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

import rig.cli
from rig.control import estimators, laws
from rig.core import plugins
from rig.core.errors import ConfigError

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
