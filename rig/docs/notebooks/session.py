"""
Analyse a session
=================

Two simulated participants go through the protocol that ``rig session new`` writes; the study is analysed, and its
tables are read with nothing but the standard library. Sessions with people leave the same files.
"""

# %%
# 1. A study
# ----------

import csv
import subprocess
from pathlib import Path

import matplotlib.pyplot as plt


def run(*command: str) -> str:
    """Run a command of `rig` and return what it prints."""
    return subprocess.run(["rig", *command], capture_output=True, encoding="utf-8", check=True).stdout


run("session", "new", "study.toml")
study = Path("study.toml")  # shorter than a study for people would be: ten hits a search, not thirty
shorter = study.read_text(encoding="utf-8").replace("settings.hits = 30", "settings.hits = 10")
study.write_text(shorter, encoding="utf-8")
print(*run("session", "check", "study.toml").splitlines()[:20], sep="\n")

# %%
# 2. Two sessions, in virtual time
# --------------------------------
# By default a simulated person answers like the automatic verdict, and all are equal. ``--threshold`` sets the wall at
# which half of the verdicts are stable (here the limits in the template's first lines), and ``--people-sd`` spreads
# people around it.
# The title of the study names the directory.

limits = ("--threshold", "uniform 500 Hz=84", "--threshold", "dual-rate 1 kHz/500 Hz=119")
for code in ("P01", "P02"):
    run("session", "run", "study.toml", code, "--rehearse", *limits, "--people-sd", "0.2")
print(run("session", "show", "rehearsals/first-steps/P01"))

# %%
# 3. The analysis
# ---------------

print(run("session", "analyse", "rehearsals/first-steps", "-o", "analysis", "--format", "png"))

# %%
# The limits, with their intervals, are one of its tables: in the rows whose ``measure`` is ``rule``, the limits of
# the search. Names end in their units.

with Path("analysis/kmax.csv").open(encoding="utf-8") as table:
    rows = [row for row in csv.DictReader(table) if row["measure"] == "rule"]
conditions = sorted({row["condition"] for row in rows})
figure, axes = plt.subplots(figsize=(7, 3.6))
for row in rows:
    low, limit, high = (float(row[f"kmax_{name}n_m_per_rad"]) for name in ("low_", "", "high_"))
    place = conditions.index(row["condition"]) + 0.1 * (row["participant"] == "P02")
    axes.errorbar(place, limit, [[limit - low], [high - limit]], fmt="o", color="C0", capsize=3)
    axes.annotate(row["participant"], (place, limit), (5, 0), textcoords="offset points", fontsize=8)
axes.set_xticks(range(len(conditions)), conditions)
axes.set(xlim=(-0.5, len(conditions) - 0.3), ylabel="limit (N·m/rad)", ylim=(0, None))
figure.tight_layout()

# %%
# Ten hits leave wide intervals. ``rig session analyse`` compares the conditions with paired intervals and reports where
# the data are too few; ``report.html`` in the same directory has all of it, with the methods paragraph.
