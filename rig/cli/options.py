"""Options that several commands share, each defined once, so that names and values are the same in all commands.

Commands of the core and of extras use them as decorators. This file must not run anything; it only checks values.
"""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import click

from rig import config
from rig.cli import _values as values
from rig.cli import command, output
from rig.cli._keyword_options import gathered_options as gathered_options  # noqa: PLC0414  (extras take it)
from rig.cli._keyword_options import keyword_options
from rig.cli.command import DEVICE, EXPERIMENT, RESULT, option
from rig.config import Experiment, SchemeCutoff, presets
from rig.config.schemes import parse_rates
from rig.core.errors import ConfigError, RecordingError, RigError
from rig.core.keyword import Keyword, keywords
from rig.devices.device import DeviceUrl
from rig.experiments.trials.settings import ExcitationSettings, HitSettings, RigRequest, changes_of
from rig.views.plots.style import FORMATS

F = TypeVar("F", bound=Callable[..., Any])

DEFAULT_PRESET = "koul-compliant"
EXCITED_PRESET = "chawda-linear"  # of what excites a rig

json_option = command.json_option


def added(*options: Callable[[F], F]) -> Callable[[F], F]:
    """Return one decorator that adds several options, shown in this order on the help page."""

    def add(function: F) -> F:
        for one in reversed(options):
            function = one(function)
        return function

    return add


# ------------------------------------------------------------------ the experiment

file_argument = click.argument("file", required=False, type=values.EXPERIMENT_FILE)


def rig_option(default: str = DEFAULT_PRESET, *, given: bool = False) -> Callable[[F], F]:
    """Return a decorator that adds the option --rig, a built-in rig or a TOML file.

    Without the option, the command receives `default` if `given` is True, otherwise None.
    """
    more: dict[str, Any] = {"default": default, "show_default": True} if given else {}
    help = "Built-in rig or TOML file." + ("" if given or not default else f" [{default}]")
    return option(
        "--rig", "preset", group=EXPERIMENT, metavar="NAME|FILE", type=values.RIG, help=help, **more
    )


class CommandSettings(HitSettings, total=False):
    """Settings of the experiment that have a command-line option of their own, except rates and operator."""

    estimator: Annotated[str, Keyword(key="controller.estimator")]
    cutoff: Annotated[
        SchemeCutoff,
        Keyword(
            "Cut-off of schemes without one of their own: the same share of each velocity rate, or "
            "the same in Hz. [as-in-the-paper]",
            "controller.scheme_cutoff",
            group="Experiment",
        ),
    ]


_OF_CHANGES = {"rate", "sets", *get_type_hints(CommandSettings)}
wall_options = keyword_options(CommandSettings, "stiffness", "damping")


def walls_options(stiffness: str, damping: str) -> Callable[[F], F]:
    """Return a decorator that adds --stiffness and --damping as lists of values, with these help texts."""
    return added(
        option("-K", "--stiffness", group=EXPERIMENT, metavar="K,…|FROM:TO[:N]", help=stiffness),
        option("-B", "--damping", group=EXPERIMENT, metavar="B,…|FROM:TO:N", help=damping),
    )


