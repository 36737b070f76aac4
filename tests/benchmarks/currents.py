"""False alarms and power of the check that compares measured and active current (`rig.control.current`).

    python -m tests.benchmarks.currents                # the table; about an hour
    python -m tests.benchmarks.currents --preset hapkit --noise 0.003
    python -m tests.benchmarks.currents --trials 2     # fewer of each case

Each trial is a hit in virtual time over the byte link, with the device's own check and the loop's. The stiffness of the
walls ranges from far below the preset's to far above the stable limit: oscillation, saturation or bouncing must not
cause an alarm. A **false alarm** is a report of a wrong current for a sound motor. The description of the device may
have another lag and another delay of the set-point than the rig has. The delay is that of an amplifier profile, or
1 ms; the simulated rig has it in whole ticks, rounded up.
A motor that breaks, at a random tick of the trial proper, can be **seen** once the current differs by more than the
rule's threshold for 20 ms, in any windows of 10 ms, without the largest difference of each (a possible spike) and
outside of the tolerance of the rule's three lags. **Power** is the share of the breaks that could be seen and ended the
trial; the slowest is the longest such delay. *Not seen* are the others: too little current flowed before the end.
*Not observed* are sound trials without a window whose current would have revealed a dead motor.

The rule was written before the results: a line of a table may have no false alarm; and of the broken motors with a
sensor whose noise is at most 1 % of the peak current, all but 1 % are found within 20 ms after they can be seen, those
with a wrong scale if it is off by at least 20 %.
"""

import argparse
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from firmware_protocol.faults import Fault
from rig import config
from rig.config import amplifiers, presets
from rig.control.current import SHARE, SIGMAS, WINDOW_S
from rig.core.board import current_sensor
from rig.core.current_sensor import SPEED_LAG_S
from rig.core.errors import RigError
from rig.core.model import RigModel
from rig.core.sample import Phase, RowFlag
from rig.devices.fault_script import Faults, Happening
from rig.devices.framed import FramedDevice
from rig.recording.reader import open_recording
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.trials import trial_on

