"""What this machine and a link can do, the remedy for what they cannot, and whether a wall may be armed.

* `machine`: the checks of this computer; `subject`, `limits`, `kernel`, `access`, `wake_up`, `udev` are its parts
* `ports`: what is connected, without opening it
* `ping`, `round_trip`: the link, measured by the loop's own means
* `late_loops`, `walls`: linear theory under the measured delay
* `gate`: whether a wall may be armed there; `rig.experiments.hits.admission` adds what a plan and the device itself
  refuse

All of it, as `rig doctor` prints it, is `rig.experiments.hits.examine`.
"""
