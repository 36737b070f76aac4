"""The α-β filter of our lab."""

import rig


@rig.estimator(
    parameters={"bandwidth_hz": rig.Parameter(default=200.0, minimum=1.0, maximum=1e4, unit="Hz")},
    memory=("late", "velocity"),
)
def alpha_beta(travel: float, elapsed_s: float, memory: rig.Memory, p: rig.Parameters) -> float:
    """Position and velocity, corrected by what the motion is ahead of them: critically damped."""
    keep = 1.0 / (1.0 + 6.283185307179586 * p.bandwidth_hz * elapsed_s)
    ahead = memory.late + travel - memory.velocity * elapsed_s
    memory.velocity += (1.0 - keep) ** 2 * ahead / elapsed_s
    memory.late = keep**2 * ahead
    return memory.velocity
