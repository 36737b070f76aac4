"""Hit a virtual wall once, print the verdict, and save a picture and the recording.

Replace the preset by your rig's file (`rig experiment new` writes one); add `url="serial:///dev/ttyACM0"` for a board.
"""

import rig

result = rig.hit("koul-compliant", stiffness=300.0, damping=0.5, duration_s=0.6)
print(result.verdict.kind)  # stable, limit cycle, unstable or invalid
print(f"deepest {1e3 * result.verdict.peak_penetration:.2f} mrad inside the wall")
result.plot().save("hit.png")
print("recording:", result.path)