class Hertz(click.ParamType):  # type: ignore[type-arg]  # click before 8.4 cannot subscript it
    """A rate in hertz as the value of an option, written as 2000 or 2k."""

    name = "rate"

    def __init__(self, lowest: int, highest: int) -> None:
        self._lowest, self._highest = lowest, highest

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the rate in Hz; fail with a usage error if it is outside of the allowed range."""
        if isinstance(value, int):
            return value
        try:
            rate, _ = parse_rates(value)
        except ConfigError:
            # Below every allowed range: the message below covers what is no number, too.
            rate = 0
        if "/" in value or not self._lowest <= rate <= self._highest:
            self.fail(
                f"{value!r} is not a rate: give one from {self._lowest} to {self._highest} Hz, like 2k",
                param,
                ctx,
            )
        return rate


def rate_option(help: str, metavar: str = "T1[/T2]") -> Callable[[F], F]:
    """Return a decorator that adds the option --rate, the position rate and velocity rate of the loop."""
    return option("--rate", group=EXPERIMENT, metavar=metavar, help=help)


def estimator_option(help: str = "Velocity estimator.", **more: Any) -> Callable[[F], F]:
    """Return a decorator that adds the option --estimator, the name of a velocity estimator."""
    return option(
        "--estimator", *more.pop("names", ()), group=EXPERIMENT, type=values.ESTIMATOR, help=help, **more
    )


cutoff_option = keyword_options(CommandSettings, "cutoff")


def scheme_option(default: str, group: str = EXPERIMENT) -> Callable[[F], F]:
    """Return a decorator that adds --scheme (sampling schemes to compare) and --cutoff (of their velocity filters).

    `default` describes the default schemes in the help text.
    """
    return added(
        option(
            "--scheme",
            "schemes",
            group=group,
            multiple=True,
            metavar="SCHEME",
            type=values.SCHEME,
            help=f"dual:20k/2k; uniform:20k,cutoff_hz=1000; dual:20k/2k,estimator=kalman …; repeat it. [{default}]",
        ),
        cutoff_option,
    )


def operator_option(help: str) -> Callable[[F], F]:
    """Return a decorator that adds the option --operator, the grip of the hand on the handle."""
    return option("--operator", group=EXPERIMENT, metavar="GRIP", type=values.GRIP, help=help)


effort_option = keyword_options(CommandSettings, "effort")
set_option = option(
    "--set",
    "sets",
    group=EXPERIMENT,
    multiple=True,
    metavar="KEY=VALUE",
    help="Set any other key of the experiment: --set wall.pull=allow.",
)


def seed_option(help: str, group: str = EXPERIMENT, **more: Any) -> Callable[[F], F]:
    """Return a decorator that adds the option --seed, the seed of the command's random numbers."""
    return option("--seed", group=group, type=click.IntRange(0), help=help, **more)


def signal_option(*names: str, help: str, **more: Any) -> Callable[[F], F]:
    """Return a decorator that adds --signal, the name of a synthetic motion on which estimators are tested."""
    return option("--signal", *names, type=values.SIGNAL, help=help, **more)


judge_option = option(
    "--judge",
    "judged",
    type=click.Choice(["true", "recorded"]),
    help="Signals that are judged: those that a rig records, or the true ones of the simulation. "
    "[recorded; impedance maps of a rig with two masses: true]",
)


# ------------------------------------------------------------------ the device


def url_option(default: str) -> Callable[[F], F]:
    """Return a decorator that adds --url, the device; `default` describes what the command does without a device."""
    return option(
        "--url",
        group=DEVICE,
        type=values.URL,
        help=f"serial:///dev/ttyACM0, usb://1209:0001, sim://. [{default}]",
    )


def realtime_option(help: str) -> Callable[[F], F]:
    """Return a decorator that adds the flag --realtime, a run in real time."""
    return option("--realtime", group=DEVICE, is_flag=True, help=help)


verified_option = keyword_options(RigRequest, "verified")
arm_anyway_option = option(
    "--arm-anyway",
    group=DEVICE,
    is_flag=True,
    help="Arm a real rig although the measured link makes this wall dangerous; `rig doctor` explains why.",
)

across_option = option(
    "--across",
    multiple=True,
    metavar="KEY",
    help="Key or section of the protocol, like trial.posture, that may differ between sessions "
    "although it can change the result; the report lists the values. Can be repeated.",
)


def confirm_option(choices: tuple[str, ...], default: str) -> Callable[[F], F]:
    """Return a decorator that adds the option --confirm: when the operator is asked before something moves."""
    return option(
        "--confirm",
        group=DEVICE,
        type=click.Choice(choices),
        help=f"When to ask before a device moves. [{default}]",
    )


# ------------------------------------------------------------------ what comes out


def output_option(default: str | None, help: str, *names: str) -> Callable[[F], F]:
    """Return a decorator that adds -o and --output, the directory or file of the command's result."""
    more: dict[str, Any] = {} if default is None else {"default": Path(default), "show_default": True}
    return option("-o", "--output", *names, group=RESULT, type=click.Path(path_type=Path), help=help, **more)


workers_option = option("--workers", type=click.IntRange(1, 1024), help="Threads. [one for each core]")
scheduler_option = option(
    "--scheduler", metavar="tcp://HOST:PORT", help="Run on a Dask cluster (haptic-rig[cluster])."
)
overwrite_option = option("--overwrite", group=RESULT, is_flag=True, help="Replace existing files.")


