"""What a rig is, from what it did: fits on plain arrays of time, effort and position; nothing here runs a rig.

* `signs`: small pushes → does a positive effort raise the position, does the handle accelerate as expected;
* `sliding`: strokes at constant speeds → Coulomb friction each way, viscous damping;
* `dynamics`: multisines → inertia, delay and the first structural mode;
* `quality`: when data are refused, and why; `interval`: values with their 95 % confidence.

Efforts are in N·m or N, positions in rad or m, as everywhere.
"""
