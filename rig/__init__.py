"""Real-time control of 1-DOF haptic rigs: dual-rate virtual walls, velocity estimators, wall-hit experiments.

The names below are loaded on first use, so that ``import rig`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # `typing` would be most of what ``import rig`` costs
if TYPE_CHECKING:
    from typing import Any

# Name → module that has it.
_LAZY: dict[str, str] = {
    "ESTIMATOR_SIGNATURE": "rig.realtime.plugs",
    "HitRequest": "rig.experiments.hit",
    "HitResult": "rig.experiments.hit",
    "LAW_SIGNATURE": "rig.realtime.plugs",
    "Law": "rig.control.law",
    "NativeFunction": "rig.realtime.plugs",
    "Plan": "rig.experiments.planned",
    "Recording": "rig.recording.data",
    "RigError": "rig.core.errors",
    "Scheme": "rig.config.schemes",
    "Verdict": "rig.control.verdict",
    "cut_recording": "rig.experiments.cutting",
    "export": "rig.recording.export",
    "hit": "rig.experiments.hit",
    "kernel": "rig.realtime.kernel",
    "load_experiment": "rig.config",
    "load_preset": "rig.config.presets",
    "make_plan": "rig.experiments.plan",
    "open_device": "rig.devices",
    "open_recording": "rig.recording.reader",
    "override": "rig.config",
    "replay": "rig.experiments.replay",
    "zwidth": "rig.experiments.maps",
}
_RENAMED = {"load_preset": "load"}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("haptic-rig")
    if name == "theory":
        return import_module("rig.analysis.theory")
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), _RENAMED.get(name, name))
    raise AttributeError(f"module 'rig' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY, "theory"})
