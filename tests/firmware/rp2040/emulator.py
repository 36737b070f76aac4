"""The whole binary of the Raspberry Pi Pico in an emulator, with its pins, its serial line and a rig on them.

`Pico` runs the emulator (Node, rp2040js) as a process with lines of JSON. `PicoLink` is the serial line as a link in
virtual time.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.config._derive import rig_model
from rig.config._load import override
from rig.config.presets import load
from rig.core.model import RigModel
from rig.devices.device import DeviceUrl
from rig.firmware._build import DEVICE, BuildResult
from rig.realtime.clock import VirtualClock
from sim_backend.mechanics.plant import DiscretePlant
from tests.conformance.host import StubLink
from tests.firmware import cross

HERE = Path(__file__).parent
CLOCK_HZ = 200_000_000
PLANT_STEP_S = 2e-6
INSTALL_S = 60.0
SLICE_US = 200.0
START_US = 14_000.0  # from power-up to a device that listens
WATCHDOG_US = 40_000.0
FLASH_ID = "e6614103e7452d2f"
FULL_SCALE_A = 10.0
MONITOR_V_PER_A = 0.165
PINS = {
    "encoder": 2, "encoder_complement": 14, "encoder_index": 20, "limit_switch": 13, "pwm": 8, "dac": 17, "enable": 10,
    "hold_to_run": 11, "emergency_stop": 12, "sync_in": 4, "sync_out": 5,
}  # fmt: skip
PRESET = "koul-rigid"
# Images of the tests: changes of the rig, settings of the board. Linking takes seconds, so most tests share two;
# "full" has the converter, every optional signal of the encoder, and an amplifier that delays its set-point as an ESCON
# by PWM does.
IMAGES: dict[str, tuple[dict[str, object], dict[str, Any]]] = {
    "usual": ({}, {}),
    "converter": ({}, {"output": "dac"}),
    "delayed": ({"rig.amplifier.set_point_delay_s": 1e-4}, {}),
    "full": (
        {"rig.amplifier.set_point_delay_s": 1e-4},
        {"output": "dac", "encoder_lines": "complementary"}
        | dict.fromkeys(("encoder_index", "limit_switch"), "wired"),
    ),
}


@cache
def built(name: str) -> tuple[RigModel, BuildResult]:
    changes, settings = IMAGES[name]
    model = rig_model(override(load(PRESET), changes))
    return model, image(model, **settings)


def image(model: RigModel, application: str = DEVICE, **settings: Any) -> BuildResult:
    return cross.built("rp2040", model, application, current_monitor="adc", **settings)


def modules() -> Path:
    """Install the emulator once for each version and return the directory; skip the test without npm."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("node and npm are not installed (package nodejs)")
    wanted = sha256((HERE / "package-lock.json").read_bytes()).hexdigest()[:12]
    base = Path(
        os.environ.get("HAPTIC_RIG_CACHE") or Path(tempfile.gettempdir()) / f"haptic-rig-{os.getuid()}"
    )
    place = base / f"node-{wanted}"
    if not place.is_dir():
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=base) as scratch:
            for name in ("package.json", "package-lock.json"):
                shutil.copy(HERE / name, scratch)
            command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
            done = subprocess.run(
                command, cwd=scratch, capture_output=True, text=True, timeout=INSTALL_S, check=False
            )
            if done.returncode != 0:
                pytest.skip(f"npm cannot fetch the emulator: {done.stderr.strip().splitlines()[-1:]}")
            try:
                os.rename(scratch, place)
                os.mkdir(scratch)  # for the context to remove
            except OSError:
                assert place.is_dir()  # another process was first
    return place / "node_modules"


