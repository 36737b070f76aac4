"""Identify a rig (inertia, friction, delay), then measure the impedance of a wall on it.

On a bench, add `url="serial:///dev/ttyACM0"` to both calls.
"""

import rig

identified = rig.identify("koul-rigid", realisations=2)
print(identified)
(measured,) = rig.impedance("koul-rigid", walls=[(50.0, 0.1)], excitation={"realisations": 2})
print(measured)
measured.plot().save("impedance.png")
