"""Firmware images: their content, their reproducibility, and the errors of a build."""

import json
import math
import os
import re
import shutil
import subprocess
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.dictionary import decode
from firmware_protocol.parameters import PARAMETERS
from rig import config
from rig.config import amplifiers, presets
from rig.core.board import current_sensor, moved_mechanics, over_current, peak_current
from rig.core.errors import ConfigError, RecordingError, ToolchainError
from rig.core.model import RigModel
from rig.core.present import plain
from rig.core.same_rig import check_rig
from rig.firmware import _boards as boards
from rig.firmware._board_config import configure
from rig.firmware._build import (
    PORT_CHECK,
    BuildRequest,
    _warnings,
    build,
    package_version,
    shared_sources,
    sources_hash,
)
from rig.firmware._flash import read_image
from rig.firmware._info import info
from rig.firmware._scales import check_scales
from rig.firmware._toolchain import COMPILER_VARIABLE, find_compiler
from rig.firmware._uf2 import read_uf2
from rig.firmware.tick_budget import named_budget
from tests.conformance.tiers import first_by_default
from tests.firmware import cross
from tests.firmware.build import CORE, FIRMWARE, compile_c, kept_objects
from tests.firmware.test_core_objects import BOARDS as PROCESSORS

BOARD = "mps2-an386"  # the first processor of its directory

PRINTER = r"""
#include "board_config.h"

#include <stdio.h>

int main(void)
{
    const struct board *b = &board_config;
    const struct mechanics *m = &b->mechanics;
    printf("%u %llx %u %d %u\n", b->dictionary_bytes, (unsigned long long)b->dictionary_hash, b->rate_initial,
           b->encoder_sign, b->over_current);
    printf("%a %a %a %a %a %a %a\n", m->effort_quantum, m->effort_limit, m->friction, m->travel, m->inertia, m->damping,
           m->lag_s);
    printf("%a %a %a %a\n", b->current_sensor.noise, b->current_sensor.lag_s, b->current_sensor.delay_s,
           b->current_sensor.back_emf);
    for (size_t i = 0; i < b->narrower_count; i++)
        printf("%u %u %u\n", b->narrower[i].parameter, b->narrower[i].minimum, b->narrower[i].maximum);
    for (size_t i = 0; i < b->dictionary_bytes; i++)
        printf("%02x", b->dictionary[i]);
    return 0;
}
"""


@pytest.fixture(scope="module")
def model() -> Any:
    return config.rig_model(presets.load("chawda-linear"))


def of_profile(name: str) -> RigModel:
    profile = amplifiers.load(name)
    delay_s = profile.set_point_delay_s
    changes = {"profile": name, "drive": profile.drive or "current", "set_point_delay_s": delay_s}
    keys = {f"rig.amplifier.{key}": value for key, value in changes.items()}
    return config.rig_model(config.override(presets.load("koul-rigid"), keys))


@pytest.fixture(scope="module")
def built() -> Any:
    return cross.image(BOARD)


