"""
Passive and stable walls
========================

Passive walls are stable in any hand; many more are stable in one. The same rig without a hand, in a hand, and under the
condition for all hands; both axes are logarithmic.
"""

import matplotlib.pyplot as plt
import numpy as np

from rig import theory

RIG, SCHEME = "koul-rigid", "dual:20k/2k"

dampings = np.geomspace(1e-4, 1.0, 40)
passive = [theory.passivity_bound(RIG, SCHEME, damping).stiffness for damping in dampings]
figure, axes = plt.subplots(figsize=(7, 4))
for grip in ("none", "normal"):
    limits = theory.k_max_curve(RIG, SCHEME, dampings, operator=grip)
    axes.loglog(dampings, [limit.stiffness for limit in limits], label=f"stable, hand: {grip}")
axes.loglog(dampings, [k if k > 0.0 else np.nan for k in passive], label="passive: any hand")
axes.set(xlabel="damping B (N·m·s/rad)", ylabel="stiffest wall (N·m/rad)")
axes.legend()
figure.tight_layout()
