"""A velocity estimator of your own: compare it with built-in ones on counts, then use it in a wall."""

import numpy as np

import rig
from rig.testing import check_estimator, velocities


@rig.estimator(
    parameters={
        "weight": rig.Parameter(default=0.6, minimum=0.0, maximum=0.99, meaning="weight of the past")
    },
    memory=("velocity",),
)
def smoothed(travel: float, elapsed_s: float, memory: rig.Memory, p: rig.Parameters) -> float:
    """Finite difference, smoothed exponentially."""
    memory.velocity = p.weight * memory.velocity + (1.0 - p.weight) * travel / elapsed_s
    return memory.velocity


check_estimator(smoothed)
RATE_HZ, RESOLUTION = 2000, 1e-5
time_s = np.arange(4000) / RATE_HZ
position = 0.01 * np.sin(2 * np.pi * 3 * time_s)
velocity = 0.01 * 2 * np.pi * 3 * np.cos(2 * np.pi * 3 * time_s)
counts = rig.quantise(position, RESOLUTION)
estimates = {
    name: rig.estimate(name, counts, 1 / RATE_HZ, resolution=RESOLUTION) for name in ("fdm", "kalman")
}
estimates["smoothed"] = velocities(smoothed.prepare({}, RESOLUTION, 1 / RATE_HZ), counts.tolist())
for name, estimated in estimates.items():
    print(f"{name:9} rms error {np.sqrt(np.mean((estimated - velocity)[200:] ** 2)):.2e}")
print(
    rig.hit("koul-compliant", estimator=smoothed, stiffness=300.0, damping=0.5, duration_s=0.6).verdict.kind
)
