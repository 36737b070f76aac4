"""Version of the installed package haptic-rig."""

from importlib.metadata import version

__version__ = version("haptic-rig")
