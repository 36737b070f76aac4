"""Create the experiments of a test from a preset, a file or an object, with changed values.

The plug-in's fixtures use it. It must not change a file.
"""

from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from rig import config
from rig.config import Experiment, presets

DEFAULT = "koul-compliant"
Source = Experiment | str | PathLike[str] | None

# A run of some sixty ticks that begins at its start: to be repeated for every frame of its link.
SHORT: Mapping[str, Any] = {
    "homing.settle_s": 0.003,
    "trial.duration_s": 0.03,
    "trial.release_s": 0.003,
    "verdict.tail_s": 0.01,
}


class Experiments:
    """Callable that creates the experiments of a test (the fixture ``rig_experiment``).

    Parameters
    ----------
    default
        Preset, file or experiment that is used if a call names none.
    directory
        Directory of the test's file, to which relative paths refer.
    """

    def __init__(self, default: Source, directory: Path) -> None:
        self._default = DEFAULT if default is None else default
        self._directory = directory

    def __call__(self, source: Source = None, changes: Mapping[str, Any] | None = None) -> Experiment:
        """Return the experiment of a preset, a file or an object, with changed values.

        Raise `ConfigError` if the source or a change is not valid.

        Parameters
        ----------
        source
            A preset's name, a path that ends in .toml, an experiment, or None for the test's default experiment.
        changes
            New values by dotted key, like ``{"wall.stiffness": 400.0}``.
        """
        experiment = self._load(self._default if source is None else source)
        return config.override(experiment, changes, "the test") if changes else experiment

    def short(self, source: Source = None, changes: Mapping[str, Any] | None = None) -> Experiment:
        """Return an experiment for real time with a trial of about 60 ticks, for the marker ``rig_every_frame``.

        `source` and `changes` are those of a call; raise `ConfigError` if one of them is not valid.
        """
        experiment = self(source)
        at_its_start = {"rig.simulation.initial_position": experiment.trial.start}
        return config.with_realtime(experiment, {**at_its_start, **SHORT, **(changes or {})})

    def _load(self, source: Experiment | str | PathLike[str]) -> Experiment:
        if isinstance(source, Experiment):
            return source
        name = fspath(source)
        return (
            config.load_experiment(self._directory / name) if name.endswith(".toml") else presets.load(name)
        )
