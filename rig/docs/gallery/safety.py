"""
Reaction to lost commands
=========================

In the middle of a push every command is lost, as when the computer hangs. The device uses the last one for its
lifetime, ramps the effort to zero, and latches LINK_LOST, by which the host ends the run.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from rig.testing import Experiments, FaultWords, Hits, Rigs

faults = FaultWords()
faults.link("silence", to="device", tick=26_000)
simulated = Rigs("sim://koul-compliant", verified=True, ask=lambda _: True)
hits = Hits(simulated, Experiments("koul-compliant", Path()), faults, Path("recordings"))
hit = hits(changes={"trial.kind": "human", "operator.grip": "relaxed"})
print(hit.error)

recording = hit.recording
time_ms = 1e3 * (recording.time_s - recording.time_s[-1])
figure, axes = plt.subplots(figsize=(7, 3.6))
axes.plot(time_ms, recording.column("effort_sent"), label="sent by the host")
axes.plot(time_ms, recording.column("effort_applied"), label="applied by the device")
axes.set(xlim=(-30, 0.5), xlabel="time before the host ended the run (ms)", ylabel="effort (N·m)")
axes.legend()
figure.tight_layout()
