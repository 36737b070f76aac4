"""
Which estimator for my encoder?
===============================

You know the resolution of your encoder at the handle, and the motions that matter. Which estimator of velocity should a
wall have, and with which settings? Three looks: at a number, at errors on a known motion, and at hits.
"""

# %%
# 1. The number that decides whether there is a question
# ------------------------------------------------------
# One count in one period is a velocity of Δ·f. Where that is far below the speeds that matter, a plain difference will
# do. Here: 1000 lines, four counts each, a capstan of 10, and a velocity rate of 2 kHz.

import matplotlib.pyplot as plt
import numpy as np

import rig

RATE = 2_000
experiment = rig.load("koul-rigid")
resolution = abs(experiment.rig.encoder.resolution)
print(f"Δ = {1e3 * resolution:.3f} mrad, Δ·f = {resolution * RATE:.2f} rad/s")

# %%
# A hit arrives at some rad/s and rings at tenths of one: Δ·f is as large as what the damper should act on. There is a
# question.
#
# 2. Errors on a motion of this rig
# ---------------------------------
# A simulated hit has the truth beside the counts. Any estimator runs over its recording.

hit = rig.hit(experiment, stiffness=200.0, damping=0.5, duration_s=0.6)
recording = hit.recording
every = experiment.controller.position_rate // RATE
push = np.flatnonzero(recording.column("phase") == 3)[::every]
counts, truth = recording.column("count")[push], recording.column("velocity_true")[push]

CANDIDATES = {
    "fdm": {},
    "fdm-butterworth": {"cutoff_hz": 200.0},
    "foaw-best": {},
    "kalman": {"bandwidth_hz": 100.0},
}
velocities = {
    name: rig.estimate(name, counts, 1 / RATE, resolution=resolution, **settings)
    for name, settings in CANDIDATES.items()
}
for name, velocity in velocities.items():
    print(f"{name:16} {np.sqrt(np.mean((velocity - truth) ** 2)):.4f} rad/s rms")

# %%
# The first milliseconds in the wall, where they differ most:

time_ms = 1e3 * (recording.time_s[push] - recording.time_s[push][0])
contact = int(np.argmax(recording.column("penetration")[push] > 0.0))
shown = slice(contact - 20, contact + 80)
figure, axes = plt.subplots(figsize=(8, 4))
axes.plot(time_ms[shown], truth[shown], color="black", label="truth")
for name, velocity in velocities.items():
    axes.step(time_ms[shown], velocity[shown], where="post", linewidth=0.9, label=name)
axes.set(xlabel="time (ms)", ylabel="velocity (rad/s)")
axes.legend()
figure.tight_layout()

# %%
# 3. Hits
# -------
# Least error is not the widest wall. So each candidate has to hold the same walls, with more and more damping.

DAMPINGS = (0.5, 1.0, 2.0)
print(f"{'B =':16}" + "".join(f"{damping:>14g}" for damping in DAMPINGS))
for name, settings in CANDIDATES.items():
    kinds = []
    for damping in DAMPINGS:
        result = rig.hit(
            experiment, estimator=name, parameters=settings, stiffness=200.0, damping=damping, duration_s=0.6
        )
        kinds.append(str(result.verdict.kind))
    print(f"{name:16}" + "".join(f"{kind:>14}" for kind in kinds))

# %%
# One hit each: a map repeats them at several places of the encoder. The estimator to take is the one that still holds
# where you need damping. For the settings: ``rig estimators tune NAME RECORDING`` finds them for a recording of yours,
# and ``rig zwidth --scheme dual:20k/2k,estimator=NAME`` draws the whole curve.
