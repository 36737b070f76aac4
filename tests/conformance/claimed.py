"""Simulated devices that claim to be real ones, which people must have verified before they move."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import sim_backend.board.device
import sim_backend.board.firmware
from sim_backend.board.configuration import describe


def claim_to_be_real(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every simulated device that is made from now on say so."""

    def claimed(*arguments: Any) -> Any:
        return replace(describe(*arguments), simulated=False)

    for module in (sim_backend.board.device, sim_backend.board.firmware):
        monkeypatch.setattr(module, "describe", claimed)
