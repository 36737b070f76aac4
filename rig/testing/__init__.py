"""What a lab's own tests call: conformance of laws and estimators, and hits with faults in pytest."""

from __future__ import annotations

from rig.core.lazy import loader, public_names

_NAMES = public_names(__file__)
__all__ = sorted(_NAMES)  # noqa: PLE0605  (a list of texts)
__getattr__ = loader(__name__, _NAMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *_NAMES})
