"""What this machine and a link can do, and what would mend what they cannot.

    from rig.bench.doctor.examine import Question, examine

* `machine`: the checks of this computer; `subject`, `limits`, `kernel`, `access`, `wake_up`, `udev` are its parts
* `finding`, `ports`: what is looked at without a device
* `ping`, `round_trip`: the link, measured by the loop's own means
* `late_loops`, `walls`: what linear theory makes of its delay
* `gate`: whether a wall may be armed there
* `examine`: all of it, as `rig doctor` prints it
"""
