"""Define short names for keys of an experiment, like ``stiffness`` for ``wall.stiffness``.

Commands, requests, and the functions of `rig.experiments.lab` and `rig.experiments.measure` use these names for their
settings. Keys without a short name are set with ``changes``, by their full dotted keys. This module must not repeat a
key's type, range or unit, which `rig.config` defines.
"""

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, TypeVar, get_type_hints

from annotated_types import Ge, Le

from rig.config import Experiment, parameters
from rig.core.errors import ConfigError
from rig.core.keyword import Keyword, keywords

F = TypeVar("F", bound=Callable[..., Any])

_ENTRY = re.compile(r"^\*\*\w+\n(?:    .*\n)+", re.MULTILINE)  # entry of a docstring


def _key(key: str, help: str = "", *names: str) -> Keyword:
    return Keyword(help, key, names, "Experiment")


class Settings(TypedDict, total=False):
    """Keywords that set the push and the sampling of an experiment, without the wall."""

    side: Annotated[Literal[-1, 1], _key("wall.side")]
    pull: Annotated[Literal["clamp", "allow"], _key("wall.pull")]
    damping_on: Annotated[Literal["both", "entry"], _key("wall.damping_on")]
    position_rate: Annotated[int, _key("controller.position_rate")]
    velocity_rate: Annotated[int, _key("controller.velocity_rate")]
    parameters: Annotated[Mapping[str, float | str], _key("controller.parameters")]
    prediction: Annotated[Literal["hold", "extrapolate"], _key("controller.prediction")]
    loop: Annotated[
        Literal["host", "device"],
        _key("controller.loop", "Where the law runs: on this computer, or on the device."),
    ]
    friction_compensation: Annotated[float, _key("controller.friction_compensation")]
    effort: Annotated[
        float, _key("trial.effort", "Constant push of the motor, without a hand at the handle (N·m or N).")
    ]
    start: Annotated[float, _key("trial.start", "Position at which the handle is released (rad or m).")]
    duration_s: Annotated[float, _key("trial.duration_s", "Length of the push (s).", "--duration")]
    release_s: Annotated[float, _key("trial.release_s")]
    minimum_rest_counts: Annotated[float, _key("trial.minimum_rest_counts")]
    seed: Annotated[int, Ge(0), _key("trial.seed", "Seed of the simulation's sensor noise.")]
    operator: Literal["none", "relaxed", "normal", "firm"]
    changes: Mapping[str, Any]


class WallSettings(Settings, total=False):
    """Keywords that set the push, the sampling, and the wall's stiffness and damping of an experiment."""

    stiffness: Annotated[
        float, _key("wall.stiffness", "Wall stiffness (N·m/rad or N/m).", "-K", "--stiffness")
    ]
    damping: Annotated[float, _key("wall.damping", "Wall damping (N·m·s/rad or N·s/m).", "-B", "--damping")]


class HitSettings(WallSettings, total=False):
    """Keywords that set the push, the sampling, the wall, and the number of hits of an experiment."""

    repeats: Annotated[int, Ge(1), Le(100_000), _key("trial.repeats", "Number of hits.")]


def _excitation(key: str, help: str) -> Keyword:
    return Keyword(help, f"excitation.{key}", group="Excitation and judgement")


class ExcitationSettings(TypedDict, total=False):
    """Keywords that set the excitation of a rig; `band` is its lowest and its highest frequency (Hz)."""

    channel: Annotated[
        Literal["external", "motor"],
        _excitation("channel", "Actuator that excites the rig. [external; on a device motor]"),
    ]
    kind: Annotated[Literal["schroeder", "random"], _excitation("kind", "Phases of the multisine. [random]")]
    band: Annotated[
        tuple[float, float],
        Keyword(
            "Lines of the excitation (Hz). [1:250]", "", (), "Excitation and judgement", "band", "LOW:HIGH"
        ),
    ]
    realisations: Annotated[
        int, _excitation("realisations", "Runs with other phases. [4; of kind schroeder 1]")
    ]
    periods: Annotated[int, _excitation("periods", "Analysed periods of a realisation. [4]")]
    amplitude: Annotated[
        float, _excitation("rms", "Rms effort of the excitation (N·m or N). [10 × Coulomb friction]")
    ]
    seed: Annotated[int, Ge(0), Keyword("Seed of the phases.", "excitation.seed", group="Experiment")]