def expect_option(verdicts: tuple[str, ...]) -> Callable[[F], F]:
    """Return a decorator that adds --expect, for scripts: exit code 17 unless the verdict is one of the given ones."""
    return option(
        "--expect",
        "expected",
        group=RESULT,
        multiple=True,
        type=click.Choice(verdicts),
        help="End with exit code 17 unless the verdict is this one (repeat the option to accept several).",
    )


VERDICTS = ("stable", "limit-cycle", "unstable", "invalid")  # rig.control.verdict.Kind, without its imports
_DEFAULT_ENDING = "png"


def _plot_option(help: str, default: bool) -> Callable[[F], F]:
    return option("--plot/--no-plot", group=RESULT, default=default, help=help)


def format_option(help: str = "Of the picture.", default: str | None = _DEFAULT_ENDING) -> Callable[[F], F]:
    """Return a decorator that adds the option --format, the file format of pictures."""
    return option(
        "--format",
        "ending",
        group=RESULT,
        type=click.Choice(tuple(FORMATS)),
        default=default,
        show_default=True,
        help=help,
    )


def plot_options(help: str = "Draw a picture.", *, default: bool = True) -> Callable[[F], F]:
    """Return a decorator that adds --plot and --format; the command receives the format as `plot` ("": no picture)."""

    def add(function: F) -> F:
        @wraps(function)
        def called(*, plot: bool, ending: str, **others: Any) -> Any:
            return function(plot=ending if plot else "", **others)

        return added(_plot_option(help, default), format_option())(called)  # type: ignore[return-value]

    return add


@dataclass(slots=True)
class PictureOption:
    """The user's choice of a picture and its path; after `draw` also the path of the drawn picture, or the error."""

    wanted: bool
    path: Path | None
    ending: str | None
    drawn: Path | None = None
    failure: RigError | None = None

    def draw(self, stem: Path, draw: Callable[[Path], Path]) -> None:
        """Draw the picture if the user wants one; report a failure without raising an error.

        The function `draw` writes the picture to the path that it receives: the user's file, or a file beside `stem`.
        """
        if not self.wanted:
            return
        try:
            self.drawn = draw(self.path or stem.with_name(f"{stem.name}.{self.ending or _DEFAULT_ENDING}"))
        except Exception as error:  # a picture has many ways to fail, and the numbers are to come
            output.no_picture(error)
            if self.path is not None:
                other = RecordingError(f"no picture: {error}", remedy="drop --output")
                self.failure = error if isinstance(error, RigError) else other

    def facts(self) -> dict[str, Any]:
        """Return path and error of the picture, for JSON."""
        return {"picture": self.drawn} | ({"error": output.error_facts(self.failure)} if self.failure else {})


def picture_options(help: str, *, default: bool, place: str) -> Callable[[F], F]:
    """Return a decorator that adds the options of a picture that is the command's only file.

    The command receives a `PictureOption` as the argument `picture`. If a file that the user names cannot be drawn, the
    command still prints its numbers and ends with the exit code of the failure.
    """

    def add(function: F) -> F:
        @wraps(function)
        def called(*, plot: bool, path: Path | None, ending: str | None, **others: Any) -> Any:
            if path is not None and ending is not None and path.suffix.lower() != f".{ending}":
                raise ConfigError(
                    f"--output {path} and --format {ending} name different formats",
                    remedy="drop --format, or change the ending of --output",
                )
            picture = PictureOption(plot or path is not None, path, ending)
            result = function(picture=picture, **others)
            return result if picture.failure is None else picture.failure.exit_code

        return added(
            _plot_option(help, default),
            format_option("Format of the picture. [from the ending of its name, or png]", None),
            output_option(None, f"Draw it into this file. [{place}]", "path"),
        )(called)  # type: ignore[return-value]

    return add


# ------------------------------------------------------------------ whole experiments

experiment_options = added(
    file_argument,
    rig_option(),
    wall_options,
    rate_option("Position rate and velocity rate: 20k/2k; uniform: 1k."),
    estimator_option(),
    keyword_options(CommandSettings, "loop", "effort"),
    operator_option("Grip of the hand that pushes (relaxed, normal, firm), or none: the motor pushes."),
    keyword_options(CommandSettings, "start", "duration_s", "repeats", "seed"),
    set_option,
)
"""Which experiment, with which changes; the command receives them as `**chosen`."""


