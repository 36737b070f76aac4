"""Examine this computer and the link to a device, and decide whether the motor may be armed to render a virtual wall.

* `here`: list of connected devices and of rigs that can be simulated
* `interface`: names for a whole examination: checks of the computer, ports, measurement of a link, stable walls
* `gate`, `gate_result`: decision from the measured link whether the motor may be armed;
  `rig.experiments.hits.admission` adds refusals by the checks of the planned run and by the device
* `late_loops`: stability of walls by linear theory with the measured delay
* `pace`: samples that a loop would lose at its rate with this computer and link
* `predicted`: checks of a run from its description alone

`rig.experiments.hits.examine` runs the whole examination that `rig doctor` prints.
"""
