"""Skip or simulate: a machine without a C compiler for the firmware's library."""

import pytest

from rig.core.errors import ConfigError
from rig.realtime import _c_library as c_library
from sim_backend.board import firmware_library, make_device


def need_compiler() -> None:
    try:
        firmware_library.FIRMWARE.compiler()
    except ConfigError:
        pytest.skip("no C compiler is installed (package gcc)")


def hide_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate a machine without a C compiler and without a cached library."""
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(c_library, "COMPILERS", ())
    monkeypatch.setattr(c_library, "ZIG", "no compiler")
    monkeypatch.setattr(make_device, "library", firmware_library.library.__wrapped__)