@pytest.fixture
def pico(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The Pico's board without optimisation; core and law do not depend on settings and are compiled once."""
    cross.need_compiler()
    directory = shutil.copytree(boards.BOARDS / "rp2040", tmp_path / "rp2040")
    core = kept_objects(find_compiler().path, CORE, *PROCESSORS["cortex-m0plus"])
    assert set(core) == set(shared_sources())
    monkeypatch.setattr("rig.firmware._build.shared_sources", lambda _application: ())
    file = directory / "board.toml"
    text = file.read_text()
    for key, words in ("compile", ["-O0", "-g0"]), ("link", ["--specs=nano.specs", *map(str, core.values())]):
        text, changed = re.subn(rf"^{key} = .*$", f"{key} = {words}", text, flags=re.MULTILINE)
        assert changed == 1
    file.write_text(text)
    return str(directory)


def test_the_constant_in_c_is_the_rig(model: Any, tmp_path: Path) -> None:
    board = boards.load(BOARD)
    made = configure(board, model, {}, package="1", sources="abc")
    (tmp_path / "board_config.h").write_text(made.header)
    (tmp_path / "board_config.c").write_text(made.source)
    (tmp_path / "print.c").write_text(PRINTER)
    sources = [tmp_path / "board_config.c", tmp_path / "print.c"]
    program = compile_c(tmp_path / "print", sources, [f"-I{tmp_path}", f"-I{FIRMWARE / 'core'}"])
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
    size, hash_, rate, sign, over = printed[0].split()
    assert (int(size), int(hash_, 16)) == (len(made.record.packed), made.record.dictionary_hash)
    assert (int(rate), int(sign), int(over)) == (1000, model.encoder.sign, over_current(model))
    assert [float.fromhex(text) for text in printed[1].split()] == list(astuple(moved_mechanics(model)))
    assert [float.fromhex(text) for text in printed[2].split()] == list(astuple(current_sensor(model)))
    narrower = {
        PARAMETERS[int(i)].name: (int(low), int(high)) for i, low, high in map(str.split, printed[3:-1])
    }
    peak = peak_current(model)
    assert narrower["motion"] == (1, 1)
    assert narrower["encoder_sign"] == (model.encoder.sign % 2**32,) * 2
    assert narrower["current_limit"] == narrower["continuous_current"] == (0, peak)
    assert narrower["position_rate"][1] == board.rate_maximum
    assert list(narrower) == sorted(narrower, key=[p.name for p in PARAMETERS].index)
    assert bytes.fromhex(printed[-1]) == made.record.packed


@pytest.mark.parametrize(("monitor", "measured"), [("none", False), ("adc", True)])
def test_a_board_without_a_current_monitor_says_so(monitor: str, measured: bool, model: Any) -> None:
    # With a converter of 12 bits the noise is that of its steps and the output's, whatever the rig declares.
    board = boards.load("rp2040")
    settings = boards.settings_of(board, {"current_monitor": monitor, "monitor_scale": 0.15})
    made = configure(board, model, settings, package="1", sources="abc")
    assert decode(made.record.packed).current_measured is measured
    noise = re.search(r"\.noise = (\S+),", made.source)
    assert noise is not None
    step = 3.3 / 4096 / float(settings["monitor_scale"]) / model.amplifier.current_quantum_a
    output = 10.0 / (200e6 / 50e3) / model.amplifier.current_quantum_a  # of the pulse width, at 10 A
    expected = math.hypot(step / math.sqrt(12.0), output / math.sqrt(12.0), math.sqrt(1.0 / 6.0))
    expected = expected if measured else -1.0
    assert float(noise[1]) == pytest.approx(expected)


@pytest.mark.exhaustive("tests/system/test_cli_firmware.py::test_an_image_is_built_and_inspected")
def test_image_contains_its_facts_and_its_sizes_are_those_of_the_program(built: Any) -> None:
    facts = {"package": package_version(), "sources": sources_hash(boards.load(BOARD)), "board": BOARD}
    for path in (built.elf, built.bin):
        found = info(str(path))
        assert found.compatible
        assert (found.firmware, found.dictionary_hash) == (built.firmware, built.dictionary_hash)
        assert plain(found.facts) == {**facts, "rig": cross.RIG, "settings": {}}
    written = json.loads(built.facts.read_text())
    assert (written["dictionary_hash"], written["compiler"]) == (built.dictionary_hash, built.compiler)
    command = ["arm-none-eabi-size", built.elf]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    code, data, zeroes = (int(text) for text in listed[1].split()[:3])
    assert built.ram_bytes == pytest.approx(data + zeroes, abs=64)
    assert built.flash_bytes == pytest.approx(code + data, abs=64)
    assert built.bin.stat().st_size == pytest.approx(built.flash_bytes, abs=64)
    assert built.flash_bytes < 64 * 1024


@pytest.mark.exhaustive("tests/system/test_cli_firmware.py::test_an_image_is_built_and_inspected")
def test_the_same_inputs_give_the_same_bytes_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The program with the fewest files; the compiler keeps times out of every one.
    built = cross.image(BOARD, PORT_CHECK)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "elsewhere"))
    monkeypatch.setattr("tempfile.tempdir", None)
    board = shutil.copytree(boards.load(BOARD).directory, tmp_path / BOARD)
    rig = config.rig_model(presets.load(cross.RIG))
    request = BuildRequest(model=rig, board=str(board), output=tmp_path / "again", application=PORT_CHECK)
    again = build(request)
    for kind in ("elf", "bin", "facts"):
        assert getattr(built, kind).read_bytes() == getattr(again, kind).read_bytes(), kind
    assert str(tmp_path).encode() not in again.elf.read_bytes()
    assert os.fsencode(FIRMWARE) not in again.elf.read_bytes()


