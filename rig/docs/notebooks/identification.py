"""
From an identification to a Z-width
===================================

After this example you can replace the data sheet values of a rig by identified ones. A rig is identified, the measured
numbers are written to its file, and theory and hits show the effect on its walls.
"""

# %%
# 1. The description and the real rig
# -----------------------------------
# The description is ``koul-rigid``; the "real" rig has half as much inertia again and twice the friction. On a bench it
# would be a real rig at ``--url``.

import subprocess
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import rig
from rig import theory

Path("real.toml").write_text(
    'preset = "koul-rigid"\n[rig]\nname = "real"\n'
    "[rig.mechanics]\nlink_inertia = 3.6e-4\nmotor_coulomb = 0.04\n",
    encoding="utf-8",
)

# %%
# 2. Identify it
# --------------
# The command moves the free handle: small pushes for the signs, slow strokes for friction, multisines for the rest. It
# writes a file with the measured numbers.

command = "rig identify real.toml --realisations 2 -o identified.toml --no-plot"
print(subprocess.run(command.split(), capture_output=True, encoding="utf-8", check=True).stdout)

# %%
# 3. Compare the descriptions
# ---------------------------

assumed, measured, real = (rig.load(source) for source in ("koul-rigid", "identified.toml", "real.toml"))
print(f"{'':16}{'data sheet':>12}{'identified':>12}{'truth':>12}")
for key in ("motor_inertia", "link_inertia", "motor_coulomb", "motor_damping", "link_damping"):
    values = [getattr(experiment.rig.mechanics, key) for experiment in (assumed, measured, real)]
    print(f"{key:16}" + "".join(f"{value:>12.3g}" for value in values))

# %%
# 4. Effect on the stable walls
# -----------------------------
# The stiffest stable wall over its damping, in a hand, for the three descriptions.

dampings = np.linspace(0.0, 1.5, 31)
figure, axes = plt.subplots(figsize=(7, 4))
for label, experiment in (("data sheet", assumed), ("identified", measured), ("truth", real)):
    limits = theory.k_max_curve(experiment, "dual:20k/2k", dampings, operator="normal")
    axes.plot(dampings, [limit.stiffness for limit in limits], "--" if label == "truth" else "-", label=label)
axes.set(xlabel="damping B (N·m·s/rad)", ylabel="stiffest stable wall (N·m/rad)", ylim=(0, None))
axes.legend()
figure.tight_layout()

# %%
# 5. Hits
# -------
# Theory leaves out friction and the encoder's steps. A map by hits has both; in coarse steps it takes seconds.

walls = rig.zwidth(measured, ["dual:20k/2k"], dampings=[0.0, 0.5], ratio=1.3, duration_s=0.6, workers=1)
picture = walls.plot()
