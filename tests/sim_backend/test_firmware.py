"""The firmware as a simulated device: its library is built once, and one call of many ticks equals single ticks."""

import ctypes
import re
import stat
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.devices.device import DeviceUrl
from rig.devices.fault_script import DeviceFault, Faults, Happening
from rig.realtime import _c_library as c_library
from rig.realtime._c_library import CLibrary
from sim_backend.board import firmware_library, lockstep
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.firmware_library import FIRMWARE
from sim_backend.ends.link import MemoryLink, open_link
from tests.conformance.device import check_device
from tests.conformance.firmware import need_compiler
from tests.conformance.host import Host
from tests.conformance.link import check_link
from tests.conformance.rigs import linear_rig, rotary_rig
from tests.conformance.tiers import first_by_default

if numba.config.DISABLE_JIT:
    pytest.skip("many ticks in one call are compiled code", allow_module_level=True)

FOREVER_NS = 10**15


@pytest.fixture(autouse=True)
def _compiler() -> None:
    need_compiler()


def held_rig() -> RigModel:
    return config.rig_model(config.override(presets.load("koul-compliant"), {"trial.kind": "human"}))


def noisy_rig() -> RigModel:
    return rotary_rig(current_noise_a=0.01, computation_delay_ticks=2, damping=0.002, coulomb=0.01)


RIGS = {
    "rigid": rotary_rig,
    "linear": linear_rig,
    "two masses": lambda: config.rig_model(presets.load("koul-compliant")),
    "noisy and late": noisy_rig,
    "held": held_rig,
}

# ---------------------------------------------------------------------- the library


@pytest.fixture
def small(tmp_path: Path) -> tuple[CLibrary, Path]:
    """Return a library of one function, built like the firmware's, and its directory."""
    (tmp_path / "sources" / "core").mkdir(parents=True)
    (tmp_path / "sources" / "core" / "answer.c").write_text("int answer(void) { return 42; }\n")
    (tmp_path / "made").mkdir()
    return replace(FIRMWARE, root=tmp_path / "sources", parts=("core",)), tmp_path / "made"


