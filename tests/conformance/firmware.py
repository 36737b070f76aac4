"""Whether this machine can make the firmware's library, for tests that need it."""

from __future__ import annotations

import pytest

from rig.core.errors import ConfigError
from rig.realtime import _c_library as c_library
from sim_backend.board import firmware_library, make_device


def need_compiler() -> None:
    """Skip without a C compiler."""
    try:
        firmware_library.FIRMWARE.compiler()
    except ConfigError:
        pytest.skip("no C compiler is installed (package gcc)")


def hide_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """Be a machine without a C compiler, whose library has not been opened before."""
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(c_library, "COMPILERS", ())
    monkeypatch.setattr(c_library, "ZIG", "no compiler")
    monkeypatch.setattr(make_device, "library", firmware_library.library.__wrapped__)
