"""
Choose a velocity estimator for an encoder
==========================================

After this example you can choose a velocity estimator and its settings for the resolution of your encoder, in three
steps: the velocity of one count, errors on a known motion, and hits.
"""

# %%
# 1. Velocity of one count
# ------------------------
# One count in one period is a velocity of Δ·f. If that is far below the speeds of interest, a plain difference is
# sufficient. Here: 1000 lines, four counts each, a capstan of 10, and a velocity rate of 2 kHz.

import matplotlib.pyplot as plt
import numpy as np

import rig

RATE = 2_000
experiment = rig.load("koul-rigid")
resolution = abs(experiment.rig.encoder.resolution)
print(f"Δ = {1e3 * resolution:.3f} mrad, Δ·f = {resolution * RATE:.2f} rad/s")

# %%
# A hit arrives at some rad/s and rings at tenths of one: Δ·f is as large as the velocities on which the damper acts. An
# estimator is needed.
#
# 2. Errors on a motion of this rig
# ---------------------------------
# The recording of a simulated hit contains the true velocity and the counts. Any estimator can be applied to it.

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
# The estimator with the least error does not give the widest range of walls. So each candidate renders the same walls,
# with more and more damping.

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
# One hit each: a map repeats them at several places of the encoder. Choose the estimator whose walls are still stable
# at the damping that you need. ``rig estimators tune NAME RECORDING`` finds the settings for a recording of yours, and
# ``rig zwidth --scheme dual:20k/2k,estimator=NAME`` draws the whole curve.
