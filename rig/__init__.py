"""Real-time control of 1-DOF haptic rigs: dual-rate virtual walls, velocity estimators, wall-hit experiments.

``__all__`` lists the public names, which stay stable; everything else may change with any version. The list is in
``__init__.pyi`` beside this file, and each name is loaded on first use, so that ``import rig`` is fast. `rig.testing`
contains checks for tests of a lab's own laws and estimators.
"""

from rig.core.lazy import loader, public_names

_NAMES = public_names(__file__)
__all__ = sorted(_NAMES)  # noqa: PLE0605  (a list of texts)
__getattr__ = loader(__name__, _NAMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *_NAMES})
