"""A build warns, with numbers, when its board is too slow or its set-point too coarse."""

from dataclasses import replace
from pathlib import Path

import pytest

from rig import config
from rig.config import presets
from rig.firmware._build import BuildRequest, _warnings
from rig.firmware.tick_budget import named_budget

PICO = named_budget("rp2040")


@pytest.mark.parametrize(
    ("rate", "estimator", "says"),
    [
        (
            20_000,
            "fdm-butterworth",
            "7103 cycles a tick on rp2040 (Cortex-M0+, 200 MHz, no floating-point unit)",
        ),
        (10_000, "fdm-butterworth", ""),
        (2_000, "foaw-best", "at most 1.57 kHz; choose a rate of at most 1568 Hz"),
        (20_000, "fdm-butterworth-fixed", ""),
    ],
)
def test_a_law_that_the_processor_has_no_time_for_is_warned_of(rate: int, estimator: str, says: str) -> None:
    # A bug that was there: a float law was built for a board without a float unit without a warning.
    changes = {
        "controller.loop": "device", "controller.position_rate": rate, "controller.velocity_rate": rate,
        "controller.estimator": estimator,
    }  # fmt: skip
    x = config.override(presets.load("koul-rigid"), changes)
    request = BuildRequest(model=config.rig_model(x), board="rp2040", output=Path(), controller=x.controller)
    found = " ".join(_warnings(request, PICO, 0.001))
    assert says in found
    assert bool(found) is bool(says)
    on_host = config.override(x, {"controller.loop": "host"}).controller
    assert not _warnings(replace(request, controller=on_host), PICO, None)


def test_a_set_point_coarser_than_the_commands_is_a_warning_with_the_value_to_set() -> None:
    request = BuildRequest(model=config.rig_model(presets.load("koul-rigid")), board="rp2040", output=Path())
    assert _warnings(request, PICO, 0.002) == ()
    (found,) = _warnings(request, PICO, 0.025)
    assert "0.025 A, 25 times the rig's current_quantum_a = 0.001 A" in found
    assert "set rig.amplifier.current_quantum_a = 0.025" in found
