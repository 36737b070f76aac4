"""
Effect of the computation delay
===============================

The stiffest wall over the computation delay between a sample and its effort, in ticks of 20 kHz: with the law on the
computer a link adds some, on the board it does not.
"""

import matplotlib.pyplot as plt

import rig
from rig import theory

TICKS = (0, 1, 2, 5, 10, 20, 40)

figure, axes = plt.subplots(figsize=(7, 4))
for damping in (0.0, 0.5):
    limits = [
        theory.k_max(
            rig.load("koul-compliant", changes={"rig.simulation.computation_delay_ticks": ticks}),
            "dual:20k/2k",
            damping,
            operator="normal",
        ).stiffness
        for ticks in TICKS
    ]
    axes.plot([ticks / 20 for ticks in TICKS], limits, "o-", label=f"B = {damping:g} N·m·s/rad")
axes.set(xlabel="computation delay (ms)", ylabel="stiffest stable wall (N·m/rad)", ylim=(0, None))
axes.legend()
figure.tight_layout()
