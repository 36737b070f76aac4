"""Estimate and judge the mechanical impedance (effort over velocity) of a rig and of the walls that it renders.

`rig.experiments` and the reproductions of papers call this package with arrays of an excited run (the excitation is
`rig.control.excitation.Multisine`) and receive numbers. Nothing here runs a loop, simulates a rig or opens a recording.
"""

from rig.analysis.impedance._estimate import Impedance, periodic
from rig.analysis.impedance._fitting import Fit, RigidRig, fit
from rig.analysis.impedance._ideal import bare, ideal_wall, rendered_impedance, walls
from rig.analysis.impedance._signals import Complexes, ExcitedRun, Floats, hold
from rig.analysis.impedance._verdict import (
    EFFECTIVE_HZ,
    EFFECTIVE_LINES,
    RESIDUAL,
    Z_SCORE,
    Fidelity,
    PassivityJudgement,
    fidelity,
    judge,
)
from rig.analysis.impedance._welch import estimate_welch

__all__ = [
    "EFFECTIVE_HZ", "EFFECTIVE_LINES", "RESIDUAL", "Z_SCORE", "Complexes", "ExcitedRun", "Fidelity", "Fit",
    "Floats", "Impedance", "PassivityJudgement", "RigidRig", "bare", "estimate_welch", "fidelity", "fit",
    "hold", "ideal_wall", "judge", "periodic", "rendered_impedance", "walls",
]  # fmt: skip
