"""Define the questions about a new rig: data-sheet values of motor and encoder, and the mechanism.

Each question has its units, its range and its default. `rig.new_rig` has a keyword for each answer, `rig experiment
new` an option or a prompt.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypedDict, cast, get_args, get_type_hints

from rig.config import amplifiers
from rig.config.checked import did_you_mean
from rig.core.errors import ConfigError

Mechanism = Literal["lever", "carriage", "linear-motor"]
Mechanisms = tuple[Mechanism, ...]

LEVER: Mechanisms = ("lever",)
ROTARY_MOTOR: Mechanisms = ("lever", "carriage")
LINEAR_MOTOR: Mechanisms = ("linear-motor",)
CARRIAGES: Mechanisms = ("carriage", "linear-motor")
ANY: Mechanisms = ("lever", "carriage", "linear-motor")

AMPERE = {"A": 1.0, "mA": 1e-3}
METRE = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9}
KILOGRAM = {"kg": 1.0, "g": 1e-3}
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*)", re.DOTALL)
_UNIT_SPELLING = str.maketrans({"·": "", "*": "", " ": "", "⋅": "", "^": "", "²": "2", "µ": "u", "μ": "u"})


@dataclass(frozen=True, slots=True)
class DataSheetQuestion:
    """A question about a new rig, with the allowed answers.

    Attributes
    ----------
    text
        Text of the question.
    units
        Factor to SI for each allowed unit, the SI unit first; None if the answer has no unit.
    low, high
        Smallest and largest allowed value (SI).
    choices
        Allowed names; empty if the answer is a number.
    of
        Mechanisms (lever, carriage, linear motor) for which the question is asked.
    assumed
        Description of the value that is assumed without an answer; empty if an answer is required.
    whole
        True if the answer must be a whole number.
    """

    text: str
    units: Mapping[str, float] | None = None
    low: float = 0.0
    high: float = 0.0
    choices: tuple[str, ...] = ()
    of: Mechanisms = ANY
    assumed: str = ""
    whole: bool = False

    @property
    def unit(self) -> str:
        """Return the SI unit of the answer; empty if the answer is a name or a number without unit."""
        return next(iter(self.units)) if self.units else ""

    @property
    def allowed(self) -> str:
        """Return a text that lists the allowed answers: names, or range and units."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        kind = "a whole number" if self.whole else "a number"
        others = list(self.units or ())[1:]
        units = f" {self.unit}" + (f", or with a unit: {', '.join(others)}" if others else "")
        return f"{kind} from {self.low:g} to {self.high:g}{units if self.unit else ''}"

    def read(self, name: str, text: str) -> Any:
        """Return the answer (SI) in a text like ``38.5 mN·m``; raise `ConfigError`, which quotes `name`, if invalid."""
        if self.choices:
            return self.checked(name, text.strip())
        found = _NUMBER.fullmatch(text.strip())
        known = {_normalise_unit(unit): factor for unit, factor in (self.units or {}).items()}
        unit = _normalise_unit(found[2]) if found else ""
        if found is None or (unit and unit not in known):
            raise ConfigError(
                f"{name} = {text!r} is not a number with a known unit", remedy=f"give {self.allowed}"
            )
        value = float(f"{float(found[1]) * known.get(unit, 1.0):.12g}")
        return self.checked(name, int(value) if self.whole and value.is_integer() else value)

    def checked(self, name: str, value: Any) -> Any:
        """Return the answer `value` (SI) if it is allowed; else raise `ConfigError`, which quotes the key `name`."""
        if self.choices:
            if value in self.choices:
                return value
            remedy = did_you_mean(str(value), self.choices, f"give {self.allowed}")
            raise ConfigError(f"{name} = {value!r} is not known: it must be {self.allowed}", remedy=remedy)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not self.low <= value <= self.high
            or (self.whole and not isinstance(value, int))
        ):
            shown = f"{value:g} {self.unit}".rstrip() if isinstance(value, int | float) else repr(value)
            raise ConfigError(f"{name} = {shown} is out of range", remedy=f"give {self.allowed}")
        return value if self.whole else float(value)


