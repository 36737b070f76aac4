"""Compute the disk space for the recordings of a session, and check that it is available.

`rig session check` shows it; a session does not begin on a disk with too little space.
"""

import shutil
from pathlib import Path

from rig.config import Experiment
from rig.core.errors import ConfigError
from rig.recording.files import plain_errors
from rig.session.planning._conditions import Walls
from rig.session.planning._expected import likely_trials
from rig.session.planning._schedule import schedule
from rig.session.planning._times import trial_times

TICK_BYTES = 35.0  # of a sealed recording: 30 to 40 were measured
TRIAL_BYTES = 100e3  # of header, trailer and metadata of one recording


def bytes_of_trial(experiment: Experiment) -> float:
    """Return the expected size (bytes) of the recording of one trial."""
    seconds = trial_times(experiment).recorded
    return TRIAL_BYTES + TICK_BYTES * seconds * experiment.controller.position_rate


def refuse_full_disk(walls: Walls, row: int, place: Path) -> None:
    """Raise `ConfigError` if the disk of directory `place` has too little free space for the recordings of a session.

    The directory need not exist yet. `row` is the participant's row in the table of condition orders.
    """
    protocol = walls.protocol
    trials = likely_trials(protocol, schedule(protocol, row))
    needed = 0.0
    for condition in protocol.condition:
        experiment = walls.softest(condition)
        needed += trials[condition.name] * bytes_of_trial(experiment)
    here = next(one for one in (place, *place.absolute().parents) if one.exists())
    with plain_errors("read the free space of", here):
        free = shutil.disk_usage(here).free
    if free < needed:
        raise ConfigError(
            f"the disk of {here} has {format_size(free)} of free space; the recordings of a session of about "
            f"{sum(trials.values()):.0f} trials need {format_size(needed)}",
            remedy="free some space, or give a directory on another disk with `study`",
        )


def format_size(size: float) -> str:
    """Return a size in bytes as text in MB or GB."""
    return f"{size / 1e9:.2g} GB" if size >= 1e9 else f"{size / 1e6:.{0 if size >= 1e7 else 1}f} MB"
