"""The table of device backends: valid and invalid URLs, third-party schemes, and device processes."""

import operator
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import rig.devices
from rig import config, devices
from rig.config import presets
from rig.core import plugins as core_plugins
from rig.core.errors import ConfigError, DeviceNotFoundError
from rig.core.process import start_announced
from rig.devices import local
from rig.devices.device import DeviceUrl
from rig.experiments.hits._on_device import OnDevice, examined
from sim_backend.ends.link import MemoryLink
from tests.conformance.census import children
from tests.conformance.firmware import need_compiler
from tests.conformance.rigs import rotary_rig


def point(name: str, value: str, distribution: str = "third-party") -> Any:
    """Return an entry point of a distribution; of none, as in a frozen program, without a name."""
    dist = SimpleNamespace(name=distribution) if distribution else None
    return EntryPoint(name, value, "rig.devices")._for(dist)  # type: ignore[attr-defined]


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Any:
    def install(*points: Any) -> None:
        of_group = {"rig.devices": points}
        monkeypatch.setattr(core_plugins, "entry_points", lambda group: of_group.get(group, ()))

    return install


@pytest.fixture
def third_party(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Register a third-party module whose opener returns its arguments."""
    module = ModuleType("third_party_rig")
    module.open_link = lambda url, model: (url, model)
    monkeypatch.setitem(sys.modules, "third_party_rig", module)
    return module


# ---------------------------------------------------------------------- URLs


PATHS = st.binary(min_size=1, max_size=60).filter(lambda name: b"\0" not in name).map(os.fsdecode)


@given(place=PATHS, value=PATHS)
@example(place="/dev/serial/by-id/usb-ACME_Rig#2", value="C++/a&b=c.toml")
@example(place="%23", value="%zz+%2B?#")
@example(place="/dev/ttyACM0", value="")
@example(place="\t/dev/[x]\n ", value=" \udcff\u00a0")
def test_a_url_keeps_any_path_of_linux(place: str, value: str) -> None:
    text = DeviceUrl.of("serial", place, {"rig": value}).text
    assert text.isascii()
    assert DeviceUrl.parse(text) == DeviceUrl("serial", place, {"rig": value}, text)
    pasted = DeviceUrl.of("serial", place).text
    assert shlex.split(pasted) == [pasted]


@given(text=st.text(st.characters(exclude_characters="%?"), max_size=40))
def test_a_typed_place_is_unchanged_or_refused(text: str) -> None:
    """Only % and ? have a special meaning; invisible characters are rejected."""
    try:
        assert DeviceUrl.parse(f"serial://{text}").place == text
    except ConfigError:
        assert not text.isprintable()


@pytest.mark.parametrize(
    "text",
    [
        "", "sim", "/dev/ttyACM0", "://x", "sim:koul", "SIM://koul", " sim://", "sim://?seed=1&seed=2", "sim://?",
        "sim://?a&", "sim://?=1", "serial://%", "serial://a%2", "serial://a%zz", "serial://a%00", "serial://a\nb",
        "serial://a\u200bb", "sim://?x=%",
    ],
)  # fmt: skip
def test_an_invalid_url_is_refused_with_a_remedy(text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        DeviceUrl.parse(text)
    assert repr(text) in str(caught.value)
    assert caught.value.remedy


# ---------------------------------------------------------------------- the table


def test_a_third_party_adds_a_scheme(plugins: Any, third_party: Any) -> None:
    plugins(point("zusb", "third_party_rig:open_link"), point("can", "third_party_rig:open_link", ""))
    built_in = [backend.scheme for backend in devices.backends() if backend.distribution == "haptic-rig"]
    assert [backend.scheme for backend in devices.backends()] == [*built_in, "can", "zusb"]
    assert [backend.distribution for backend in devices.backends()][len(built_in) :] == ["?", "third-party"]
    model = rotary_rig()
    url, given = devices.open_link("zusb://1:2?speed=high", model)
    assert (url.place, dict(url.options), given) == ("1:2", {"speed": "high"}, model)


def test_a_third_party_cannot_shadow_a_built_in_scheme(plugins: Any, third_party: Any) -> None:
    plugins(point("sim", "third_party_rig:open_link"))
    assert isinstance(devices.open_link("sim://", rotary_rig()), MemoryLink)


@pytest.mark.parametrize(
    "target", ["no_such_module_here:open_link", "third_party_rig:nothing", "broken_rig:open_link"]
)
def test_a_backend_that_does_not_load_is_named_with_its_distribution(
    target: str, plugins: Any, third_party: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "broken_rig.py").write_text("raise RuntimeError('built for another version')")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins(point("can", target))
    with pytest.raises(ConfigError, match="cannot import") as caught:
        devices.open_link("can://0")
    assert target in str(caught.value)
    assert "third-party" in caught.value.remedy
    assert devices.broken("can") == str(caught.value)
    assert devices.broken("sim") == ""


# ---------------------------------------------------------------------- simulated rigs


def test_the_name_in_the_url_wins_over_the_model() -> None:
    assert devices.open_link("sim://chawda-linear", rotary_rig()).device.hardware.count == 0
    with devices.open_device("sim://chawda-linear", rotary_rig()) as device:
        assert device.dictionary.device == "chawda-linear"
    with devices.open_device("sim://", rotary_rig()) as device:
        assert device.dictionary.device == "test-rotary"


def test_sim_without_a_name_needs_a_model() -> None:
    with pytest.raises(ConfigError, match="names no rig to simulate"):
        devices.open_link("sim://")
    with pytest.raises(ConfigError, match="koul-compliant"):
        devices.open_link("sim://koul-complaint")


# ---------------------------------------------------------------------- device processes


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("serial:///dev/x", "serial:///dev/x cannot be served"),
        ("sim://?offset=0.25", "offset"),  # an option of virtual time
        ("sim://?firmware=2", "must be 0 or 1"),
    ],
)
def test_a_url_that_cannot_be_served_is_refused(url: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words), local.serve_locally(url, rotary_rig()):
        pass


def test_a_server_that_does_not_load_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "SERVER", "no_such_module_here:serve")
    with pytest.raises(DeviceNotFoundError, match="no_such_module_here"):
        local.serve(rotary_rig())


def test_a_device_is_built_before_its_scheduling(monkeypatch: pytest.MonkeyPatch) -> None:
    happened: list[str] = []

    def server(model: Any, *, announce: Any) -> None:
        happened.append("made")
        announce("port")
        happened.append("served")

    monkeypatch.setattr(devices, "loaded", lambda name: server)
    local.serve(
        rotary_rig(), announce=happened.append, scheduled=lambda _granted: happened.append("scheduled")
    )
    assert happened == ["made", "scheduled", "port", "served"]


def test_a_device_process_is_that_of_its_url_and_ends_with_its_context(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It imports nothing from the working directory. Inside the host's group Ctrl-C would end it before its host."""
    need_compiler()
    monkeypatch.chdir(tmp_path)
    for name in ("json", "pickle", "socket", "signal"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(77)")
    before = set(children())
    model = config.rig_model(presets.load("koul-compliant"))
    with local.serve_locally("sim://chawda-linear?firmware=1", model) as url:
        (process,) = set(children()) - before
        assert os.getpgid(process) != os.getpgid(0)
        assert url.startswith("unix:///")
        with rig.devices.open_device(url) as device:
            assert device.dictionary.device == "chawda-linear"
            assert device.dictionary.simulated
            assert device.dictionary.parameter("law").maximum == 2, "the firmware, as the URL says"
    assert process not in children()
    with pytest.raises(DeviceNotFoundError):
        rig.devices.open_device(url)


class AsLoaded:
    """A value that is computed in the process that unpickles it."""

    def __init__(self, *asked: Any) -> None:
        self.asked = asked

    def __reduce__(self) -> Any:
        return self.asked[0], self.asked[1:]


def test_a_device_process_has_its_group_before_it_loads_its_arguments() -> None:
    asked = (AsLoaded(os.getpid), AsLoaded(os.getpgid, 0))
    with start_announced(operator.call, asked, name="asked", by_hand="no command") as (pid, group):
        assert group == pid  # receives no Ctrl-C


@pytest.fixture
def served_options(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Replace device processes by simulations in this process; return the options requested for each."""
    asked = []

    @contextmanager
    def serve_locally(url: Any, model: Any, **options: Any) -> Iterator[Any]:
        asked.append({"url": url, **options})
        yield "sim://koul-compliant"

    monkeypatch.setattr(local, "serve_locally", serve_locally)
    return asked


@pytest.mark.parametrize(("wanted", "asked"), [("off", "off"), ("try", "try"), ("enforce", "try")])
def test_a_process_asks_for_the_experiment_s_scheduling(served_options: Any, wanted: str, asked: str) -> None:
    with local.open_for_run("sim://", rotary_rig(), in_real_time=True, seed=3, realtime=wanted) as device:
        assert device.dictionary.device == "koul-compliant"
    assert served_options == [{"url": "sim://", "seed": 3, "realtime": asked}]


def test_no_process_serves_virtual_time_or_a_real_device(served_options: Any) -> None:
    with local.open_for_run("sim://chawda-linear", rotary_rig(), in_real_time=False) as device:
        assert device.dictionary.device == "chawda-linear"
    with (
        pytest.raises(DeviceNotFoundError),
        local.open_for_run("serial:///dev/none", None, in_real_time=True),
    ):
        pass
    assert served_options == []


def test_a_map_asks_for_no_scheduling_if_the_experiment_says_off(served_options: Any, tmp_path: Path) -> None:
    experiment = config.override(presets.load("koul-compliant"), {"host.realtime": "off"})
    with examined(OnDevice(url="sim://", recordings=tmp_path, realtime=True), experiment):
        pass
    assert served_options[0]["realtime"] == "off"