NOISES = (0.0, 0.003, 0.01)  # of the peak current
STIFFNESS = (0.2, 1.0, 3.0)  # of the preset's own
SHARES = (0.5, 0.7, 1.0, 1.4, 2.0)
RATES = {
    "own": {},
    "1 kHz": {"controller.position_rate": 1_000, "controller.velocity_rate": 1_000},
    "4 kHz": {"controller.position_rate": 4_000, "controller.velocity_rate": 4_000},
}
DELAYS_S = (*sorted({amplifiers.load(name).set_point_delay_s for name in amplifiers.names()}), 1e-3)
# Of device and host.
ALARMS = (Fault.CURRENT_MISMATCH.text, "the measured current differed from the set current")
BROKEN: dict[str, dict[str, float]] = {
    "lead off": {"drive": 0.0}, "sensor dead": {"gain": 0.0}, "sensor reversed": {"gain": -1.0},
    "half": {"gain": 0.5}, "a fifth too much": {"gain": 1.2}, "five times": {"gain": 5.0},
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A rig with its drive, its loop rate and the noise of its current sensor."""

    preset: str
    drive: str
    rate: str
    noise: float
    delay_s: float

    def experiment(self, stiffness: float) -> Any:
        """Return the hit on a wall whose stiffness is a share of the preset's."""
        x = presets.load(self.preset)
        peak_a = x.rig.amplifier.effort_limit / x.rig.amplifier.effort_per_ampere
        trial = {"trial.duration_s": 0.4, "trial.minimum_rest_counts": 0.0, "verdict.tail_s": 0.15}
        amplifier = {
            "drive": self.drive,
            "current_noise_a": self.noise * peak_a,
            "set_point_delay_s": self.delay_s,
        }
        described = {f"rig.amplifier.{name}": value for name, value in amplifier.items()}
        wall = {"wall.stiffness": stiffness * x.wall.stiffness}
        return config.override(x, {**trial, **wall, **described, **RATES[self.rate]})


@dataclass(frozen=True)
class Found:
    alarm: bool  # the currents were reported to disagree
    over: bool  # over-current
    seconds: float | None  # from when a break could be seen to the end; None: it could not
    observed: bool
    trial: range  # ticks of the trial proper


def trial(experiment: Any, share: float, seed: int, broken: dict[str, float] | None, at: int) -> Found:
    """Run one hit; the description has `share` of the true lag and delay, and the motor breaks at tick `at`."""
    model = config.rig_model(experiment)
    device = SimulatedDevice(model, seed=seed, initial_position=model.simulation.initial_position or 0.0)
    amplifier = model.amplifier
    late = {name: share * getattr(amplifier, name) for name in ("lag_s", "set_point_delay_s")}
    device._safety._model = replace(model, amplifier=replace(amplifier, **late))

    def act(device: Any) -> None:
        for name, value in (broken or {}).items():
            setattr(device.hardware, name, value)

    link = MemoryLink(device, Faults(device=(Happening(at, act),) if broken else ()))
    message = ""
    with TemporaryDirectory() as directory:
        path = Path(directory) / "trial.rigcap"
        try:
            with FramedDevice(link) as framed:
                trial_on(framed, experiment, path, seed=seed, sealed=False)
        except RigError as error:
            message = error.message
        rows = open_recording(path).rows
    proper = np.flatnonzero(rows["phase"] == Phase.TRIAL)
    return Found(
        alarm=any(text in message for text in ALARMS),
        over=Fault.OVER_CURRENT.text in message,
        seconds=visible_s(rows, model, experiment.controller.position_rate, broken, at) if broken else None,
        observed=bool((rows["flags"][proper] & RowFlag.CURRENT_FOLLOWS).any()),
        trial=range(proper[0], proper[-1]) if len(proper) else range(0),
    )


def visible_s(rows: Any, model: RigModel, rate: int, broken: dict[str, float], at: int) -> float | None:
    """Return for how long before the end the currents differed by more than the threshold in every window (s)."""
    ticks, sensor = round(rate * WINDOW_S), current_sensor(model)
    moved = np.diff(rows["count"], prepend=rows["count"][:1]) * model.encoder.sign
    later = rows["sample_index"] >= at
    active, back_emf = rows["current_applied"][later], sensor.back_emf * rate * moved[later]
    gain, drive = broken.get("gain", 1.0), broken.get("drive", 1.0)

    def behind(current: Any, lag_s: float) -> Any:
        if lag_s == 0.0:
            return current
        decay = np.exp(-np.arange(1.0 + 10.0 * rate * lag_s) / (rate * lag_s))
        return np.convolve(current, decay / decay.sum())[: len(current)]

    def smoothed(current: Any) -> Any:  # the rule compares what is as smooth as the speed
        return current if sensor.back_emf == 0.0 else behind(current, SPEED_LAG_S)

    def window_means(current: Any) -> Any:
        return np.convolve(np.abs(current), np.full(ticks, 1.0 / ticks), "valid")

    if len(active) < 2 * ticks:  # too short to know; an alarm that ended it took so long at most
        return len(active) / rate
    acting = np.pad(active, (model.amplifier.set_point_ticks(1.0 / rate), 0))[: len(active)]
    left = (1.0 - gain * drive) * acting - (1.0 - gain) * back_emf
    expected = smoothed(acting - back_emf)
    reach = ticks if sensor.back_emf == 0.0 else 2 * ticks  # a smoothed spike acts in the next window, too
    spike = sliding_window_view(np.pad(np.abs(left), (reach - ticks, 0)), reach).max(axis=1)
    quick, slow = math.floor(0.5 * sensor.delay_s * rate), math.ceil(2.0 * sensor.delay_s * rate - 1e-9)
    late = sliding_window_view(np.pad(active, (slow, 0)), slow + 1)[:, : slow - quick + 1]
    flowing = behind(acting, sensor.lag_s)
    lags = [
        smoothed(behind(extreme, f * sensor.lag_s) - flowing)
        for f in (1.0, 0.5, 2.0)
        for extreme in (late.min(axis=1), late.max(axis=1))
    ]
    left = smoothed(left)
    outside = left - np.clip(left, np.min(lags, axis=0), np.max(lags, axis=0))
    difference = window_means(outside) - spike / ticks
    threshold = np.maximum(SIGMAS * sensor.noise, window_means(expected) / SHARE)
    seen = np.convolve(difference > threshold, np.ones(ticks), "valid") == ticks
    return (len(active) - int(np.argmax(seen))) / rate if seen.any() else None


def cases() -> Iterator[Case]:
    """Yield all distinct cases: without back-EMF both drives are the same, and a rate may equal the preset's."""
    grid = itertools.product(presets.names(), ("current", "voltage"), RATES, NOISES, DELAYS_S)
    for preset, drive, rate, noise, delay_s in grid:
        x = presets.load(preset)
        same_drive = drive == "voltage" and x.rig.amplifier.back_emf_damping == 0.0
        same_rate = rate != "own" and RATES[rate]["controller.position_rate"] == x.controller.position_rate
        if not same_drive and not same_rate:
            yield Case(preset, drive, rate, noise, delay_s)


def line(case: Case, trials: int) -> str:
    random = np.random.default_rng(0)
    walls = list(itertools.product(range(max(1, trials // 3)), STIFFNESS))
    by_lag = {lag: [trial(case.experiment(k), lag, seed, None, 0) for seed, k in walls] for lag in SHARES}
    sound = [one for found in by_lag.values() for one in found]
    proper = trial(case.experiment(1.0), 1.0, 0, None, 0).trial
    shares, slowest, unseen_breaks = [], 0.0, 0
    for broken in BROKEN.values():
        x, ticks = case.experiment(1.0), [int(random.choice(proper)) for _ in range(trials)]
        found = [trial(x, 1.0, seed, broken, at) for seed, at in enumerate(ticks)]
        caught = [one for one in found if one.alarm or one.over]
        missed = [one for one in found if one not in caught and (one.seconds or 0.0) > 2.0 * WINDOW_S]
        shares.append(f"{len(caught)} of {len(caught) + len(missed)}")
        unseen_breaks += trials - len(caught) - len(missed)
        slowest = max([slowest, *(one.seconds for one in caught if one.seconds is not None)])
    alarms = ", ".join(f"{sum(one.alarm for one in found)} of {len(found)}" for found in by_lag.values())
    unseen = np.mean([not one.observed for one in sound])
    columns = (
        f"{case.preset}, {case.drive}, {case.rate}, {100 * case.noise:g} %, {1e6 * case.delay_s:g} µs",
        alarms,
        *shares,
        f"{1e3 * slowest:.0f} ms",
        str(unseen_breaks),
        f"{100 * unseen:.0f} %",
        str(sum(one.over for one in sound)),
    )
    return f"| {' | '.join(columns)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=5, help="of each broken motor in a line")
    parser.add_argument("--preset", action="append", choices=presets.names(), help="default: all")
    parser.add_argument("--noise", action="append", type=float, choices=NOISES, help="default: all")
    options = parser.parse_args()
    ends = ("slowest", "not seen", "not observed", "over-currents")
    heads = ("preset, drive, rate, noise, delay", "false alarms", *BROKEN, *ends)
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for case in cases():
        if case.preset in (options.preset or presets.names()) and case.noise in (options.noise or NOISES):
            print(line(case, options.trials), flush=True)


if __name__ == "__main__":
    main()
