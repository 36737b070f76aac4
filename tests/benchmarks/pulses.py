"""Power and false alarms of the torque pulse (`rig.experiments.motion.pulse`): each fault of a rig, over the presets.

    python -m tests.benchmarks.pulses             # the table; a minute or two
    python -m tests.benchmarks.pulses --trials 3  # fewer places of the handle in each case
    python -m tests.benchmarks.pulses --loop device   # pushes of the board: the firmware's law

Each trial is four pushes in virtual time over the byte link, from a place of its own in the window and in an encoder
cell, of a rig whose current is not measured. The rule was written before the results: no sound rig is refused; a dead
or reversed motor, a reversed, frozen or half-dead encoder and a scale (motor or encoder) that is off by two or more is
refused in every trial, with the right check named; friction twice as large is no refusal.
"""

import argparse
import itertools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment, presets
from rig.core.check import Outcome
from rig.core.errors import RigError
from rig.core.model import RigModel
from rig.devices.fault_script import Faults
from rig.devices.framed import FramedDevice
from rig.experiments.motion.pulse import Pulse, pulse
from rig.experiments.trials._identify_motions import still
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.hardware import Hardware
from sim_backend.ends.link import MemoryLink

Change = Callable[[RigModel], RigModel]


class Counting(Hardware):
    """Hardware whose encoder count is the function `counts` of the true count."""

    counts: Callable[[int], int] = staticmethod(lambda true: true)

    def advance(self, current: int) -> None:
        super().advance(current)
        self.count = self.counts(self.count)


@dataclass(frozen=True)
class Fault:
    """A fault of a rig, and the check that must report it (None for a sound rig)."""

    named: str | None
    model: Change = lambda model: model
    hardware: tuple[tuple[str, Any], ...] = ()


def _mechanics(**factors: float) -> Change:
    def change(model: RigModel) -> RigModel:
        mechanics = model.mechanics
        values = {name: factor * getattr(mechanics, name) for name, factor in factors.items()}
        return replace(model, mechanics=replace(mechanics, **values))

    return change


def _encoder(*, sign: int = 1, finer: float = 1.0, **values: float) -> Change:
    def change(model: RigModel) -> RigModel:
        encoder = model.encoder
        quantum = encoder.quantum
        scale = {"ratio": finer * encoder.ratio} if quantum is None else {"quantum": quantum / finer}
        return replace(model, encoder=replace(encoder, sign=sign * encoder.sign, **scale, **values))

    return change


FAULTS = {
    "sound": Fault(None),
    "friction twice": Fault(None, _mechanics(motor_coulomb=2.0, link_coulomb=2.0)),
    "inertia × 1.25": Fault(None, _mechanics(motor_inertia=1.25, link_inertia=1.25, end_mass=1.25)),
    "motor lead off": Fault("motion", hardware=(("drive", 0.0),)),
    "motor reversed": Fault("direction", hardware=(("drive", -1.0),)),
    "motor × ½": Fault("size", hardware=(("drive", 0.5),)),
    "motor × 2": Fault("size", hardware=(("drive", 2.0),)),
    "encoder frozen": Fault("motion", _encoder(finer=1e-9, offset=0.5)),  # no travel leaves its count
    "encoder channel dead": Fault("motion", hardware=(("counts", lambda true: (true + 1) // 2 % 2),)),
    "encoder reversed": Fault("direction", _encoder(sign=-1)),
    "encoder × ½": Fault("size", _encoder(finer=0.5)),
    "encoder × 2": Fault("size", _encoder(finer=2.0)),
    "encoder × 4": Fault("size", _encoder(finer=4.0)),
}


class OnOtherHardware(FirmwareDevice):
    """The firmware with hardware that it was not built for."""

    def stand_before(self, hardware: Hardware) -> None:
        self.hardware = hardware
        self._truth = None
        self._pass_measurements()


class TickByTick(OnOtherHardware):
    """The firmware run tick by tick, because a compiled run of ticks would bypass the false encoder."""

    def run(self, until_ns: int, most: int, *, enough: int = 1) -> tuple[bytes, int]:
        named, ticks = b"", 0
        while ticks < most and len(named) < enough and self.next_tick_ns <= until_ns:
            named += self.tick()
            ticks += 1
        return named, ticks


def faulty(experiment: Experiment, fault: Fault, at: float) -> FramedDevice:
    """Return a device with an undescribed fault; it runs the law itself if the experiment is configured so."""
    sound = config.rig_model(still(experiment))
    counts = "counts" in dict(fault.hardware)
    device = (TickByTick if counts else OnOtherHardware)(sound, initial_position=at)
    device.stand_before(Hardware(fault.model(sound), 1_000, seed=0, initial_position=at))
    if counts:
        device.hardware.__class__ = Counting
    for name, value in fault.hardware:
        setattr(device.hardware, name, value)
    if counts:
        device.hardware.count = device.hardware.counts(device.hardware.count)
    script = Faults() if counts else None  # without faults, but bytes pass Python
    return FramedDevice(MemoryLink(device, script))


def pulsed(experiment: Experiment, fault: Fault, at: float, recording: Path) -> Pulse:
    with faulty(experiment, fault, at) as framed:
        return pulse(framed, experiment, recording=recording, verified=True, reference_count=0)


def failures(experiment: Experiment, fault: Fault, at: float, recording: Path) -> tuple[str, float]:
    """Return the names of the checks that fail for a fault, and the measured scale."""
    try:
        found = pulsed(experiment, fault, at, recording)
    except RigError as error:
        return f"error: {error}", np.nan
    return ", ".join(c.name for c in found.checks if c.outcome is Outcome.REFUSED) or "ok", found.signs.scale


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--loop", choices=("host", "device"), default="host")
    asked = parser.parse_args()
    trials, missed = asked.trials, 0
    with TemporaryDirectory() as directory:
        for name, (what, fault) in itertools.product(presets.names(), FAULTS.items()):
            changes = {"rig.amplifier.current_monitor": False, "controller.loop": asked.loop}
            experiment = config.override(presets.load(name), changes)
            limits, random = experiment.rig.limits, np.random.default_rng(7)
            half = 0.1 * (limits.position_maximum - limits.position_minimum)
            middle = 0.5 * (limits.position_maximum + limits.position_minimum)
            places = middle + half * random.uniform(-1.0, 1.0, trials)
            files = [Path(directory) / f"{name}-{what}-{n}.rigcap" for n in range(trials)]
            found = [failures(experiment, fault, at, file) for at, file in zip(places, files, strict=True)]
            texts, scales = zip(*found, strict=True)
            right = sum((fault.named or "ok") in text.split(", ") for text in texts)
            missed += trials - right
            named = "; ".join(f"{count} × {text}" for text, count in Counter(texts).items())
            sizes = f"{np.nanmin(scales):.2f}–{np.nanmax(scales):.2f}"
            print(f"| {name} | {what} | {right}/{trials} | {named} | {sizes} |", flush=True)
    print(f"{missed} trials against the rule")


if __name__ == "__main__":
    main()
