"""
Offset and drift of two clocks
==============================

The clock of the device runs 80 ppm fast. Its difference to the computer's clock over one hit, and the drift in the
recording.
"""

import matplotlib.pyplot as plt

import rig

result = rig.hit("koul-compliant", url="sim://koul-compliant?clock_ppm=80", duration_s=1.0)
rows = result.recording
device, host = rows.column("device_time"), rows.column("received_at")
apart_us = 1e-3 * ((device - device[0]) - (host - host[0]))
drift = (rows.trailer or {})["clock"]["drift_ppm"]  # of the host against the device

figure, axes = plt.subplots(figsize=(7, 3.6))
axes.plot(rows.time_s, apart_us, label="device less host")
axes.plot(rows.time_s, -rows.time_s * drift, "--", label=f"fit: {-drift:.1f} millionths")
axes.set(xlabel="time (s)", ylabel="difference of the clocks (µs)")
axes.legend()
figure.tight_layout()
