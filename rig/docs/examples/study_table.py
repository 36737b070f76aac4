"""From finished sessions to a table: two rehearsed participants here, people in your study; the files are the same."""

import subprocess
from pathlib import Path

import rig

subprocess.run(["rig", "session", "new", "study.toml"], check=True)
protocol = Path("study.toml")
text = protocol.read_text(encoding="utf-8")
protocol.write_text(text.replace("settings.hits = 30", "settings.hits = 10"), encoding="utf-8")
for code in ("P01", "P02"):
    subprocess.run(["rig", "session", "run", "study.toml", code, "--rehearse"], check=True)

analysis = rig.analyse_study("rehearsals/first-steps")
rig.write_study_tables(analysis, Path("tables"))
print(Path("tables/kmax.csv").read_text(encoding="utf-8"))