free_rig_options = added(file_argument, rig_option(), set_option)
"""The experiment of a rig without a hand at the handle, with its changes."""


def request_options(request: type, which: Callable[[F], F]) -> Callable[[F], F]:
    """Return a decorator that adds the options `which`, and an option for each field of the dataclass `request`.

    The command receives an instance of the dataclass, built from the options, as the argument `request`.
    """

    def add(function: F) -> F:
        @wraps(function)
        def called(*, file: Path | None, preset: str | None, url: str | None, **given: Any) -> Any:
            own = {name: given.pop(name) for name in keywords(request) if name in given}
            changed = {name: given.pop(name) for name in list(given) if name in _OF_CHANGES}
            experiment = chosen_experiment(file, preset or preset_of(url, file))
            made = request(experiment=experiment, url=url, changes=changes(**changed), **own)
            return function(request=made, **given)

        return added(which, keyword_options(request))(called)  # type: ignore[arg-type]

    return add


def excited_experiment(
    *,
    file: Path | None,
    preset: str | None,
    url: str | None = None,
    sets: tuple[str, ...],
    cutoff: str | None,
    **named: Any,
) -> Experiment:
    """Return the experiment of a rig that is excited to measure its impedance, from the options of a command.

    `named` are settings of the excitation; a value of None leaves the experiment's value.
    """
    given = {name: value for name, value in named.items() if value is not None}
    if url is not None:
        given.setdefault("channel", "motor")
    if given.get("kind") == "schroeder":
        given.setdefault("realisations", 1)
    band = given.pop("band", None)
    changed = changes(None, sets, cutoff=cutoff) | changes_of(given, ExcitationSettings)
    if band is not None:
        changed["excitation.low_hz"], changed["excitation.high_hz"] = band
    preset = preset or preset_of(url, file) or (None if file else EXCITED_PRESET)
    return config.override(chosen_experiment(file, preset), changed)


def chosen_experiment(file: Path | None, preset: str | None) -> Experiment:
    """Return the experiment of the file, of the named preset, or of the default preset; raise if both are given."""
    if file is not None and preset is not None:
        raise ConfigError(
            "both a file and --rig are given", remedy='write preset = "…" into the file, or drop --rig'
        )
    if file is not None:
        return config.load_experiment(file)
    return presets.load_named(preset or DEFAULT_PRESET)


def preset_of(url: str | None, file: Path | None) -> str | None:
    """Return the preset that a URL ``sim://name`` names, if no file describes the experiment; otherwise None."""
    if url is None or file is not None or not url.startswith("sim://"):
        return None
    return DeviceUrl.parse(url).place or None


def changes(rate: str | None = None, sets: tuple[str, ...] = (), **named: Any) -> dict[str, Any]:
    """Return the changed settings by key, like ``wall.stiffness``, from --rate, --set and other options (`named`)."""
    changed = changes_of({name: value for name, value in named.items() if value is not None}, CommandSettings)
    if rate is not None:
        changed["controller.position_rate"], changed["controller.velocity_rate"] = parse_rate(rate)
    for text in sets:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise ConfigError(
                f"--set {text}: no value is given",
                remedy="write it as --set key=value, like --set wall.pull=allow",
            )
        changed[key.strip()] = _value(value.strip())
    return changed


def key_values(texts: tuple[str, ...]) -> dict[str, Any]:
    """Return arguments KEY=VALUE as a mapping; a value is parsed as TOML."""
    changed: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"{text}: the value is missing", remedy="write key=value, like wall.pull=allow")
        changed[key.strip()] = _value(value.strip())
    return changed


def parse_rate(text: str) -> tuple[int, int]:
    """Return position rate and velocity rate (Hz) of the value of an option ``--rate``, such as 20k/2k."""
    try:
        return parse_rates(text)
    except ConfigError as error:
        # The message of `parse_rates` begins with the word rate, which becomes the option's name.
        raise ConfigError(f"--{error.message}", remedy=error.remedy) from None


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
