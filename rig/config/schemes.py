"""Sampling scheme: rates of position and velocity, and the velocity estimator.

It has a text form for the command line::

    dual:20k/2k                        position at 20 kHz, velocity at 2 kHz, the experiment's own estimator
    uniform:20k                        position and velocity at 20 kHz
    dual:20k/2k,estimator=kalman       another estimator, with its defaults
    uniform:20k,cutoff_hz=1000         settings of the estimator
    dual:20k/2k,prediction=extrapolate,slow_velocity_rate=500,slow_below=0.1

If a sampling scheme gives no cut-off, the experiment's cut-off is scaled with the velocity rate: 200 Hz at 2 kHz become
2 kHz at 20 kHz, as Koul et al. compare their schemes. With `controller.scheme_cutoff` = "same" it is not scaled.

Theory, maps, comparisons, the design, sessions and the console call it. It must not run or judge a scheme.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

from rig.config._derive import check_plugins
from rig.config._load import override
from rig.config._sections import Experiment
from rig.control import estimators
from rig.core.errors import ConfigError

_KINDS = ("uniform", "dual")
# Keys of [controller] besides rates and estimator that a scheme may set.
_OWN = ("prediction", "slow_velocity_rate", "slow_below")
_CUTOFF = "cutoff_hz"
# Cut-off over velocity rate, for a filter that the experiment does not use.
_USUAL_SHARE = 0.1
# In place of an estimator that is not linear, in linear theory: without damping an estimator has no effect, and with
# damping an adaptive one has at best a little less lag than this filter, which was designed for the same noise.
STAND_IN = "fdm-butterworth"
_SUFFIXES = {"k": 1e3, "M": 1e6, "": 1.0}
_FORM = "write dual:20k/2k or uniform:20k, then settings like ,estimator=kalman,cutoff_hz=200"

Prediction = Literal["hold", "extrapolate"]


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """A sampling scheme: rates, velocity estimator and prediction.

    Fields that are None are taken from the experiment to which the sampling scheme is applied.

    Attributes
    ----------
    position_rate, velocity_rate
        Position rate 1/T1 and velocity rate 1/T2 (Hz).
    estimator
        Name of the velocity estimator.
    parameters
        Settings of the estimator; they replace the experiment's settings if the estimator is the same.
    prediction
        How the velocity continues between two velocity samples: ``hold`` or ``extrapolate``.
    slow_velocity_rate, slow_below
        Adaptive T2: velocity rate (Hz) while the handle is slower than `slow_below` (rad/s or m/s).
    """

    position_rate: int
    velocity_rate: int
    estimator: str | None = None
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    prediction: Prediction | None = None
    slow_velocity_rate: int | None = None
    slow_below: float | None = None

    @classmethod
    def parse(cls, text: str) -> Scheme:
        """Read a sampling scheme from text like ``dual:20k/2k,cutoff_hz=200``; raise `ConfigError` if it is invalid."""
        head, *settings = text.split(",")
        kind, colon, rates = head.strip().partition(":")
        if kind not in _KINDS or not colon:
            raise ConfigError(
                f"sampling scheme {text!r} must begin with 'uniform:' (one rate) or 'dual:' (two rates)",
                remedy=_FORM,
            )
        position_rate, velocity_rate = parse_rates(rates)
        if kind == "uniform" and position_rate != velocity_rate:
            raise ConfigError(
                f"scheme {text!r} has two rates, but uniform sampling has one, for position and velocity",
                remedy=f"write dual:{rates}, or uniform: with one rate",
            )
        if kind == "dual" and "/" not in rates:
            raise ConfigError(
                f"scheme {text!r} has one rate, but dual sampling has two, for position and velocity",
                remedy=f"write dual:{rates}/2k, or uniform:{rates}",
            )
        given = dict(_setting(setting, text) for setting in settings)
        own = {key: given.pop(key) for key in _OWN if key in given}
        estimator = given.pop("estimator", None)
        return cls(
            position_rate=position_rate,
            velocity_rate=velocity_rate,
            estimator=None if estimator is None else str(estimator),
            parameters=given,
            **_check_types(own, text),
        )

    @classmethod
    def of(cls, experiment: Experiment) -> Scheme:
        """Return the sampling scheme of an experiment: its rates, estimator, estimator settings and prediction."""
        controller = experiment.controller
        return cls(
            position_rate=controller.position_rate,
            velocity_rate=controller.velocity_rate,
            estimator=controller.estimator,
            parameters=dict(controller.parameters),
            prediction=controller.prediction,
            slow_velocity_rate=controller.slow_velocity_rate,
            slow_below=controller.slow_below,
        )

    @property
    def kind(self) -> str:
        """Return ``uniform`` if position and velocity rate are equal, else ``dual``."""
        return "uniform" if self.position_rate == self.velocity_rate else "dual"

    @cached_property
    def text(self) -> str:
        """Return the sampling scheme as text like ``dual:20k/2k,cutoff_hz=200``, which `parse` reads."""
        rates = f"{_kilo(self.position_rate)}"
        if self.kind == "dual":
            rates += f"/{_kilo(self.velocity_rate)}"
        settings: dict[str, Any] = {"estimator": self.estimator, **self.parameters}
        settings |= {key: getattr(self, key) for key in _OWN}
        shown = [f"{key}={_number(value)}" for key, value in settings.items() if value is not None]
        return ",".join([f"{self.kind}:{rates}", *shown])

    def label(self, experiment: Experiment) -> str:
        """Return a legend text for the sampling scheme applied to an experiment: rates, estimator and its settings."""
        controller = self.on(experiment).controller
        fast, slow = controller.position_rate / 1e3, controller.velocity_rate / 1e3
        rates = f"{fast:g} kHz" if fast == slow else f"{fast:g}/{slow:g} kHz"
        text = f"{self.kind} {rates}, {controller.estimator}"
        others = dict(self.parameters)
        cutoff = controller.parameters.get(_CUTOFF)
        if cutoff is not None:
            text += f" {cutoff:g} Hz"
            others.pop(_CUTOFF, None)
        text += "".join(f", {key} {_number(value)}" for key, value in others.items())
        if controller.prediction != "hold":
            text += ", extrapolated"
        if controller.slow_below > 0.0 and controller.slow_velocity_rate is not None:
            text += f", {controller.slow_velocity_rate:g} Hz below {controller.slow_below:g}"
        return text

    def applied(self, experiment: Experiment) -> Experiment:
        """Return the experiment with the rates and the estimator of this sampling scheme; check all values and rules.

        Raises
        ------
        ConfigError
            The rates are not multiples, or the estimator or a setting is unknown.
        """
        applied = self.on(experiment, check_rules=True)
        check_plugins(applied, f"scheme {self.text}")
        return applied

    def on(self, experiment: Experiment, *, check_rules: bool = False) -> Experiment:
        """Return the experiment with the rates and the estimator of this sampling scheme; check each new value alone.

        `check_rules` also checks the rules between keys. Values for real time of the controller's keys are dropped.
        """
        changes: dict[str, Any] = {
            "controller.position_rate": self.position_rate,
            "controller.velocity_rate": self.velocity_rate,
            "controller.estimator": self.estimator or experiment.controller.estimator,
            "controller.parameters": self._parameters_on(experiment),
            **{f"controller.{key}": getattr(self, key) for key in _OWN if getattr(self, key) is not None},
        }
        gentler = {
            key: value for key, value in experiment.realtime.items() if not key.startswith("controller.")
        }
        bare = replace(experiment, controller=replace(experiment.controller, parameters={}), realtime=gentler)
        return override(bare, changes, f"scheme {self.text}", check_rules=check_rules)

    def _parameters_on(self, experiment: Experiment) -> dict[str, float | str]:
        """Return the estimator's settings: those of this sampling scheme, completed by those of the experiment.

        The experiment's cut-off is scaled with the velocity rate, unless `controller.scheme_cutoff` is "same".
        """
        own = experiment.controller
        inherits = self.estimator in (None, own.estimator)
        settings = (
            dict(own.parameters) if inherits else usual_settings(str(self.estimator), self.velocity_rate)
        )
        cutoff = own.parameters.get(_CUTOFF)
        if _CUTOFF in settings and isinstance(cutoff, int | float):
            if own.scheme_cutoff == "same":
                settings[_CUTOFF] = cutoff
            elif inherits:
                settings[_CUTOFF] = cutoff * (self.velocity_rate / own.velocity_rate)
        return {**settings, **self.parameters}


def describe_cutoffs(schemes: Iterable[Scheme], experiment: Experiment) -> str | None:
    """Return a sentence with the cut-off (Hz) at each velocity rate; None if it is the same for all sampling schemes.

    Schemes that state their own cut-off are ignored.
    """
    own = experiment.controller
    unstated = [
        own,
        *(scheme.on(experiment).controller for scheme in schemes if _CUTOFF not in scheme.parameters),
    ]
    found = {c.velocity_rate: c.parameters[_CUTOFF] for c in unstated if _CUTOFF in c.parameters}
    if len(set(found.values())) < 2:
        return None
    each = ", ".join(f"{cutoff:g} Hz at {rate / 1e3:g} kHz" for rate, cutoff in found.items())
    return (
        f"cut-offs differ as the velocity rates do, as in the paper: {each}; "
        'controller.scheme_cutoff = "same" compares the rates alone'
    )


def parse_rates(text: str) -> tuple[int, int]:
    """Return position and velocity rate (Hz) of ``20k/2k``, or ``1k`` for both; raise `ConfigError` for other text."""
    parts = text.split("/")
    if len(parts) > 2:
        raise ConfigError(
            f"rate {text}: too many rates ({len(parts)}); at most 2 are allowed",
            remedy="give position rate / velocity rate, like 20k/2k",
        )
    rates = [_hertz(part, text) for part in parts]
    return rates[0], rates[-1]


def usual_settings(estimator: str, velocity_rate: int) -> dict[str, float | str]:
    """Return the default settings of an estimator: ``cutoff_hz`` at a tenth of the velocity rate, or no setting."""
    return {_CUTOFF: _USUAL_SHARE * velocity_rate} if _has_cutoff(estimator) else {}


def _hertz(part: str, text: str) -> int:
    number = part.strip().removesuffix("Hz").strip()
    suffix = number[-1:] if number[-1:] in ("k", "M") else ""
    try:
        # 16.1 · 1000 is 16100.000000000002
        hertz = round(float(number.removesuffix(suffix)) * _SUFFIXES[suffix], 6)
    except ValueError:
        hertz = 0.5
    if hertz != hertz // 1 or hertz <= 0:
        raise ConfigError(
            f"rate {text}: {part!r} is not a whole number of Hz", remedy="write 20k/2k or 20000/2000"
        )
    return int(hertz)


def _setting(text: str, whole: str) -> tuple[str, float | str]:
    key, equals, value = (part.strip() for part in text.partition("="))
    if not key or not equals or not value:
        raise ConfigError(f"scheme {whole!r}: {text!r} is not a setting: expected key=value", remedy=_FORM)
    try:
        return key, float(value)
    except ValueError:
        return key, value


def _check_types(own: Mapping[str, float | str], text: str) -> dict[str, Any]:
    """Return the sampling scheme's keys of ``[controller]`` with checked types; `applied` checks their ranges."""
    checked: dict[str, Any] = dict(own)
    for key in ("slow_velocity_rate", "slow_below"):
        if isinstance(checked.get(key, 0.0), str):
            raise ConfigError(f"scheme {text!r}: {key} = {checked[key]!r} is not a number", remedy=_FORM)
    rate = checked.get("slow_velocity_rate")
    if rate is not None:
        if rate != rate // 1:
            raise ConfigError(
                f"scheme {text!r}: slow_velocity_rate = {rate:g} is not a whole number of Hz", remedy=_FORM
            )
        checked["slow_velocity_rate"] = int(rate)
    return checked


def _has_cutoff(estimator: str) -> bool:
    # An unknown estimator is refused later, together with all other problems.
    known = estimator in estimators.names()
    return known and any(setting.name == _CUTOFF for setting in estimators.get(estimator).settings)


def _kilo(rate: int) -> str:
    if rate < 1000 or rate % 100:
        return str(rate)
    return f"{rate // 1000}.{rate % 1000 // 100}k".replace(".0k", "k")


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else repr(float(value)).removesuffix(".0")