@dataclass(frozen=True, slots=True)
class Ticks:
    """The ticks of a board, as columns: times in processor cycles since its reset, and encoder counts.

    It came at `came` (ns since power-up). The tick is `at` … `ends` by the pin that shows it, `entered` … `left` by the
    interrupt's entry and return. While the count was read the encoder went from `before`, as the state machines
    had seen it, at most 32 cycles late, to `after`.
    """

    came: NDArray[np.int64]
    at: NDArray[np.int64]
    ends: NDArray[np.int64]
    entered: NDArray[np.int64]
    left: NDArray[np.int64]
    before: NDArray[np.int64]
    after: NDArray[np.int64]

    @property
    def cycles(self) -> NDArray[np.int64]:
        return self.left - self.entered

    def __getitem__(self, which: Any) -> Ticks:
        return Ticks(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


# Emulators whose code is compiled already: a board in one of them boots in a quarter of the time.
_idle: list[subprocess.Popen[str]] = []


def _take_process() -> subprocess.Popen[str]:
    if _idle:
        return _idle.pop()
    return subprocess.Popen(
        ["node", str(HERE / "serve.js")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "NODE_PATH": str(modules())},
    )


def _asked(process: subprocess.Popen[str], op: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps({"op": op, **arguments}) + "\n")
    process.stdin.flush()
    answer: dict[str, Any] = json.loads(process.stdout.readline())
    assert "error" not in answer, answer["error"]
    return answer


def _ended(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()
    process.wait(10.0)
    process.stdout.close()


def end() -> None:
    while _idle:
        _ended(_idle.pop())


class Pico:
    """The emulated board, a context manager."""

    def __init__(
        self,
        model: RigModel,
        image: Path,
        *,
        position: float | None = None,
        start_us: float = START_US,
        **power: Any,
    ) -> None:
        self._process = _take_process()
        self._ticks = Ticks(*[np.zeros(0, dtype=np.int64)] * 7)
        self.ask(
            "power",
            image=str(image),
            pins=PINS,
            motor=motor_of(model, position),
            **{"flash": FLASH_ID, **power},
        )
        self.run(start_us)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if error is None:
            _idle.append(self._process)
        else:  # in the middle of anything
            _ended(self._process)

    def ask(self, op: str, **arguments: Any) -> dict[str, Any]:
        return _asked(self._process, op, arguments)

    def run(self, us: float) -> bytes:
        return bytes.fromhex(self.ask("run", us=us)["sent"])

    def send(self, data: bytes) -> None:
        self.ask("send", hex=data.hex())

    def look(self) -> dict[str, Any]:
        return self.ask("look")

    def ticks(self) -> Ticks:
        """Return all ticks since power-up or the last reset; the first is sample 1 of the device."""
        answer = self.ask("ticks")
        fields = Ticks.__dataclass_fields__
        new = (np.array(answer[name]).astype(np.int64) for name in fields)
        self._ticks = Ticks(
            *(np.concatenate([getattr(self._ticks, name), a]) for name, a in zip(fields, new, strict=True))
        )
        return self._ticks

    def move(self, *motion: tuple[int, float]) -> float:
        """Turn the encoder by pairs of signed counts and nanoseconds per count; return the end time (ns)."""
        return float(self.ask("move", motion=motion)["ends"])


def motor_of(model: RigModel, position: float | None) -> dict[str, Any]:
    """Return the motor behind the pins, with the rig that it moves from a position (rad or m; None: no rig)."""
    motor: dict[str, Any] = {
        "full_scale": FULL_SCALE_A,
        "effort_per_ampere": model.amplifier.effort_per_ampere,
        "monitor_scale": MONITOR_V_PER_A,
    }
    if position is not None:
        motor["plant"] = {**plant_of(model), "position": position}
    return motor


def plant_of(model: RigModel) -> dict[str, Any]:
    plant = DiscretePlant.build(model, PLANT_STEP_S)
    return {"phi": plant.phi.tolist(), "gamma": plant.gamma.tolist(), "parameters": plant.parameters.tolist()}


def plant_states(model: RigModel, position: float, efforts: list[float]) -> list[list[float]]:
    """Return position, velocity and effort of plant.js after each step with one of the efforts (N·m)."""
    process = _take_process()
    try:
        plant = {**plant_of(model), "position": position}
        states: list[list[float]] = _asked(process, "plant", {"plant": plant, "commands": efforts})["states"]
    except BaseException:
        _ended(process)
        raise
    _idle.append(process)
    return states


class PicoLink(StubLink):
    url = DeviceUrl("emulated", "pico", {}, "emulated://pico")
    bytes_per_second = 300_000.0

    def __init__(self, pico: Pico) -> None:
        self.pico = pico
        self.clock = VirtualClock()

    def read(self, timeout_s: float) -> bytes:
        left_us = timeout_s * 1e6
        data = b""
        while not data and left_us > 0.0:
            step_us = min(SLICE_US, left_us)
            data = self.pico.run(step_us)
            self.clock.sleep_until(self.clock.now_ns() + round(step_us * 1e3))
            left_us -= step_us
        return data

    def write(self, data: bytes) -> None:
        self.pico.send(data)
