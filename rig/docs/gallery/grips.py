"""
Effect of the grip
==================

The same rig and scheme, free and held in three ways: a hand adds mass, damping and stiffness.
"""

import matplotlib.pyplot as plt
import numpy as np

from rig import theory

dampings = np.linspace(0.0, 4.0, 41)
figure, axes = plt.subplots(figsize=(7, 4))
for grip in ("none", "relaxed", "normal", "firm"):
    limits = theory.k_max_curve("koul-compliant", "dual:20k/2k", dampings, operator=grip)
    axes.plot(dampings, [limit.stiffness for limit in limits], label=grip)
axes.set(xlabel="damping B (N·m·s/rad)", ylabel="stiffest stable wall (N·m/rad)", ylim=(0, None))
axes.legend(title="grip")
figure.tight_layout()
