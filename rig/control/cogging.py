"""Cogging: the effort that a motor's position alone decides, in compiled code."""

from __future__ import annotations

import math
from typing import Any

from rig.realtime.kernel import kernel

WAVENUMBER, COSINE, SINE, HARMONIC = range(4)  # of one harmonic; how many numbers it has


@kernel("f8(f8, f8[::1])", inline=True, no_refcount=True)
def effort_at(position: float, harmonics: Any) -> float:
    """Effort (N·m or N) at a position (rad or m), of harmonics as `rig.core.model.Cogging.harmonics` has them."""
    effort = 0.0
    for i in range(0, harmonics.shape[0], HARMONIC):
        angle = harmonics[i + WAVENUMBER] * position
        effort += harmonics[i + COSINE] * math.cos(angle) + harmonics[i + SINE] * math.sin(angle)
    return effort
