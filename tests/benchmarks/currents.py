"""False alarms and power of the comparison of measured and active current (`rig.control.current`).

    python -m tests.benchmarks.currents                # the table; some minutes
    python -m tests.benchmarks.currents --trials 5     # fewer of each case

Each trial is a hit in virtual time over the byte link, with the device's own check and the loop's. Walls are taken from
well below the preset's own up to far beyond what it holds: what oscillates, saturates or bounces must not alarm.
A **false alarm** is a fault CURRENT_MISMATCH of a sound motor. The device may believe another lag than the rig has.
**Power** is the share of broken motors that end the trial, of those broken at a random tick in the wall, and how long
that takes. *Not observed* are trials in which no window had a current that a dead motor would have shown by.

The rule was written before the results: a line of a table may have no false alarm; and of the broken motors with a
sensor whose noise is at most 1 % of the peak current, all but 1 % are found within 20 ms of their being observable,
those of another scale where that is off by at least 20 %.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.errors import RigError
from rig.core.model import RigModel
from rig.core.sample import Phase, RowFlag
from rig.devices.framed import FramedDevice
from rig.recording.reader import open_recording
from sim_backend.channel import Faults, Happening
from sim_backend.device import SimulatedDevice
from sim_backend.link import MemoryLink
from tests.conformance.trials import trial_on

NOISES = (0.0, 0.001, 0.003, 0.01)  # of the peak current
STIFFNESS = (0.2, 1.0, 3.0)  # of the preset's own
BELIEVED_LAGS = (0.5, 1.0, 2.0)
RATES = {"own": {}, "1 kHz": {"controller.position_rate": 1_000, "controller.velocity_rate": 1_000}}
DRIVES = ("current", "voltage")
BROKEN: dict[str, dict[str, float]] = {
    "lead off": {"drive": 0.0},
    "sensor dead": {"gain": 0.0},
    "sensor reversed": {"gain": -1.0},
    "half": {"gain": 0.5},
    "a fifth too much": {"gain": 1.2},
    "five times": {"gain": 5.0},
}


@dataclass(frozen=True)
class Case:
    """A rig, its drive, its loop's rate and how noisy its sensor is."""

    preset: str
    drive: str
    rate: str
    noise: float

    def experiment(self, stiffness: float) -> Any:
        """The hit, against a wall of a share of the preset's own stiffness."""
        x = presets.load(self.preset)
        peak_a = x.rig.amplifier.effort_limit / x.rig.amplifier.effort_per_ampere
        return config.override(
            x,
            {
                "trial.duration_s": 0.4,
                "verdict.tail_s": 0.15,
                "wall.stiffness": stiffness * x.wall.stiffness,
                "rig.amplifier.drive": self.drive,
                "rig.amplifier.current_noise_a": self.noise * peak_a,
                **RATES[self.rate],
            },
        )


@dataclass(frozen=True)
class Found:
    """What became of one trial."""

    fault: Fault
    seconds: float | None  # from the break, or the first contact after it, to the end
    observed: bool


def trial(experiment: Any, believed_lag: float, seed: int, broken: dict[str, float] | None, at: int) -> Found:
    """Run one hit; `at` is the tick in which the motor breaks."""
    model = config.rig_model(experiment)
    device = SimulatedDevice(model, seed=seed, initial_position=model.simulation.initial_position or 0.0)
    believed: RigModel = replace(
        model, amplifier=replace(model.amplifier, lag_s=believed_lag * model.amplifier.lag_s)
    )
    device._safety._model = believed

    def act(device: Any) -> None:
        for name, value in (broken or {}).items():
            setattr(device.hardware, name, value)

    link = MemoryLink(device, Faults(device=(Happening(at, act),) if broken else ()))
    with TemporaryDirectory() as directory:
        path = Path(directory) / "trial.rigcap"
        run = partial(trial_on, experiment=experiment, recording=path, verified=True, seed=seed, sealed=False)
        try:
            with FramedDevice(link) as framed:
                run(framed)
        except RigError:
            pass
        rows = open_recording(path).rows
    seconds = None
    if device.fault is Fault.CURRENT_MISMATCH and broken:
        pushed = (rows["sample_index"] >= at) & (np.abs(rows["current_applied"]) > 0)
        begin = rows["sample_index"][np.argmax(pushed)] if pushed.any() else at
        seconds = (rows["sample_index"][-1] - begin) / experiment.controller.position_rate
    observed = bool((rows["flags"] & RowFlag.CURRENT_FOLLOWS).any())
    touched = bool((rows["phase"] == Phase.TRIAL).any())
    return Found(device.fault, seconds, observed and touched)


def cases() -> Iterator[Case]:
    """All of them."""
    for preset, drive, rate, noise in itertools.product(presets.names(), DRIVES, RATES, NOISES):
        yield Case(preset, drive, rate, noise)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=12, help="of each line, and of each broken motor in it")
    trials = parser.parse_args().trials
    print("preset, drive, rate, noise | false alarms | " + " | ".join(BROKEN) + " | slowest | not observed")
    for case in cases():
        random = np.random.default_rng(0)
        rate = case.experiment(1.0).controller.position_rate
        sound = [
            trial(case.experiment(stiffness), lag, seed, None, 0)
            for seed in range(max(1, trials // 3))
            for stiffness in STIFFNESS
            for lag in BELIEVED_LAGS
        ]
        alarms = sum(one.fault is Fault.CURRENT_MISMATCH for one in sound)
        shares, slowest = [], 0.0
        for broken in BROKEN.values():
            found = [
                trial(case.experiment(1.0), 1.0, seed, broken, round(rate * random.uniform(0.05, 0.3)))
                for seed in range(trials)
            ]
            shares.append(
                np.mean([one.fault in (Fault.CURRENT_MISMATCH, Fault.OVER_CURRENT) for one in found])
            )
            slowest = max([slowest, *(one.seconds for one in found if one.seconds is not None)])
        unseen = np.mean([not one.observed for one in sound])
        print(
            f"{case.preset}, {case.drive}, {case.rate}, {100 * case.noise:g} % | {alarms} of {len(sound)} | "
            + " | ".join(f"{100 * share:.0f} %" for share in shares)
            + f" | {1e3 * slowest:.0f} ms | {100 * unseen:.0f} %",
            flush=True,
        )


if __name__ == "__main__":
    main()
