"""Read the limits of a device and its link for a design: highest rate, capacity, and delay of a law on this computer.

`rig design` calls this module.
"""

from dataclasses import replace

from rig import devices
from rig.config import Experiment, rig_model
from rig.devices.local import open_for_run
from rig.doctor.gate import measured_once
from rig.experiments.design._listing import LawPlace
from rig.firmware.tick_budget import BOARD, named_budget


def places_of(url: str, experiment: Experiment, board: str = BOARD) -> tuple[LawPlace, ...]:
    """Return where a control law may run with a device, with rates and delay: this computer, and the device if it can.

    The link's delay is measured; nothing moves. Raise `ConfigError` or `LinkLostError` if the device does not open or
    reply.
    """
    named_budget(board)
    where = devices.url_for(url, experiment.controller.loop)
    with open_for_run(
        where,
        rig_model(experiment),
        in_real_time=False,
        seed=experiment.trial.seed,
        realtime=experiment.host.realtime,
    ) as device:
        fastest, carried = device.dictionary.position_rate_maximum, device.link.bytes_per_second
        round_trip_s = None
        if not device.link.clock.virtual:
            measured = measured_once(device, experiment.host, experiment.controller.position_rate)
            round_trip_s = measured.late_s
        own_board = LawPlace(loop="device", rate_maximum=fastest, bytes_per_second=carried, board=board)
        host = replace(own_board, loop="host", round_trip_s=round_trip_s)
        own = device.dictionary.parameter("law")
        if own is None or own.maximum < 1:
            return (host,)
        return host, own_board