@dataclass(frozen=True, slots=True, kw_only=True)
class RigRequest:
    """A request to a rig: its experiment, changes and device.

    Attributes
    ----------
    experiment
        Validated experiment, before `changes`.
    url
        URL of the device; None simulates the experiment's rig in this process, in virtual time.
    changes
        Values by dotted key that the user set by hand; they override all other values.
    verified
        True if the operator has checked the signs of motor and encoder, so that a real rig may be moved. If False, a
        real device does not arm.
    """

    experiment: Experiment
    url: Annotated[
        str | None,
        Keyword(
            "serial:///dev/ttyACM0, usb://1209:0001, sim://. [simulates the rig in this process]",
            group="Device",
            values="url",
        ),
    ] = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    verified: Annotated[
        bool,
        Keyword(
            "On a real rig: encoder and motor signs were checked, and the handle is at position zero.",
            group="Device",
        ),
    ] = False
    output: Annotated[
        str | Path, Keyword("Directory of the recordings.", "", ("-o", "--output"), "Result", "path")
    ] = "recordings"


def changes_of(options: Mapping[str, Any], known: type) -> dict[str, Any]:
    """Return values by dotted key of an experiment for `options`, values by short name like ``stiffness``.

    The option ``changes``, values by dotted key, overrides all other options. `known` is the TypedDict of the permitted
    names. Raise `ConfigError` for an unknown name; the error proposes the closest permitted name.
    """
    names, keys = get_type_hints(known), keywords(known)
    changes: dict[str, Any] = {}
    for name, value in options.items():
        if name not in names:
            close = get_close_matches(name, names, n=1)
            remedy = f"did you mean {close[0]}?" if close else f"choose one of: {', '.join(names)}"
            raise ConfigError(f"unknown setting {name!r}", remedy=remedy)
        if name == "operator":
            changes |= _pushed_by(str(value))
        elif name in keys:
            changes[keys[name].key] = value
    return changes | dict(options.get("changes", {}))


def _pushed_by(operator: str) -> dict[str, Any]:
    """Return by key who pushes the handle: a hand with the grip `operator`, or the motor if it is "none"."""
    if operator == "none":
        return {"trial.kind": "constant-effort"}
    return {"trial.kind": "human", "operator.grip": operator}


def takes(options: type, request: type = RigRequest) -> Callable[[F], F]:
    """Return a decorator that shows the keywords behind ``**options`` in a function's signature and docstring.

    `options` is the TypedDict of the keywords; the dataclass `request` supplies default values of some keywords.
    """
    hints, own = get_type_hints(options), keywords(request)
    all_keywords = {**own, **keywords(options)}

    def shown(function: F) -> F:
        signature = inspect.signature(function)
        keyword = partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
        named = [
            keyword(name, annotation=hint, default=own[name].default if name in own else ...)
            for name, hint in hints.items()
        ]
        every = [*list(signature.parameters.values())[:-1], *named]
        function.__dict__["__signature__"] = signature.replace(parameters=every)
        lines = "".join(
            f"    * `{name}`: {_meaning(all_keywords[name])}\n" for name in hints if name in all_keywords
        )
        text = inspect.cleandoc(function.__doc__ or "")  # as Python does itself from 3.13 on
        function.__doc__ = _ENTRY.sub(lambda found: f"{found[0]}\n{lines}", f"{text}\n")
        return function

    return shown


def _meaning(one: Keyword) -> str:
    key = parameters().get(one.key)
    return f"{key.meaning}; {key.expected(None)} (``{one.key}``)" if key else one.help
