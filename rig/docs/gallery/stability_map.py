"""
Spectral radius of dual-rate walls
==================================

The spectral radius over one velocity period (time between two velocity samples): below 1 a wall is linearly stable, and
the colour shows how fast a disturbance decays.
"""

import matplotlib.pyplot as plt
import numpy as np

from rig import theory

dampings, stiffnesses = np.linspace(0.0, 4.0, 90), np.geomspace(10.0, 3000.0, 90)
found = theory.stability_map("koul-compliant", "dual:20k/2k", stiffnesses, dampings, operator="normal")

figure, axes = plt.subplots(figsize=(7, 4))
image = axes.pcolormesh(
    dampings, stiffnesses, found.radius, cmap="RdYlGn_r", vmin=0.9, vmax=1.1, shading="gouraud"
)
axes.contour(dampings, stiffnesses, found.radius, levels=[1.0], colors="black")
axes.set(yscale="log", xlabel="damping B (N·m·s/rad)", ylabel="stiffness K (N·m/rad)")
figure.colorbar(image, label="spectral radius over T2")
figure.tight_layout()
