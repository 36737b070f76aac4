"""
Uniform and dual-rate sampling, by theory
=========================================

The stiffest stable wall over its damping, for both uniform rates and for their combination. An elastic rig in a hand.
"""

import matplotlib.pyplot as plt
import numpy as np

from rig import theory

SCHEMES = ("uniform:2k", "uniform:20k", "dual:20k/2k")

dampings = np.linspace(0.0, 4.0, 41)
figure, axes = plt.subplots(figsize=(7, 4))
for scheme in SCHEMES:
    limits = theory.k_max_curve("koul-compliant", scheme, dampings, operator="normal")
    axes.plot(dampings, [limit.stiffness for limit in limits], label=scheme)
axes.set(xlabel="damping B (N·m·s/rad)", ylabel="stiffest stable wall (N·m/rad)", ylim=(0, None))
axes.legend()
figure.tight_layout()