def test_a_missing_compiler_is_named(model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv(COMPILER_VARIABLE, raising=False)
    with pytest.raises(ToolchainError, match="apt install gcc-arm-none-eabi libnewlib-arm-none-eabi"):
        build(BuildRequest(model=model, board=BOARD, output=tmp_path))
    monkeypatch.setenv(COMPILER_VARIABLE, "/no/such/gcc")
    with pytest.raises(ToolchainError, match="/no/such/gcc"):
        find_compiler()


@pytest.mark.parametrize(
    ("script", "match"), [("exit 1", "cannot be run"), ('test "$1" = --version && echo 1', "no C library")]
)
def test_unusable_compiler_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, match: str
) -> None:
    fake = tmp_path / "gcc"
    fake.write_text(f"#!/bin/sh\n{script}\n")
    fake.chmod(0o755)
    monkeypatch.setenv(COMPILER_VARIABLE, str(fake))
    with pytest.raises(ToolchainError, match=match):
        find_compiler()


def test_error_of_the_compiler_is_shown(tmp_path: Path) -> None:
    cross.need_compiler()
    (tmp_path / "bad.c").write_text("int main(void) { return nothing; }\n")
    with pytest.raises(ToolchainError, match="nothing"):
        find_compiler().run(["-c", "bad.c"], tmp_path)


def test_unknown_boards_and_settings_are_refused(model: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"choose one of: .*mps2"):
        boards.load("arduino")
    with pytest.raises(ConfigError, match="no setting 'pin'"):
        boards.settings_of(boards.load("mps2"), {"pin": 3})
    with pytest.raises(ConfigError, match="its programs: device"):
        build(BuildRequest(model=model, board=BOARD, output=tmp_path, application="game"))
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="`output`"):
        build(BuildRequest(model=model, board=BOARD, output=tmp_path / "file"))


def board_with_settings(*settings: Any) -> Any:
    return replace(boards.load("mps2"), settings={setting.name: setting for setting in settings})


SETTING = boards.BoardSetting(name="pin", default=3, meaning="where", minimum=0, maximum=29)
SCALE = boards.BoardSetting(name="scale", default=0.5, meaning="how much", unit="A", minimum=0.0)
LINK = boards.BoardSetting(name="link", default="usb", meaning="which", choices=("usb", "uart"))


@pytest.mark.parametrize(
    ("setting", "good", "bad"),
    [
        *((SETTING, 29, 30), (SETTING, 0, 1.0), (SETTING, 1, True)),
        *((SCALE, 2, -1.0), (SCALE, 0.25, "x"), (LINK, "uart", "can")),
    ],
)
def test_a_setting_takes_what_it_may_be(setting: Any, good: Any, bad: Any) -> None:
    board = board_with_settings(setting)
    assert boards.settings_of(board, {})[setting.name] == setting.default
    assert boards.settings_of(board, {setting.name: good})[setting.name] == good
    with pytest.raises(ConfigError, match="give "):
        boards.settings_of(board, {setting.name: bad})


def test_no_pin_is_used_twice() -> None:
    encoder = boards.BoardSetting(name="encoder", default=2, meaning="A, then B", pins=2)
    enable = boards.BoardSetting(name="enable", default=4, meaning="on", pins=1)
    board = board_with_settings(encoder, enable)
    assert boards.settings_of(board, {"encoder": 5}) == {"encoder": 5, "enable": 4}
    with pytest.raises(ConfigError, match=r"encoder and enable .* both use pin 4"):
        boards.settings_of(board, {"encoder": 3})
    reserved = replace(board, reserved_pins={4: "the line"})
    with pytest.raises(ConfigError, match="the line and enable"):
        boards.settings_of(reserved, {})


@pytest.mark.parametrize("name", boards.names())
def test_a_board_is_whole(name: Any) -> None:
    board = boards.load(name)
    settings = boards.settings_of(board, {})
    assert all(type(value) is type(board.settings[key].default) for key, value in settings.items())
    assert (board.directory / board.linker_script).is_file()
    assert "device" in board.applications
    for application in board.applications:
        assert all(path.is_file() for path in board.sources(application))


