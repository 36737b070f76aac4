"""
Effort ripple over encoder resolution
=====================================

The same wall hit with encoders of more and more lines: audible ripple of the effort in the last part of the hit, and
the threshold above which a hit is a limit cycle. Beyond some resolution friction absorbs the effort of one count.
"""

import matplotlib.pyplot as plt

import rig

LINES = (250, 350, 500, 700, 1_000, 2_000, 4_000, 8_000)

heard = []
for lines in LINES:
    result = rig.hit(
        "koul-rigid",
        stiffness=200.0,
        damping=0.6,
        effort=0.8,
        duration_s=0.6,
        minimum_rest_counts=0.5,
        changes={"rig.encoder.counts_per_revolution": lines, "homing.tolerance_counts": lines / 100.0},
    )
    heard.append(result.verdict.heard)
threshold = result.experiment.verdict.heard_force * result.experiment.rig.mechanics.handle_radius

figure, axes = plt.subplots(figsize=(7, 4))
axes.semilogx(LINES, heard, "o-", label="heard")
axes.axhline(threshold, color="0.5", linestyle="--", label="threshold")
axes.set(xlabel="lines of the encoder (4 counts each)", ylabel="ripple of the effort above 30 Hz (N·m)")
axes.minorticks_off()
axes.set_xticks(LINES, [str(lines) for lines in LINES])
axes.legend()
figure.tight_layout()
