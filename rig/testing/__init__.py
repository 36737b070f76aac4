"""Tools for a lab's own tests: checks of laws and estimators, a pytest plug-in, scripted faults, golden recordings.

pytest loads `rig.testing.plugin` in every run where this package is installed, so the names below are imported on first
use. Tests get most of them as fixtures; their types are exported for annotations::

    from rig.testing import FaultWords, Hits, assert_safe, assert_stable

    def test_our_wall_is_stable(rig_hit: Hits) -> None:
        assert_stable(rig_hit("mine.toml", {"wall.stiffness": 300.0}))

    def test_a_pulled_plug_is_harmless(rig_hit: Hits, rig_faults: FaultWords) -> None:
        rig_faults.link("unplug", tick=400)
        assert_safe(rig_hit("mine.toml"), within_ms=20.0)

Labs import it in their own tests, and the pages of `rig.docs` show it. This file must not import its parts eagerly, and
no other package may depend on it.
"""

from rig.core.lazy import loader, public_names

_NAMES = public_names(__file__)
__all__ = sorted(_NAMES)  # noqa: PLE0605  (a list of texts)
__getattr__ = loader(__name__, _NAMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *_NAMES})
