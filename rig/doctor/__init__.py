"""Examine this machine and a link to a device, and decide whether a wall may be armed.

* `machine`: the checks of this computer; `subject`, `limits`, `kernel`, `access`, `wake_up`, `udev` are its parts
* `ports`: list of connected ports and USB devices, without opening them
* `ping`, `round_trip`: measurement of a link with the real-time loop's own code
* `late_loops`, `walls`: stable walls by linear theory with the measured delay
* `gate`: decision whether a wall may be armed; `rig.experiments.hits.admission` adds the refusals of a plan and of the
  device itself

`rig.experiments.hits.examine` runs the whole examination that `rig doctor` prints.
"""
