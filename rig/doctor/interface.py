"""Public names for a whole examination of this computer and a link: machine checks, ports, link, stable walls.

`rig doctor` and `rig.experiments.hits.examine` import it. It defines nothing, and no file of this package imports it.
Code that only arms a wall imports `gate`; code that only plans a run imports `predicted`.
"""

import sys

from rig.doctor._ports import NO_PORTS, Port, ports_here, rules_for_rigs, serial_port
from rig.doctor._round_trip import LinkMeasurement, measure_link
from rig.doctor._walls import Supported, supported_walls, wall_items

if sys.platform == "linux":
    from rig.doctor._machine import machine_checks
else:
    from rig.doctor._elsewhere import machine_checks

__all__ = [
    "NO_PORTS",
    "LinkMeasurement",
    "Port",
    "Supported",
    "machine_checks",
    "measure_link",
    "ports_here",
    "rules_for_rigs",
    "serial_port",
    "supported_walls",
    "wall_items",
]
