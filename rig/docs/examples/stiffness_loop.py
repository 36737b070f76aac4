"""Hit walls of rising stiffness and print verdict and depth of each: a loop of your own over an experiment."""

import rig

for stiffness in (50.0, 100.0, 200.0, 400.0):  # N·m/rad
    verdict = rig.hit("koul-compliant", stiffness=stiffness, damping=0.5, duration_s=0.6).verdict
    print(f"{stiffness:6.1f} N·m/rad  {verdict.kind:12} {1e3 * verdict.peak_penetration:6.2f} mrad deep")
    if verdict.kind == "unstable":
        break
