"""Load built-in experiment files (presets): rigs of the two papers, and real rigs.

Comments in the files give the sources of the numbers. Commands, theory, `rig.doctor`, sessions, the reproductions of
papers and `rig.testing` load them. Nothing here writes a file or opens a device.
"""

from pathlib import Path

from rig.config._files import preset_names as names
from rig.config._files import preset_text as text
from rig.config._load import experiment_from_mapping, load_experiment
from rig.config._sections import Experiment

__all__ = ["load", "load_named", "names", "text"]


def load(name: str) -> Experiment:
    """Return the experiment of the preset `name`; raise `ConfigError` (with the closest name) for an unknown name."""
    return experiment_from_mapping({"preset": name}, f"preset {name}")


def load_named(name: str | Path | Experiment) -> Experiment:
    """Load a TOML file (a `Path`, or text with "/" or final ".toml"), else a preset; an `Experiment` is unchanged."""
    if isinstance(name, Experiment):
        return name
    if isinstance(name, Path) or name.endswith(".toml") or "/" in name:
        return load_experiment(name)
    return load(name)
