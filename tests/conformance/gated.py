"""A device that counts as real, behind a link of a chosen delay: arming must pass the gate and the pulse first."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from rig import config
from rig.config import Experiment
from rig.devices.framed import FramedDevice
from rig.doctor import gate
from rig.experiments.hits import admission
from rig.experiments.hits import hit as hits
from rig.experiments.hits.hit import HitRequest, in_effect
from sim_backend.board.make_device import make_device
from sim_backend.ends.link import MemoryLink
from tests.conformance.claimed import claim_to_be_real
from tests.conformance.made_links import link

SLOW_S = 0.05  # there and back: longer than any command lives
REFUSED = "this wall must not be armed"


class Started(Exception):  # noqa: N818  (it is no error)
    """Raised where a trial would begin: the hit was allowed."""


class Pushed(Exception):  # noqa: N818  (it is no error)
    """Raised where the torque pulse would begin."""


def end_before_the_pulse(monkeypatch: pytest.MonkeyPatch) -> None:
    def pulse(*_: Any, **__: Any) -> Any:
        raise Pushed

    monkeypatch.setattr(admission, "pulse", pulse)


def open_as_real(monkeypatch: pytest.MonkeyPatch, travel_s: float) -> None:
    """Let each hit open such a device whatever its URL; a trial that begins raises `Started`."""
    claim_to_be_real(monkeypatch)

    @contextmanager
    def opened(request: HitRequest) -> Iterator[tuple[FramedDevice, Experiment]]:
        rates = {"position_rate_default": 1000, "position_rate_maximum": 20_000}
        device, _ = make_device(config.rig_model(request.experiment), False, **rates)
        memory = MemoryLink(device)
        memory.clock.virtual = False  # type: ignore[attr-defined]
        with FramedDevice(memory) as framed:
            yield framed, in_effect(request.experiment, framed, request.changes)

    def started(*_: Any) -> Any:
        raise Started

    monkeypatch.setattr(hits, "_open_device", opened)
    monkeypatch.setattr(hits, "run_trial", started)
    monkeypatch.setattr(gate, "measure_link", lambda *_, **__: link(travel_s))
