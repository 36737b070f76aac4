"""False alarms and power of the motion balance over the presets: python -m tests.benchmarks.motion_balance

Walls of 0.4 to 2.5 times a preset's stiffness and 0 to 2 times its damping, with other encoder offsets and noise; the
scale becomes ½ or 2 halfway in time to the wall, at the contact, or 150 ms later.
"""

import argparse
import random
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rig import config
from rig.config import presets
from rig.core.errors import RigError
from rig.core.sample import Phase
from tests.system.test_motion_balance import SHORT, contact_of, judged, scaled

SCALES = (0.5, 2.0)
PLACES = ("halfway", "contact", "rest")


def drawn(preset: str, draw: random.Random, stiffer: tuple[float, ...], damped: tuple[float, ...]) -> Any:
    """Draw a wall of a preset, with its encoder offset, noise seed and rest."""
    x = presets.load(preset)
    changes = {
        "wall.stiffness": x.wall.stiffness * draw.choice(stiffer),
        "wall.damping": x.wall.damping * draw.choice(damped),
        "trial.seed": draw.randrange(10**6),
        "trial.minimum_rest_counts": 0.0,
        "rig.encoder.offset": draw.random(),
    }
    return config.override(x, {**SHORT, **changes})


def tick_of_change(place: str, rows: Any, rate: int) -> int:
    released, contact = int(rows["sample_index"][rows["phase"] == Phase.TRIAL][0]), contact_of(rows)
    places = {"halfway": (released + contact) // 2, "contact": contact, "rest": contact + round(0.15 * rate)}
    return places[place]


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--sound", type=int, default=25)
    options.add_argument("--changed", type=int, default=4)
    options.add_argument("--seed", type=int, default=4)
    given = options.parse_args()
    with TemporaryDirectory() as place:
        path = Path(place) / "trial.rigcap"
        for preset in presets.names():
            draw, found = random.Random(f"{given.seed} {preset}"), Counter[str]()
            ratios = []
            for _ in range(given.sound):
                x = drawn(preset, draw, (0.4, 0.7, 1.0, 1.5, 2.5), (0.0, 0.5, 1.0, 2.0))
                try:
                    motion = judged(x, path)[0].motion
                except RigError:  # thrown out by an unstable wall: it has no verdict of its own
                    continue
                found["alarms"] += motion is not None and motion.changed
                if motion is not None and motion.ratio is not None:
                    ratios.append(motion.ratio)
            for where in PLACES:
                for scale in SCALES:
                    for _ in range(given.changed):
                        x = drawn(preset, draw, (0.7, 1.0, 1.5), (0.5, 1.0, 2.0))
                        try:
                            _, rows = judged(x, path)
                            tick = tick_of_change(where, rows, x.controller.position_rate)
                            motion = judged(x, path, *scaled(scale, tick, len(rows)))[0].motion
                        except RigError:
                            found[f"{where} {scale:g} ended"] += 1
                            continue
                        found[f"{where} {scale:g}"] += motion is not None and motion.changed
            print(preset, len(ratios), f"{min(ratios):.2f} to {max(ratios):.2f}", dict(found), flush=True)


if __name__ == "__main__":
    main()
