"""
Current drive and voltage drive
===============================

Without a current loop the motor's back-EMF acts as damping behind the lag of the winding. The same rig and sampling
scheme with both drives.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig
from rig import theory

dampings = np.linspace(0.0, 1.0, 41)
figure, axes = plt.subplots(figsize=(7, 4))
for drive in ("current", "voltage"):
    experiment = rig.load("koul-rigid", changes={"rig.amplifier.drive": drive})
    limits = theory.k_max_curve(experiment, "uniform:20k", dampings, operator="normal")
    axes.plot(dampings, [limit.stiffness for limit in limits], label=f"{drive} drive")
axes.set(xlabel="damping B (N·m·s/rad)", ylabel="stiffest stable wall (N·m/rad)", ylim=(0, None))
axes.legend()
figure.tight_layout()
