"""Compare walls of a moteus by its own law and by a bridge's: ``python -m tests.benchmarks.drive_walls``.

The preset moteus-knob with its friction, a simulated drive and a bridge with 80 µs of bus each way at 1 kHz, all in
virtual time, so that the load of this computer does not matter: the hits, searches and verdicts are those of
``rig zwidth --url``. The drive's encoder filter is its default (400 Hz), and 2 kHz beside it.
"""

import argparse
import tempfile
from typing import Any

from rig import config
from rig.config import presets, rig_model
from rig.config.schemes import Scheme
from rig.devices.framed import FramedDevice
from rig.experiments.hits._on_device import OnDevice
from rig.experiments.mapping._ranges import hit_plan
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping._zwidth_rig import DeviceMap, zwidth_on_rig
from tests.conformance.bridged import Bridged

DAMPINGS = (0.005, 0.01, 0.02, 0.04)  # N·m·s/rad
FILTER = "motor_position.sources.0.pll_filter_hz"
GAINS = {"servo.pid_position.kp": "200", "servo.pid_position.kd": "40"}
DRIVE = {"controller.loop": "device", "controller.arithmetic": "drive"}
CASES: dict[str, tuple[dict[str, Any], dict[str, str]]] = {
    "law behind the bridge, 1 kHz": ({}, {}),
    "law on the drive": (DRIVE, GAINS),
    "law on the drive, filter 2 kHz": (DRIVE, {**GAINS, FILTER: "2000"}),
}


def largest(changes: dict[str, Any], settings: dict[str, str], ratio: float) -> dict[float, str]:
    """Return the largest passing K (N·m/rad) by damping; "≥" where the search reached its end first."""
    keys = {"wall.pull": "allow", "trial.duration_s": 0.6, **changes}
    x = config.override(presets.load_named("moteus-knob"), keys, "the benchmark")
    search = StiffnessSearch(lowest=0.5, highest=30.0, ratio=ratio)
    plan = hit_plan(x, [Scheme.parse("uniform:1k")], dampings=DAMPINGS, search=search, on_device=True)
    world = Bridged(rig_model(x), settings)
    with tempfile.TemporaryDirectory() as place:
        where = OnDevice(url="moteus://memory", device=FramedDevice(world), verified=True, recordings=place)
        session = DeviceMap(where=where, agrees=lambda asked: True, pause=lambda seconds: None)
        found = zwidth_on_rig(plan, session)
    curve = found.curve(0, "any")
    return {one.damping: f"{'≥ ' if one.capped else ''}{one.stiffness:.3g}" for one in curve}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--ratio", type=float, default=1.06, help="between two stiffnesses that are tried")
    chosen = parser.parse_args()
    print("largest K (N·m/rad) at B =", ", ".join(f"{b:g}" for b in DAMPINGS), "N·m·s/rad")
    for name, (changes, settings) in CASES.items():
        print(f"{name}: {', '.join(largest(changes, settings, chosen.ratio).values())}", flush=True)


if __name__ == "__main__":
    main()
