"""Read a recording in pandas (`pip install 'haptic-rig[data]'`): one row for each tick, units beside the columns."""

import rig

result = rig.hit("koul-compliant", stiffness=300.0, damping=0.5, duration_s=0.6)
recording = rig.open_recording(result.path)
print(recording.experiment["wall"])  # the experiment as it ran
table = recording.to_pandas()
print({name: unit for name, unit in recording.units.items() if name in ("position", "effort_sent")})
print(table[["position", "effort_sent"]].describe())
inside = table[table["penetration"] > 0.0]
print(f"{len(inside)} of {len(table)} ticks inside the wall")
rig.export(result.path, "hit.csv")  # for other programs: also .mat, .parquet
