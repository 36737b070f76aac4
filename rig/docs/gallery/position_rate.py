"""
Stiffness over the sampling rate
================================

The stiffest undamped wall over the sampling rate, for a drive and for one with ten times the lag. Beyond some rate the
lag is the limit, and faster sampling has no benefit.
"""

import matplotlib.pyplot as plt

import rig
from rig import theory

RATES = (500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000)
fast = rig.load("koul-rigid")
slow = rig.load("koul-rigid", changes={"rig.amplifier.lag_s": 10 * fast.rig.amplifier.lag_s})

figure, axes = plt.subplots(figsize=(7, 4))
for experiment in (fast, slow):
    limits = [theory.k_max(experiment, f"uniform:{rate}", operator="normal").stiffness for rate in RATES]
    axes.loglog(RATES, limits, "o-", label=f"lag {1e3 * experiment.rig.amplifier.lag_s:.2f} ms")
axes.set(xlabel="sampling rate (Hz)", ylabel="stiffest wall at B = 0 (N·m/rad)")
axes.legend()
figure.tight_layout()
