"""Options that several commands share: which experiment, with which changes, and how to print."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from rig import config
from rig.config import Experiment, presets
from rig.config.schemes import parse_rates
from rig.core.errors import ConfigError
from rig.views.plots.style import FORMATS

F = TypeVar("F", bound=Callable[..., Any])

DEFAULT_PRESET = "koul-compliant"

arm_anyway_option = click.option(
    "--arm-anyway",
    is_flag=True,
    help="Arm a real rig although its link, as measured, makes this wall dangerous; `rig doctor` says why.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for machines.")
PICTURE_NAME = "its name ends in .png, .svg or .pdf"


def picture_format_option(help: str, default: str | None) -> Callable[[F], F]:
    """The option that chooses a format of pictures, by its ending."""
    return click.option(
        "--picture-format", type=click.Choice(tuple(FORMATS)), default=default, show_default=True, help=help
    )


def plot_options(help: str = "Draw a picture.") -> Callable[[F], F]:
    """Add the options of a picture; the command receives its format as `plot`, empty where none is wanted."""

    def add(command: F) -> F:
        @wraps(command)
        def called(*, plot: bool, picture_format: str, **others: Any) -> Any:
            return command(plot=picture_format if plot else "", **others)

        called = picture_format_option("Of the picture.", "png")(called)
        return click.option("--plot/--no-plot", default=True, help=help)(called)  # type: ignore[return-value]

    return add


# Option → key of the experiment.
_KEYS = {
    "stiffness": "wall.stiffness",
    "damping": "wall.damping",
    "estimator": "controller.estimator",
    "loop": "controller.loop",
    "effort": "trial.effort",
    "start": "trial.start",
    "duration": "trial.duration_s",
    "repeats": "trial.repeats",
    "seed": "trial.seed",
}


def experiment_options(command: F) -> F:
    """Add the options that choose and change an experiment; the command receives them as `**chosen`."""
    options = [
        click.argument("file", required=False, type=click.Path(path_type=Path)),
        click.option(
            "--rig", "preset", metavar="NAME", help=f"Built-in rig, when no FILE is given. [{DEFAULT_PRESET}]"
        ),
        click.option("-K", "--stiffness", type=float, help="Wall stiffness (N·m/rad or N/m)."),
        click.option("-B", "--damping", type=float, help="Wall damping (N·m·s/rad or N·s/m)."),
        click.option(
            "--rate", metavar="T1[/T2]", help="Position rate and velocity rate: 20k/2k; uniform: 1k."
        ),
        click.option("--estimator", help="Velocity estimator."),
        click.option(
            "--loop",
            type=click.Choice(["host", "device"]),
            help="Where the law runs: on this computer, or on the device.",
        ),
        click.option("--effort", type=float, help="Constant push (N·m or N)."),
        click.option(
            "--operator",
            type=click.Choice(["none", "relaxed", "normal", "firm"]),
            help="Who pushes: a person's hand with this grip, or none: the motor alone.",
        ),
        click.option("--start", type=float, help="Where the handle is released (rad or m)."),
        click.option("--duration", type=float, help="Length of the push (s)."),
        click.option("--repeats", type=int, help="How many hits."),
        click.option("--seed", type=int, help="Seed of the simulation's sensor noise."),
        click.option(
            "--set", "sets", multiple=True, metavar="KEY=VALUE", help="Any other key: --set wall.pull=allow."
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def free_rig_options(command: F) -> F:
    """Add the options of a rig that nobody holds; the command receives the arguments of a `FreeRigRequest`."""
    options = [
        click.argument("file", required=False, type=click.Path(path_type=Path)),
        click.option("--rig", "preset", metavar="NAME", help="Built-in rig, when no FILE is given."),
        click.option(
            "--set",
            "sets",
            multiple=True,
            metavar="KEY=VALUE",
            help="Any other key: --set rig.limits.speed=5.",
        ),
        click.option(
            "--url", help="Device: serial:///dev/ttyACM0, sim://. [simulates the rig in this process]"
        ),
        click.option(
            "--verified", is_flag=True, help="On a real rig: a push of the wrong sign can hurt nothing."
        ),
        click.option(
            "-o",
            "--output",
            type=click.Path(path_type=Path),
            default=Path("recordings"),
            show_default=True,
            help="Directory of the recordings.",
        ),
    ]

    @wraps(command)
    def called(
        *,
        file: Path | None,
        preset: str | None,
        sets: tuple[str, ...],
        url: str | None,
        verified: bool,
        output: Path,
        **others: Any,
    ) -> Any:
        asked = {
            "experiment": chosen_experiment(file, preset or preset_of(url, file)),
            "url": url,
            "changes": changes(None, sets),
            "verified": verified,
            "output": output,
        }
        return command(asked=asked, **others)

    for option in reversed(options):
        called = option(called)
    return called  # type: ignore[return-value]


def compare_options(command: F) -> F:
    """Add the options of `rig hit --compare`."""
    options = [
        click.option(
            "--compare", is_flag=True, help="Simulate the same hit under several schemes; records nothing."
        ),
        click.option(
            "--scheme",
            "schemes",
            multiple=True,
            metavar="SCHEME",
            help="To compare: none, uniform:20k, dual:20k/2k,estimator=kalman … [none, uniform and dual-rate]",
        ),
        click.option(
            "--as-in-the-paper",
            is_flag=True,
            help="Compare under the conditions of figures 7 and 8 of Koul et al., in floating and in fixed point.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def chosen_experiment(file: Path | None, preset: str | None) -> Experiment:
    """Load the file, else the named preset, else the default one."""
    if file is not None and preset is not None:
        raise ConfigError(
            "both a file and --rig are given", remedy='write preset = "…" into the file, or drop --rig'
        )
    if file is not None:
        return config.load_experiment(file)
    return presets.load(preset or DEFAULT_PRESET)


def preset_of(url: str | None, file: Path | None) -> str | None:
    """Return the preset that a ``sim://name`` names, when no file says what the experiment is."""
    if url is None or file is not None or not url.startswith("sim://"):
        return None
    return url.removeprefix("sim://").partition("?")[0] or None


def changes(
    rate: str | None, sets: tuple[str, ...], operator: str | None = None, **named: Any
) -> dict[str, Any]:
    """Return what the user set by hand, by dotted key."""
    changed = {_KEYS[name]: value for name, value in named.items() if value is not None}
    if operator == "none":
        changed["trial.kind"] = "constant-effort"
    elif operator is not None:
        changed |= {"trial.kind": "human", "operator.grip": operator}
    if rate is not None:
        changed["controller.position_rate"], changed["controller.velocity_rate"] = parse_rate(rate)
    for text in sets:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise ConfigError(
                f"--set {text}: no value", remedy="write --set key=value, like --set wall.pull=allow"
            )
        changed[key.strip()] = _value(value.strip())
    return changed


def key_values(texts: tuple[str, ...]) -> dict[str, Any]:
    """Return arguments KEY=VALUE by key, values as TOML has them."""
    changed: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"{text}: no value", remedy="write key=value, like wall.pull=allow")
        changed[key.strip()] = _value(value.strip())
    return changed


def parse_rate(text: str) -> tuple[int, int]:
    """Rates of an option ``--rate``, in Hz, as schemes have them."""
    try:
        return parse_rates(text)
    except ConfigError as error:
        raise ConfigError(f"--{error.message}", remedy=error.remedy) from None


def _value(text: str) -> Any:
    """Read a TOML value; text that is none is taken as a string, so that quotes may be left out."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
