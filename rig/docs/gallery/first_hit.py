"""
A hit on a virtual wall
=======================

A constant effort pushes the handle into a wall. `plot()` of the result draws position against the wall, velocity,
effort.
"""

import rig

result = rig.hit("koul-compliant", stiffness=300.0, damping=0.5, duration_s=0.6)
print(result)

# %%
picture = result.plot()
