"""Simulated devices that report to be real ones, which an operator must verify before they move."""

from dataclasses import replace
from typing import Any

import pytest

import sim_backend.board.device
import sim_backend.board.firmware
from sim_backend.board.configuration import describe


def claim_to_be_real(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every simulated device that is created from now on report that it is real."""

    def claimed(*arguments: Any) -> Any:
        return replace(describe(*arguments), simulated=False)

    for module in (sim_backend.board.device, sim_backend.board.firmware):
        monkeypatch.setattr(module, "describe", claimed)