def _normalise_unit(unit: str) -> str:
    return unit.translate(_UNIT_SPELLING).replace("Ω", "ohm").replace("Ω", "ohm").replace("Ohm", "ohm")


class DataSheets(TypedDict, total=False):
    """Answers to the questions about a new rig, in SI units."""

    mechanism: Annotated[
        Mechanism,
        DataSheetQuestion(
            "Mechanism at the hand: a lever turned by a rotary motor, a carriage pulled by a rotary "
            "motor with belt or cable, or a carriage on a linear-motor",
            choices=ANY,
        ),
    ]
    torque_constant: Annotated[
        float,
        DataSheetQuestion(
            "Motor: torque constant (N·m/A)",
            {"N·m/A": 1.0, "mN·m/A": 1e-3},
            1e-4,
            100.0,
            of=ROTARY_MOTOR,
        ),
    ]
    force_constant: Annotated[
        float, DataSheetQuestion("Motor: force constant (N/A)", {"N/A": 1.0}, 0.01, 1e4, of=LINEAR_MOTOR)
    ]
    rotor_inertia: Annotated[
        float,
        DataSheetQuestion(
            "Motor: rotor inertia (kg·m²)",
            {"kg·m²": 1.0, "kg·cm²": 1e-4, "g·cm²": 1e-7},
            1e-10,
            0.1,
            of=ROTARY_MOTOR,
        ),
    ]
    nominal_current: Annotated[
        float, DataSheetQuestion("Motor: nominal (maximum continuous) current (A)", AMPERE, 1e-3, 1e3)
    ]
    winding_resistance: Annotated[
        float,
        DataSheetQuestion(
            "Motor: terminal resistance (ohm)",
            {"ohm": 1.0, "mohm": 1e-3},
            1e-4,
            1e4,
            assumed="assumed not to limit the current",
        ),
    ]
    winding_inductance: Annotated[
        float,
        DataSheetQuestion(
            "Motor: terminal inductance (H)",
            {"H": 1.0, "mH": 1e-3, "µH": 1e-6},
            1e-8,
            10.0,
            assumed="a lag of 0.1 ms",
        ),
    ]
    thermal_time_constant: Annotated[
        float,
        DataSheetQuestion(
            "Motor: thermal time constant of the winding (s)", {"s": 1.0}, 0.1, 1e4, assumed="10 s"
        ),
    ]
    encoder_lines: Annotated[
        int,
        DataSheetQuestion(
            "Encoder: lines (pulses of one channel) per turn, a fourth of its counts",
            None,
            4,
            10_000_000,
            of=ROTARY_MOTOR,
            whole=True,
        ),
    ]
    encoder_resolution: Annotated[
        float, DataSheetQuestion("Encoder: travel for one count (m)", METRE, 1e-10, 1e-2, of=LINEAR_MOTOR)
    ]
    encoder_at: Annotated[
        str,
        DataSheetQuestion(
            "Encoder: on the shaft of the motor or of the lever",
            choices=("motor", "lever"),
            of=LEVER,
            assumed="motor",
        ),
    ]
    transmission: Annotated[
        float,
        DataSheetQuestion(
            "Transmission: turns of the motor for one of the lever; 1: direct drive",
            None,
            1e-2,
            1e3,
            of=LEVER,
        ),
    ]
    pulley_radius: Annotated[
        float,
        DataSheetQuestion(
            "Transmission: radius of the pulley, travel of the carriage for one radian of the motor (m)",
            METRE,
            1e-4,
            1.0,
            of=("carriage",),
        ),
    ]
    handle_length: Annotated[
        float, DataSheetQuestion("Lever: from its axis to the hand (m)", METRE, 5e-3, 2.0, of=LEVER)
    ]
    handle_mass: Annotated[
        float,
        DataSheetQuestion(
            "Lever: mass, assumed to be concentrated at the hand (kg)", KILOGRAM, 0.0, 50.0, of=LEVER
        ),
    ]
    carriage_mass: Annotated[
        float,
        DataSheetQuestion("Carriage: mass of all that slides (kg)", KILOGRAM, 1e-3, 500.0, of=CARRIAGES),
    ]
    friction: Annotated[
        float,
        DataSheetQuestion(
            "Mechanism: force at the hand at which it just begins to move, motor off (N)",
            {"N": 1.0, "mN": 1e-3},
            0.0,
            1e3,
            assumed="5 % of the nominal force",
        ),
    ]
    travel: Annotated[
        float,
        DataSheetQuestion(
            "Mechanism: travel of the hand from stop to stop (m)",
            METRE,
            2e-3,
            10.0,
            assumed="1 rad, or 60 mm of a carriage",
        ),
    ]
    amplifier: Annotated[
        str, DataSheetQuestion("Amplifier: its profile", choices=amplifiers.names(), assumed="generic")
    ]
    peak_current: Annotated[
        float,
        DataSheetQuestion(
            "Amplifier: its current limit setting (A)",
            AMPERE,
            1e-3,
            1e3,
            assumed="twice the nominal current",
        ),
    ]
    supply_voltage: Annotated[
        float,
        DataSheetQuestion(
            "Amplifier: supply voltage (V)", {"V": 1.0}, 1.0, 1e3, assumed="assumed not to limit the current"
        ),
    ]
    board: Annotated[
        str,
        DataSheetQuestion(
            "Board: rp2040 (Raspberry Pi Pico; the law runs on the board), or none (the law runs on "
            "the computer)",
            choices=("rp2040", "none"),
            assumed="rp2040",
        ),
    ]