@pytest.mark.parametrize("name", [name for name in boards.names() if boards.load(name).uf2_family])
@pytest.mark.exhaustive(
    "tests/rig/firmware/test_firmware_uf2.py::test_every_byte_comes_back_where_it_belongs"
)
def test_the_uf2_of_a_board_writes_its_image_and_nothing_else(name: Any) -> None:
    board, made = boards.load(name), cross.image(name)
    written = read_uf2(made.uf2.read_bytes(), "x")
    assert written.family == board.uf2_family
    (whole,) = written.pieces
    image = made.bin.read_bytes()
    assert whole.address == board.flash.origin
    assert whole.data[: len(image)].replace(b"\xff", b"\0") == image.replace(b"\xff", b"\0")
    assert len(whole.data) - len(image) < 256
    assert whole.address + len(whole.data) <= board.flash.origin + board.flash.bytes
    assert info(str(made.uf2)).firmware == made.firmware


def test_scales_of_a_foreign_port_are_checked_as_far_as_they_are_declared() -> None:
    board, model = boards.load("rp2040"), of_profile("generic")
    settings = boards.settings_of(board, {})
    assert check_scales(board, model, settings) == pytest.approx(10.0 / 4000)
    assert check_scales(board, model, {**settings, "clock": "external"}) == 0.0
    assert check_scales(board, model, {"full_scale": 10.0}) is None
    dac = {"output": "dac", "full_scale": 10.0, "current_monitor": "none"}
    assert check_scales(board, model, dac) == pytest.approx(2 * 10.0 / 65536)
    assert check_scales(board, of_profile("escon-50-5-dac"), dac) == pytest.approx(2 * 10.0 / 4096)
    with pytest.raises(ConfigError, match="saturate unnoticed"):
        check_scales(board, model, {**settings, "clock": "external", "full_scale": 1.0})


@pytest.mark.parametrize("name", first_by_default(amplifiers.names()))
def test_every_amplifier_has_an_image_by_its_own_settings(name: str, pico: str) -> None:
    profile = amplifiers.load(name)
    made = cross.built(pico, of_profile(name))
    assert profile.settings.items() <= made.settings.items()
    sent = made.settings["full_scale"] / (200e6 / made.settings["pwm_frequency"])
    seen = {"escon-50-5-pwm": 2 * 10.0 / 800, "escon-50-5-dac": 2 * 10.0 / 4096}
    wanted = {"generic": sent, "voltage-bridge": sent, **seen}
    assert made.set_point_step_a == pytest.approx(wanted[name])


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("generic", {"full_scale": 5.5}, "full_scale .* 5.5 A is below the peak current of 5.556 A"),
        ("generic", {"full_scale": 1000.0, "pwm_frequency": 125_000}, "1000 A in steps of 0.625 A gives only 9 steps"),
        (
            "generic",
            {"current_monitor": "adc", "monitor_scale": 0.3},
            "monitor_scale .* up to 5.497 A, less than the over-current limit of 6.111 A; .* 0.27 V/A or less",
        ),
        ("escon-50-5-pwm", {"full_scale": 16.0}, "16 A exceeds the maximum of escon-50-5-pwm; set it to at most 15 A"),
        ("escon-50-5-pwm", {"pwm_frequency": 50_000}, "50000 Hz is outside the range of escon-50-5-pwm; .* 10 to 5000"),
        ("escon-50-5-pwm", {"pwm_frequency": 3500}, "3500 Hz has a period of 285.7 µs, but theory assumes 250 µs"),
        ("escon-50-5-pwm", {"output": "dac"}, "output .* dac does not match .* escon-50-5-pwm; set it to pwm, or "),
        ("escon-50-5-dac", {"output": "pwm"}, "output .* pwm does not match .* escon-50-5-dac; set it to dac, or "),
        ("escon-50-5-dac", {"full_scale": 5.5}, "5.5 A is below the peak current of 5.556 A.* saturate unnoticed"),
    ],
)  # fmt: skip
def test_scales_that_do_not_fit_the_rig_are_refused_with_both_numbers(
    name: str, settings: Any, words: str
) -> None:
    board, model = boards.load("rp2040"), of_profile(name)
    usual = amplifiers.load(name).settings
    with pytest.raises(ConfigError, match=words):
        check_scales(board, model, boards.settings_of(board, {**usual, **settings}))


