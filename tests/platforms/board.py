"""A simulated board that reports to be a real one: ``python -m tests.platforms.board`` prints the URL of its port.

It runs the firmware with its laws. The handle is free, and the hold-to-run switch is held.
"""

from dataclasses import replace
from typing import Any
from unittest.mock import patch

from rig import config
from rig.config import presets
from rig.devices.local import serve
from sim_backend.board import firmware
from sim_backend.board.make_device import make_device
from sim_backend.ends import pty


def main() -> None:
    described = firmware.describe

    def held(*given: Any, **options: Any) -> Any:
        device, messages = make_device(*given, **options)
        device.hold_to_run(True)
        return device, messages

    def announce(path: str) -> None:
        print(f"serial://{path}", flush=True)

    with (
        patch.object(firmware, "describe", lambda *given: replace(described(*given), simulated=False)),
        patch.object(pty, "make_device", held),
    ):
        bare = config.override(presets.load("koul-rigid"), {"rig.mechanics.end_mass": 0.0})  # for a hand
        serve(config.rig_model(bare), rate=5000, firmware=True, announce=announce)


if __name__ == "__main__":
    main()
