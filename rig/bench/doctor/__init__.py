"""What this machine and a link can do, and the remedy for what they cannot.

    from rig.bench.doctor.examine import Question, examine

* `machine`: the checks of this computer; `subject`, `limits`, `kernel`, `access`, `wake_up`, `udev` are its parts
* `ports`: what is connected, without opening it
* `ping`, `round_trip`: the link, measured by the loop's own means
* `late_loops`, `walls`: linear theory under the measured delay
* `gate`: whether a wall may be armed there
* `examine`: all of it, as `rig doctor` prints it
"""
