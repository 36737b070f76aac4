"""Definition of a velocity estimator: a compiled update, its memory, and a design of its parameters.

The update is called once for each velocity sample (every N-th tick of a dual-rate loop). Its only information about
rates is the velocity period in its parameter vector, whose first two entries are the same for all estimators.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import ConfigError
from rig.core.present import Item, Row
from rig.core.shown import Shown

RESOLUTION = 0  # parameters[0]: travel for one count, signed as the encoder counts (rad or m)
PERIOD = 1  # parameters[1]: velocity period T2 (s)
COMMON = 2  # parameters from here on belong to the estimator
WINDOW = 0  # state_i[0]: velocity periods that the last estimate spans, which is what the row shows
OWN_INTS = 1  # state_i from here on belongs to the estimator

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Setting:
    """A numeric setting of an estimator: default (None: must be given), range, unit and meaning.

    If `of_rig` is True and the setting is not given, an experiment uses the rig's property of the same name
    (`rig.config.settings_of_rig`).
    """

    name: str
    default: float | None
    minimum: float
    maximum: float
    unit: str
    meaning: str
    of_rig: bool = False


@dataclass(frozen=True, slots=True)
class Choice:
    """A setting of an estimator with named options: default, options and meaning."""

    name: str
    default: str
    choices: tuple[str, ...]
    meaning: str


@dataclass(frozen=True, slots=True, repr=False)
class Estimator(Shown):
    """Definition of a velocity estimator.

    `design(settings, resolution, period_s)` returns the parameters that follow the two common parameters; it raises
    `ConfigError` if they cannot be realised at that period. `update` is the compiled function that is called for each
    velocity sample (`rig.realtime.plugs.ESTIMATOR_SIGNATURE`). `floats` and `ints` are the sizes of the memory that it
    keeps between calls. `uses_effort` is True if the estimator needs the motor's effort. `position` is the index, in
    the floats of the memory, of estimated position minus newest count (counts); None if the estimator estimates no
    position.
    """

    name: str
    summary: str
    source: str
    update: Any
    floats: int
    ints: int
    settings: tuple[Setting | Choice, ...] = ()
    design: Callable[[Mapping[str, Any], float, float], list[float]] = field(default=lambda s, r, p: [])
    uses_effort: bool = False
    position: int | None = None

    def settings_of(self, rig: Mapping[str, float]) -> dict[str, float]:
        """Return those properties of a rig, by name, that are settings of this estimator."""
        wanted = {one.name for one in self.settings if isinstance(one, Setting) and one.of_rig}
        return {name: value for name, value in rig.items() if name in wanted}

    def brief(self) -> list[Item]:
        """Return name, summary and settings of the estimator, for display."""
        rows = [
            Row(one.name, "from the rig", "", one.meaning)
            if isinstance(one, Setting) and one.of_rig
            else Row(one.name, one.default, one.unit if isinstance(one, Setting) else "", one.meaning)
            for one in self.settings
        ]
        return [f"estimator {self.name}: {self.summary}", *rows]

    def prepare(self, given: Mapping[str, float | str], resolution: float, period_s: float) -> Prepared:
        """Check the settings; return the estimator with its computed parameters, and with its memory set to zero.

        Parameters
        ----------
        given
            Settings by name; a setting that is not given has its default.
        resolution
            Travel for one count (rad or m), negative when counts fall while the position rises.
        period_s
            Velocity period T2 (s).

        Raises
        ------
        ConfigError
            A setting is unknown, missing or out of range, or impossible at this period.
        """
        known = {s.name: s for s in self.settings}
        for name in given:
            if name not in known:
                choice = ", ".join(known) or "none"
                raise ConfigError(
                    f"estimator {self.name}: unknown parameter {name!r}",
                    remedy=f"remove {name!r}; the estimator's parameters are: {choice}",
                )
        values = {
            name: self._checked(setting, given.get(name, setting.default)) for name, setting in known.items()
        }
        own = self.design(values, resolution, period_s)
        parameters = np.array([resolution, period_s, *own], dtype=np.float64)
        return Prepared(
            self,
            parameters,
            np.zeros(max(1, self.floats)),
            np.zeros(max(OWN_INTS, self.ints), dtype=np.int64),
        )

    def _checked(self, setting: Setting | Choice, value: float | str | None) -> float | str:
        if isinstance(setting, Choice):
            if value not in setting.choices:
                raise ConfigError(
                    f"estimator {self.name}: {setting.name} = {value!r} is unknown",
                    remedy=f"choose one of: {', '.join(setting.choices)}",
                )
            return str(value)
        if value is None:
            raise ConfigError(
                f"estimator {self.name} needs the setting {setting.name}, which is missing",
                remedy=f"give {setting.name} in {setting.unit}: {setting.meaning}",
            )
        if isinstance(value, str):
            raise ConfigError(
                f"estimator {self.name}: {setting.name} = {value!r} is not a number",
                remedy=f"give {setting.minimum:g} to {setting.maximum:g} {setting.unit}",
            )
        if not setting.minimum <= value <= setting.maximum:
            unit = f" {setting.unit}" if setting.unit else ""
            raise ConfigError(
                f"estimator {self.name}: {setting.name} = {value:g}{unit} is out of range",
                remedy=f"choose {setting.minimum:g} to {setting.maximum:g}{unit}",
            )
        return float(value)


def check_below_nyquist(
    estimator: str, setting: str, frequency_hz: float, period_s: float, advice: str = ""
) -> None:
    """Raise `ConfigError`, with `advice`, if a setting is at or above the Nyquist frequency 0.5 / `period_s` (Hz)."""
    if frequency_hz >= 0.5 / period_s:
        raise ConfigError(
            f"estimator {estimator}: {setting} = {frequency_hz:g} Hz is not below the Nyquist frequency "
            f"{0.5 / period_s:g} Hz",
            remedy=f"choose a lower {setting}, {advice}or raise velocity_rate",
        )


@dataclass(frozen=True, slots=True)
class Prepared:
    """A velocity estimator ready to run, with its parameters and its memory, which changes in each call."""

    estimator: Estimator
    parameters: Floats
    state_f: Floats
    state_i: Ints

    def fits(self) -> bool:
        """Return True if the estimator's parameters and memory have the sizes that the compiled code requires."""
        sizes = (max(1, self.estimator.floats),), (max(OWN_INTS, self.estimator.ints),)
        enough = self.parameters.ndim == 1 and len(self.parameters) >= COMMON
        return enough and (self.state_f.shape, self.state_i.shape) == sizes
