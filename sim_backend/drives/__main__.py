"""``python -m sim_backend.drives``: serve a simulated drive, and print the port or bus that a host opens."""

import argparse
import json
import sys
from pathlib import Path

from rig import config
from rig.config import presets
from rig.core import program
from rig.core.errors import RigError

if sys.platform == "linux":
    from sim_backend.drives.odrive import SimulatedOdrive
    from sim_backend.drives.process import serve

assert sys.platform == "linux"


def main() -> int:
    """Serve a simulated drive until a signal ends the program; return its exit status."""
    program.begin()
    parser = argparse.ArgumentParser(prog="python -m sim_backend.drives", description=__doc__)
    parser.add_argument("kind", choices=("moteus", "odrive"))
    parser.add_argument("--rig", required=True, help="a preset or an experiment file")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        help='fault such as "drop to=host frame=12"; can be given several times',
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        help="setting of the drive, such as servo.timeout_mode=0; can be given several times",
    )
    parser.add_argument(
        "--firmware", type=lambda text: int(text, 0), help="firmware version; 0x010203 is 1.2.3"
    )
    parser.add_argument(
        "--adapter",
        choices=("uart", "fdcanusb"),
        default="uart",
        help="protocol of the adapter, for a moteus without a CAN bus",
    )
    parser.add_argument("--bus", help="a CAN interface, or the path of a socket to create")
    parser.add_argument("--endpoints", type=Path, help="path to write an ODrive's flat_endpoints.json to")
    given = parser.parse_args()
    if given.endpoints is not None:
        given.endpoints.write_text(json.dumps(SimulatedOdrive.flat_endpoints()), encoding="utf-8")
    try:
        serve(
            given.kind,
            config.rig_model(presets.load_named(given.rig)),
            faults=given.fault,
            settings=dict(setting.partition("=")[::2] for setting in given.set),
            firmware=given.firmware,
            adapter=given.adapter,
            place=given.bus,
            realtime="try",
            announce=lambda place: print(place, flush=True),
        )
    except RigError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
