"""The rigs of the two papers, as experiment files whose comments say where each number is from."""

from __future__ import annotations

from rig.config.files import preset_names as names
from rig.config.files import preset_text as text
from rig.config.load import experiment_from_mapping, load_experiment
from rig.config.sections import Experiment

__all__ = ["load", "load_named", "names", "text"]


def load(name: str) -> Experiment:
    """Return a preset's experiment; `ConfigError` (with the closest name) when there is none of that name."""
    return experiment_from_mapping({"preset": name}, f"preset {name}")


def load_named(name: str) -> Experiment:
    """Load a TOML file or a built-in rig, whichever the name is."""
    return load_experiment(name) if name.endswith(".toml") else load(name)
