"""The loop's scheduling for a measurement, where this installation has `rig.scheduling`."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from importlib import import_module
from typing import cast

from rig.config import Host
from rig.doctor.round_trip import Realtime


def scheduled(host: Host, *, virtual: bool) -> AbstractContextManager[Realtime | None]:
    """Return `rig.scheduling.obtained` for a host's settings."""
    try:
        scheduling = import_module("rig.scheduling")
    except ModuleNotFoundError:
        return nullcontext(None)
    return cast("AbstractContextManager[Realtime]", scheduling.obtained(host, virtual=virtual))
