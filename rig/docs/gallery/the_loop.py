"""
Block diagram of the loop
=========================

From the encoder to the motor, and back through the hand. The part between the two dashed lines is compiled: on the
computer, or as the same law on the board.
"""

from itertools import pairwise

import matplotlib.pyplot as plt

BOXES = {
    "encoder\ncounts of Δ": (0.0, 0.0),
    "position\nevery T1": (2.3, 0.0),
    "estimator\nvelocity, every T2 = N·T1": (4.9, -1.4),
    "wall\nK·depth + B·velocity": (7.5, 0.0),
    "guard\nlimits": (10.0, 0.0),
    "drive\ncurrent": (12.2, 0.0),
    "motor, capstan, handle\nposition": (6.1, 2.1),
    "hand\nforce": (10.0, 2.1),
}
WAYS = "encoder>position>wall>guard>drive>motor, capstan, handle>encoder", "position>estimator>wall"
HAND = "hand>motor, capstan, handle>hand"

figure, axes = plt.subplots(figsize=(9.6, 4))
places = {name.partition("\n")[0]: place for name, place in BOXES.items()}
for way in (*WAYS, HAND):
    for start, end in pairwise(way.split(">")):
        arrow = {"arrowstyle": "-|>", "color": "0.35", "shrinkA": 36, "shrinkB": 50}
        axes.annotate("", places[end], places[start], arrowprops=arrow)
for text, (x, y) in BOXES.items():
    box = {"boxstyle": "round,pad=0.5", "facecolor": "#eaf1fb" if y <= 0 else "#fdf0e2", "edgecolor": "0.4"}
    axes.text(x, y, text, ha="center", va="center", fontsize=10, bbox=box)
for x in (1.15, 11.1):
    axes.axvline(x, ymax=0.6, color="0.6", linestyle="--")
axes.set(xlim=(-0.9, 13.0), ylim=(-2.2, 2.8))
axes.axis("off")
figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