def test_it_is_compiled_once(small: tuple[CLibrary, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    library, place = small
    made = library.compiled(place)
    monkeypatch.setattr(CLibrary, "_compile", lambda self, command: pytest.fail("compiled again"))
    assert library.compiled(place) == made
    assert [path.name for path in place.iterdir()] == [made.name]


def test_two_may_make_it_at_once(small: tuple[CLibrary, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    library, place = small
    true, together = CLibrary._compile, threading.Barrier(2, timeout=30.0)

    def compile_at_once(self: CLibrary, command: list[str]) -> None:
        together.wait()  # neither has found it made
        true(self, command)
        together.wait()  # and neither is done before the other has made its own

    monkeypatch.setattr(CLibrary, "_compile", compile_at_once)
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(library.compiled, [place] * 2)
    assert first == second
    assert ctypes.CDLL(str(first)).answer() == 42
    assert list(place.iterdir()) == [first]


def test_other_sources_flags_and_compilers_are_another_library(tmp_path: Path) -> None:
    command = FIRMWARE.compiler()
    keys = {FIRMWARE.key(command), FIRMWARE.key([*command, "-g"])}
    other = replace(FIRMWARE, flags=(*FIRMWARE.flags, "-O1"))
    keys.add(other.key(command))
    for part in FIRMWARE.parts:
        (tmp_path / part).mkdir()
    (tmp_path / "core" / "other.h").write_text("")
    other = replace(other, root=tmp_path)
    keys.add(other.key(command))
    (tmp_path / "core" / "other.h").write_text("/* */")
    keys.add(other.key(command))
    assert len(keys) == 5


def test_without_a_compiler_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(c_library, "find_spec", {}.get)
    with pytest.raises(ConfigError) as caught:
        FIRMWARE.compiled(tmp_path)
    assert "gcc" in caught.value.remedy
    assert "ziglang" in caught.value.remedy
    monkeypatch.setattr(c_library, "find_spec", {"ziglang": "there"}.get)
    assert FIRMWARE.compiler() == [sys.executable, "-P", "-m", "ziglang", "cc"]


@pytest.mark.parametrize(
    ("script", "text"),
    [
        ("#!/bin/sh\necho 'cannot do this' >&2\nexit 1\n", "cannot do this"),
        ("#!/no/such/thing\n", "cannot start the C compiler"),
        ('#!/bin/sh\necho "at home in $HOME" >&2\nexit 1\n', "at home in /"),  # ziglang needs one
    ],
)
def test_compiler_is_quoted(script: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = tmp_path / "mycc"
    compiler.write_text(script)
    compiler.chmod(compiler.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.delenv("HOME", raising=False)
    with pytest.raises(ConfigError) as caught:
        FIRMWARE.compiled(tmp_path)
    assert text in str(caught.value)
    assert "CC" in caught.value.remedy
    assert not list(tmp_path.glob("firmware-*"))


def test_a_library_that_does_not_open_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "firmware.so"
    path.write_bytes(b"not a library")
    monkeypatch.setattr(CLibrary, "compiled", lambda self, directory: path)
    with pytest.raises(ConfigError, match=r"firmware\.so"):
        firmware_library.library.__wrapped__()


def test_a_compiler_is_named_with_its_options(monkeypatch: pytest.MonkeyPatch) -> None:
    found = FIRMWARE.compiler()
    monkeypatch.setenv("CC", f"{found[0]} -m64")
    assert FIRMWARE.compiler() == [found[0], "-m64"]


def test_the_words_are_those_of_the_header() -> None:
    fields = (FIRMWARE.root / "host" / "lockstep.h").read_text().partition("struct lockstep {")[2]
    names = re.findall(r"\w+", " ".join(re.findall(r"int64_t ([^;]+);", fields.partition("};")[0])))
    assert [getattr(lockstep, name.upper()) for name in names] == list(range(lockstep.TRUE_COUNT))


# ---------------------------------------------------------------------- many ticks are those ticks


def armed(device: FirmwareDevice, **values: Any) -> Host:
    host = Host(MemoryLink(device))
    host.begin(**values)
    return host


def by_ticks(device: FirmwareDevice, ticks: int) -> bytes:
    return b"".join(device.tick() for _ in range(ticks))


def by_runs(device: FirmwareDevice, ticks: int, most: int, enough: int) -> bytes:
    sent, done = b"", 0
    while done < ticks:
        piece, ran = device.run(FOREVER_NS, min(most, ticks - done), enough=enough)
        sent, done = sent + piece, done + ran
    return sent


@pytest.mark.parametrize("rig", first_by_default(RIGS))
@settings(max_examples=4)
@given(data=st.data())
def test_a_run_is_its_ticks(rig: str, data: st.DataObject) -> None:
    devices = [
        FirmwareDevice(RIGS[rig](), seed=4, position_rate_default=5_000, initial_position=0.01)
        for _ in range(2)
    ]
    hosts = [armed(device, position_rate=5_000) for device in devices]
    for _ in range(data.draw(st.integers(1, 6))):
        current, push = (
            data.draw(st.integers(-500, 500)),
            data.draw(st.floats(-0.05, 0.05, allow_subnormal=False)),
        )
        slip, leak = data.draw(st.integers(-1, 1)), data.draw(st.sampled_from([0, 0, 3]))
        ticks, most = data.draw(st.integers(1, 300)), data.draw(st.integers(1, 40))
        for device, host in zip(devices, hosts, strict=True):
            device.hardware.external_effort = push
            device.hardware.slip += slip
            device.hardware.leak = leak
            if device.state is not State.FAULT:
                host.command(current)
        sent = [
            by_ticks(devices[0], ticks),
            by_runs(devices[1], ticks, most, data.draw(st.sampled_from([1, 500]))),
        ]
        assert sent[0] == sent[1]
    np.testing.assert_array_equal(devices[0].truth(), devices[1].truth())
    assert devices[0].elapsed_ns == devices[1].elapsed_ns


@pytest.mark.parametrize("rig", first_by_default(RIGS))
def test_its_truth_is_that_of_the_readable_device(rig: str) -> None:
    model = RIGS[rig]()
    devices = [
        kind(model, seed=2, position_rate_default=2_000, initial_position=0.003)
        for kind in (SimulatedDevice, FirmwareDevice)
    ]
    for device in devices:
        host = Host(MemoryLink(device))
        host.begin(position_rate=2_000)
        for k in range(300):
            host.command(round(200 * np.sin(k / 20)))
            host.next_state()
    tables = [device.truth() for device in devices]
    assert len(tables[0]) >= 300
    np.testing.assert_array_equal(*tables)


def test_a_run_stops_at_its_time() -> None:
    # The period is not a whole number of units.
    device = FirmwareDevice(rotary_rig(), position_rate_default=3_000)
    for until_ns in (0, 333_332, 333_333, 333_334, 1_000_000, 10**9):
        while device.next_tick_ns <= until_ns:
            _, ticks = device.run(until_ns, 10**9)
            assert ticks > 0
        assert device.run(until_ns, 10**9) == (b"", 0)
        assert device.elapsed_ns <= until_ns < device.next_tick_ns
    assert device.sample_index == 3_000


def test_two_devices_in_one_process_are_independent() -> None:
    first, second = (FirmwareDevice(rotary_rig(), position_rate_default=1_000) for _ in range(2))
    host = armed(first)
    host.command(100)
    host.next_state()
    assert (first.state, second.state) == (State.RUNNING, State.BOOT)
    assert (first.current, second.current) == (100, 0)
    second_host = armed(second)
    first.inject_fault(Fault.INTERNAL)
    second_host.command(50)
    assert second_host.next_state().current_commanded == 50
    assert (first.fault, second.fault) == (Fault.INTERNAL, Fault.NONE)


# ---------------------------------------------------------------------- over the link


@pytest.mark.parametrize("model", [rotary_rig(), linear_rig()], ids=["rotary", "linear"])
def test_the_shipped_library_conforms(model: RigModel) -> None:
    check_device(lambda: MemoryLink(FirmwareDevice(model)))


def test_its_link_conforms() -> None:
    def fresh() -> MemoryLink:
        return open_link(DeviceUrl.parse("sim://?firmware=1&seed=3"), rotary_rig())

    assert isinstance(fresh().device, FirmwareDevice)
    check_link(fresh, lambda: MemoryLink(FirmwareDevice(rotary_rig())))


@pytest.mark.parametrize("text", ["firmware=2", "firmware=yes", "firmware=-1"])
def test_the_option_is_one_or_nothing(text: str) -> None:
    with pytest.raises(ConfigError, match="firmware"):
        open_link(DeviceUrl.parse(f"sim://?{text}"), rotary_rig())


@pytest.mark.parametrize("kind", [SimulatedDevice, FirmwareDevice])
def test_the_world_acts_at_its_tick(kind: Callable[..., Any]) -> None:
    seen: list[int] = []
    happenings = (
        Happening(7, lambda device: seen.append(device.sample_index)),
        DeviceFault(30, Fault.EMERGENCY_STOP),
        Happening(12, lambda device: device.reset()),
    )
    device = kind(rotary_rig())
    link = MemoryLink(device, Faults(device=happenings))
    before = device.sample_index
    link.elapse(0.0255)
    assert seen == [before + 7]
    assert device.sample_index == 25 - 12
    assert device.elapsed_ns == 25_000_000
