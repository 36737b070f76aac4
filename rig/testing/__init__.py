"""What a lab's own tests call: conformance of laws and estimators, and hits with faults in pytest.

`rig.testing.plugin` is loaded in every run of pytest where this package is installed, so the names below are loaded on
first use: importing both costs milliseconds. Tests get nearly everything as fixtures, whose types are here for those
who annotate them::

    from rig.testing import FaultWords, Hits, assert_safe, assert_stable

    def test_our_wall_is_stable(rig_hit: Hits) -> None:
        assert_stable(rig_hit("mine.toml", {"wall.stiffness": 300.0}))

    def test_a_pulled_plug_is_harmless(rig_hit: Hits, rig_faults: FaultWords) -> None:
        rig_faults.link("unplug", tick=400)
        assert_safe(rig_hit("mine.toml"), within_ms=20.0)
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from rig.testing.asserts import assert_limit, assert_passive, assert_safe, assert_stable
    from rig.testing.every_frame import with_every_frame
    from rig.testing.experiments import Experiments
    from rig.testing.fault_words import FaultWords
    from rig.testing.golden import Golden
    from rig.testing.hits import Hit, Hits, Rigs
    from rig.testing.kept import Kept, tidy
    from rig.testing.maps import Maps
    from rig.testing.served import SerialRig, serve_rig

__all__ = [
    "Experiments",
    "FaultWords",
    "Golden",
    "Hit",
    "Hits",
    "Kept",
    "Maps",
    "Rigs",
    "SerialRig",
    "assert_limit",
    "assert_passive",
    "assert_safe",
    "assert_stable",
    "serve_rig",
    "tidy",
    "with_every_frame",
]

# Name → module of this room that has it.
_LAZY: dict[str, str] = {
    "Experiments": "rig.testing.experiments",
    "FaultWords": "rig.testing.fault_words",
    "Golden": "rig.testing.golden",
    "Hit": "rig.testing.hits",
    "Hits": "rig.testing.hits",
    "Kept": "rig.testing.kept",
    "Maps": "rig.testing.maps",
    "Rigs": "rig.testing.hits",
    "SerialRig": "rig.testing.served",
    "assert_limit": "rig.testing.asserts",
    "assert_passive": "rig.testing.asserts",
    "assert_safe": "rig.testing.asserts",
    "assert_stable": "rig.testing.asserts",
    "serve_rig": "rig.testing.served",
    "tidy": "rig.testing.kept",
    "with_every_frame": "rig.testing.every_frame",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'rig.testing' has no attribute {name!r}")
