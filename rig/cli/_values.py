"""Types of option values that a shell completes by name, without slow imports.

Options of all commands use them, and `complete` replies to shells with them. This file must not import a slow package,
such as numpy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from rig.cli._listing import listing
from rig.core import plugins
from rig.core.errors import ConfigError

_PRESETS = Path(__file__).parents[1] / "config" / "presets"
_PORTS = ("ttyACM*", "ttyUSB*", "cu.usbmodem*")
GRIPS = ("none", "relaxed", "normal", "firm")  # rig.core.operators.GRIPS and none, without its imports
_RECORDING = (".parquet", ".rigcap")


class Named(click.ParamType):  # type: ignore[type-arg]  # click before 8.4 cannot subscript it
    """A text value with completions for the shell; the command checks the value itself."""

    def __init__(self, name: str, known: Callable[[str], Iterable[str]]) -> None:
        self.name = name
        self._known = known

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the known values that begin with the incomplete word."""
        return [CompletionItem(each) for each in self._known(incomplete) if each.startswith(incomplete)]


class Files(click.Path):
    """A path value; the shell completes directories, and files with the given endings."""

    def __init__(self, name: str, *endings: str) -> None:
        super().__init__(path_type=Path)
        self.name = name
        self._endings = endings

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the paths that begin with the incomplete word."""
        return [CompletionItem(each) for each in paths(incomplete, self._endings)]


class FrequencyBand(click.ParamType):  # type: ignore[type-arg]  # as above
    """A frequency band (Hz), written as LOW:HIGH."""

    name = "band"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float, float]:
        """Return the lowest and the highest frequency (Hz) of a text LOW:HIGH; raise `ConfigError` for another text."""
        try:
            low, high = (float(part) for part in value.split(":"))
        except ValueError:
            # Not a number: no comparison below holds, so that one message covers text and range.
            low = high = math.nan
        if not 0.0 < low <= high < math.inf:
            raise ConfigError(
                f"{param.opts[-1]} {value} is not a frequency band",
                remedy="write it as LOW:HIGH in Hz, like 1:250",
            )
        return low, high


def paths(incomplete: str, endings: tuple[str, ...]) -> Iterator[str]:
    """Yield the path of each directory, and of each file with one of the endings, that completes the word."""
    place, _, begun = incomplete.rpartition("/")
    before = f"{place}/" if "/" in incomplete else ""
    try:
        entries = sorted(Path(before or ".").expanduser().iterdir())
    # A shell asks for completions while a path is half typed: such a directory often does not exist.
    except OSError:
        return
    for entry in entries:
        if not entry.name.startswith(begun) or (entry.name.startswith(".") and not begun):
            continue
        if entry.is_dir():
            yield f"{before}{entry.name}/"
        elif entry.name.endswith(endings):
            yield before + entry.name


def presets() -> list[str]:
    """Return the sorted names of the built-in rigs."""
    return sorted(path.stem for path in _PRESETS.glob("*.toml"))


def estimators() -> list[str]:
    """Return the names of all velocity estimators, plug-ins included."""
    known: list[str] = listing()["estimators"]
    return [*known, *(point.name for point in plugins.find_plugins("rig.estimators", known))]


def _rigs(incomplete: str) -> Iterator[str]:
    yield from presets()
    yield from paths(incomplete, (".toml",))


def _schemes(incomplete: str) -> Iterator[str]:
    """Yield how a shell may complete a sampling scheme: to a kind or, after a comma, to a setting; never to a rate."""
    begun, comma, _ = incomplete.rpartition(",")
    if not comma:
        yield from ("none", "uniform:", "dual:")
        return
    yield from (f"{begun},estimator={name}" for name in estimators())
    yield from (f"{begun},{key}=" for key in ("cutoff_hz", "prediction", "slow_velocity_rate", "slow_below"))


def _urls(incomplete: str) -> Iterator[str]:
    yield "sim://"
    yield from (f"sim://{name}" for name in presets())
    ports = [str(port) for kind in _PORTS for port in sorted(Path("/dev").glob(kind))]
    yield from (f"serial://{port}" for port in ports if port.isprintable() and not {"%", "?"} & set(port))
    yield "usb://"


def _signals(incomplete: str) -> list[str]:
    known: list[str] = listing()["signals"]
    return known


RIG = Named("rig", _rigs)
ESTIMATOR = Named("estimator", lambda incomplete: estimators())
SCHEME = Named("scheme", _schemes)
GRIP = Named("grip", lambda incomplete: GRIPS)
URL = Named("url", _urls)
SIGNAL = Named("signal", _signals)
EXPERIMENT_FILE = Files("toml", ".toml")
RECORDING = Files("recording", *_RECORDING)
PATH = click.Path(path_type=Path)
BAND = FrequencyBand()
KINDS: dict[str, click.ParamType[Any]] = {
    kind.name: kind
    for kind in (RIG, ESTIMATOR, SCHEME, GRIP, URL, SIGNAL, EXPERIMENT_FILE, RECORDING, PATH, BAND)
}
