"""Map the stiffest stable walls of two sampling schemes on all cores; a map in a directory resumes after Ctrl-C."""

import rig

found = rig.zwidth(
    "koul-compliant",
    ["uniform:20k", "dual:20k/2k"],
    dampings=[0.0, 0.5, 1.0],
    directory="maps",
    ratio=1.3,  # of neighbouring stiffnesses; smaller is finer and takes longer
    workers=None,  # as many as there are processors
)
print(found)
found.plot().save("map.png")
