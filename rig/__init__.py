"""Real-time control of 1-DOF haptic rigs: dual-rate virtual walls, velocity estimators, wall-hit experiments.

What is public and stable is what ``__all__`` has: the list stands in ``__init__.pyi`` beside this file, for a type
checker, an editor and this module alike, and each name is loaded on first use, so that ``import rig`` costs nothing.
`rig.testing` has what tests of a lab's own laws and estimators call. Everything else may change with any version.
"""

from __future__ import annotations

from rig.core.lazy import loader, public_names

_NAMES = public_names(__file__)
__all__ = sorted(_NAMES)  # noqa: PLE0605  (a list of texts)
__getattr__ = loader(__name__, _NAMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *_NAMES})