@cache
def questions() -> Mapping[str, DataSheetQuestion]:
    """Return all questions about a new rig by the name of the answer (like "travel"), in the order of asking."""
    hints = get_type_hints(DataSheets, include_extras=True)
    return {name: get_args(hint)[1] for name, hint in hints.items()}


def questions_for(mechanism: str) -> Mapping[str, DataSheetQuestion]:
    """Return the questions that apply to a mechanism like "lever", by the name of the answer."""
    return {
        name: question
        for name, question in questions().items()
        if mechanism in question.of and name != "mechanism"
    }


def check_answers(answers: Mapping[str, Any]) -> DataSheets:
    """Return the checked answers (SI); raise `ConfigError` for an answer that is unknown, missing or out of range."""
    given = {name: value for name, value in answers.items() if value is not None}
    known = questions()
    for name in given:
        if name not in known:
            raise ConfigError(
                f"unknown data-sheet value {name!r}",
                remedy=did_you_mean(name, tuple(known), f"choose one of: {', '.join(known)}"),
            )
    if "mechanism" not in given:
        raise ConfigError("`mechanism` is missing", remedy=f"give {known['mechanism'].allowed}")
    mechanism = known["mechanism"].checked("mechanism", given["mechanism"])
    asked = questions_for(mechanism)
    surplus = [f"`{name}`" for name in given if name not in asked and name != "mechanism"]
    if surplus:
        raise ConfigError(
            f"{', '.join(surplus)} cannot be given for a {mechanism}", remedy="leave out these values"
        )
    missing = [name for name, question in asked.items() if not question.assumed and name not in given]
    if missing:
        lines = "\n".join(f"  `{name}`: {asked[name].text}; {asked[name].allowed}" for name in missing)
        raise ConfigError(
            f"values are missing for a {mechanism}:\n{lines}\n",
            remedy="take these values from the data sheets of motor and encoder",
        )
    return cast("DataSheets", {name: known[name].checked(name, value) for name, value in given.items()})