@pytest.mark.parametrize(
    "chosen", [{"pwm_frequency": 3100, "set_point": "offset"}, {"pwm_frequency": 125_000}]
)
@pytest.mark.exhaustive("::test_every_amplifier_has_an_image_by_its_own_settings")
def test_the_ends_of_what_the_amplifier_may_be_are_built(pico: str, chosen: Any) -> None:
    # At the slowest pulse width a period just fits the 16 bits of its counter.
    model = config.rig_model(presets.load("koul-rigid"))
    assert cross.built(pico, model, **chosen).uf2.is_file()
    with pytest.raises(ConfigError, match="pwm_frequency"):
        boards.settings_of(boards.load("rp2040"), {"pwm_frequency": 3000})


def test_settings_of_the_rig_are_built_in_and_reported_unless_overridden(model: Any, pico: str) -> None:
    named = replace(model, board=(("enable_pin", 20), ("full_scale", 12.5)))
    built = cross.built(pico, named, enable_pin=21)
    settings = {setting.name: setting.value for setting in read_image(built.elf)[1].dictionary.settings}
    assert settings == built.settings
    assert (settings["enable_pin"], settings["full_scale"], settings["encoder_lines"]) == (21, 12.5, "single")
    difference = check_rig(named, read_image(built.elf)[1].dictionary).text
    assert "enable_pin of its board: 21 on the device, 20 in the experiment" in difference


def test_a_board_that_is_not_right_is_refused_with_every_key(tmp_path: Path) -> None:
    text = (boards.BOARDS / "mps2" / "board.toml").read_text()
    (tmp_path / "board.toml").write_text(
        "odd = 1\n" + text.replace("rate_maximum = 20000", 'rate_maximum = "x"')
    )
    with pytest.raises(ConfigError, match=r"board\.toml: rate_maximum: .*\n.*board\.toml: odd: "):
        boards.load(str(tmp_path))
    with pytest.raises(ConfigError, match=r"unknown board 'nowhere'.* directory with a board\.toml"):
        boards.load("nowhere")


# ---------------------------------------------------------------------- warnings with numbers

PICO = named_budget("rp2040")


@pytest.mark.parametrize(
    ("rate", "estimator", "says"),
    [
        (
            20_000,
            "fdm-butterworth",
            "7103 cycles a tick on rp2040 (Cortex-M0+, 200 MHz, no floating-point unit)",
        ),
        (10_000, "fdm-butterworth", ""),
        (2_000, "foaw-best", "at most 1.57 kHz; choose a rate of at most 1568 Hz"),
        (20_000, "fdm-butterworth-fixed", ""),
    ],
)
def test_a_law_that_the_processor_has_no_time_for_is_warned_of(rate: int, estimator: str, says: str) -> None:
    # A bug that was there: a float law was built for a board without a float unit without a warning.
    changes = {
        "controller.loop": "device", "controller.position_rate": rate, "controller.velocity_rate": rate,
        "controller.estimator": estimator,
    }  # fmt: skip
    x = config.override(presets.load("koul-rigid"), changes)
    request = BuildRequest(model=config.rig_model(x), board="rp2040", output=Path(), controller=x.controller)
    found = " ".join(_warnings(request, PICO, 0.001))
    assert says in found
    assert bool(found) is bool(says)
    on_host = config.override(x, {"controller.loop": "host"}).controller
    assert not _warnings(replace(request, controller=on_host), PICO, None)


def test_a_set_point_coarser_than_the_commands_is_a_warning_with_the_value_to_set() -> None:
    request = BuildRequest(model=config.rig_model(presets.load("koul-rigid")), board="rp2040", output=Path())
    assert _warnings(request, PICO, 0.002) == ()
    (found,) = _warnings(request, PICO, 0.025)
    assert "0.025 A, 25 times the rig's current_quantum_a = 0.001 A" in found
    assert "set rig.amplifier.current_quantum_a = 0.025" in found
