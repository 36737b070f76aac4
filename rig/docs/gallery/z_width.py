"""
A Z-width by hits and by theory
===============================

An ascending series of hits at each damping finds the stiffest wall that a simulated rig renders. Steps of
15 % and one place of the encoder make it quick; 6 % and two places are the default.
"""

import rig

found = rig.zwidth(
    "koul-compliant",
    ["dual:20k/2k", "uniform:20k"],
    dampings=[0.0, 0.25, 0.5, 1.0, 2.0, 3.0],
    ratio=1.15,
    offsets=[0.3],
    workers=1,
)
print(found)

# %%
# Fast velocity fails where it is noisy, and linear theory, dashed, does not contain the noise.

picture = found.plot()
