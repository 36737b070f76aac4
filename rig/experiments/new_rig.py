"""Write an experiment file for a new rig from data sheets: every number with its unit and its source.

`rig experiment new` and `rig.new_rig` call this module. It opens no device, and must mark every number without a source
as an assumption. Values are computed at the handle. Start, push, wall and homing are chosen so that a hit reaches the
wall and `rig experiment plan` refuses nothing; if a check still refuses, the changes that the check proposes are
applied.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from rig import config
from rig.analysis import theory
from rig.config import (
    Experiment,
    amplifiers,
    controller,
    experiment_from_mapping,
    homing,
    motor_push,
    parameters,
)
from rig.config.checked import nest
from rig.config.velocity_reading import COUNT_PEAK
from rig.control.step import UNMOVED_COUNTS
from rig.core.check import refused
from rig.core.errors import ConfigError, PlanError
from rig.core.present import Item, Row
from rig.core.shown import Shown
from rig.experiments._data_sheets import (
    DataSheetQuestion,
    DataSheets,
    check_answers,
    questions,
    questions_for,
)
from rig.experiments.trials.plan import make_plan, plan_of
from rig.firmware.tick_budget import INTEGERS, named_budget
from rig.recording.files import whole_file

__all__ = ["DataSheetQuestion", "NewRig", "new_rig", "questions", "questions_for"]

# Assumptions for missing data: Coulomb friction as a fraction of the nominal effort, and viscous friction with which a
# free motion decays within this time (s).
FRICTION_SHARE, DECAY_S = 0.05, 1.0
LAG_S, THERMAL_S = 1e-4, 10.0
HALF_TRAVEL_RAD, HALF_TRAVEL_M = 0.5, 0.03
PEAK_OVER_NOMINAL = 2.0
# Current quantum (A), and the largest number of quanta up to the peak current, which fits into 16 bits.
QUANTUM_A, QUANTA = 1e-3, 30_000.0

# First hit. The push is a fraction of the nominal effort, or a multiple of friction if that is more; then its excess
# over friction is halved up to HALVINGS times, down to a tenth more than `rig experiment plan` requires. Speeds are
# those of the hand (m/s).
PUSH_SHARE, PUSH_FRICTIONS, HALVINGS = 0.25, 4.0, 8
LEAST_FRICTIONS = 1.1 * homing.ABOVE_FRICTION
ARRIVAL_M_S, HOMING_M_S, LIMIT_M_S = 0.1, 0.02, 1.5
# Distance to the wall: at least START_COUNTS counts, and HELD_OF_WAY times the position error that friction may cause;
# usually at most START_SHARE, and never more than LARGEST_SHARE of half the travel.
START_COUNTS, HELD_OF_WAY = 8.0, 4.4
START_SHARE, LARGEST_SHARE = 0.4, 0.9
# Resting penetration of the push (counts): twice trial.minimum_rest_counts, or more where friction is small. The wall
# must stop the handle within DEPTH_SHARE of half the travel.
REST_COUNTS, MOST_REST_COUNTS, DEPTH_SHARE = 4.0, 16.0, 0.5
# Time constants of the wall that pass before the judged end of the trial, and longest trial (s).
SETTLES, LONGEST_S = 2.0, 20.0
# Stiffness and damping of the chosen wall, as fractions of the largest stable values of linear theory.
OF_K_MAX, OF_B_MAX = 0.3, 0.25
# Largest effort at impact as a fraction of the effort limit; largest effort of the damper for one count, as a fraction
# of the push.
PEAK_SHARE, NOISE_SHARE = 0.8, 0.25
# One toggling count may appear as this much motion (counts).
TOGGLING_COUNTS = 1.5
# Cut-off of the velocity filter over the velocity rate. With a coarse encoder the cut-off is lower, down to a multiple
# of the handle's frequency on the stiffest wall into which the push moves REST_COUNTS deep.
CUTOFF_SHARE, CUTOFF_OVER_WALL, LEAST_CUTOFF_HZ = 0.1, 4.0, 5.0
# Position rates of a law on a board (Hz); rate (Hz) and delay (ticks) of a law on the computer behind a port.
RATES = (20_000, 10_000, 4_000, 2_000, 1_000)
PORT_RATE, PORT_TICKS = 1000, 2
CORRECTIONS = 3

SERVO = "[computed] from friction, inertia, resolution and delays"
REALTIME = "realtime."
SOFT = {"wall.stiffness": 1e-9, "realtime.wall.stiffness": 1e-9}  # until a wall is chosen
SECTIONS = (
    "rig",
    "rig.mechanics",
    "rig.amplifier",
    "rig.encoder",
    "rig.limits",
    "rig.board",
    "controller",
    "wall",
    "homing",
    "trial",
    "verdict",
    "realtime",
)


@dataclass(frozen=True, slots=True)
class Assumption:
    """A number that was assumed because no answer determines it: its key, its value with unit, and the reason."""

    key: str
    value: str
    reason: str


@dataclass(frozen=True, slots=True, repr=False)
class NewRig(Shown):
    """A new rig, described from data sheets: text and path of its experiment file, and the assumed numbers."""

    name: str
    path: Path | None
    text: str
    assumed: tuple[Assumption, ...]
    experiment: Experiment

    def brief(self) -> list[Item]:
        """Return the lines of a short report: rig and wall, path of the file, and the assumed numbers."""
        experiment = self.experiment
        return [
            experiment.headline(),
            Row("file", str(self.path) if self.path else "not written"),
            *self._assumed_rows(),
        ]

    def _assumed_rows(self) -> list[Row]:
        return [Row("assumed", f"{one.key} = {one.value}: {one.reason}") for one in self.assumed]


def new_rig(
    path: str | Path | None = None, *, overwrite: bool = False, **data_sheets: Unpack[DataSheets]
) -> NewRig:
    """Describe a rig from the data sheets of its motor and encoder, and write the description as an experiment file.

    Parameters
    ----------
    path
        File to write; its name without suffix becomes the name of the rig. None: no file is written.
    overwrite
        True to replace an existing file.
    **data_sheets
        Numbers in SI units, by the names of `rig.experiments._data_sheets.DataSheets`: ``mechanism="lever",
        torque_constant=0.0385, rotor_inertia=1.1e-5, nominal_current=2.5, encoder_lines=2048, transmission=12.0,
        handle_length=0.08, handle_mass=0.06``. Other numbers may be omitted; a value is then assumed, and marked in the
        file as assumed.

    Raises
    ------
    ConfigError
        A number is missing, unknown or out of range.
    PlanError
        The motor is too weak for its friction, or no settings for a first hit were found.
    RecordingError
        The file exists, or cannot be written.
    """
    target = None if path is None else Path(path)
    answers = check_answers(data_sheets)
    draft = _Draft("mine" if target is None else target.stem)
    _describe(draft, answers)
    _prepare_hit(draft)
    # Apply the changes that the plan's refused checks propose.
    _correct(draft, in_real_time=False)
    _correct(draft, in_real_time=True)
    text, experiment = draft.text(), draft.experiment()
    if target is not None:
        with whole_file(target, overwrite=overwrite) as file:
            file.write(text.encode())
    return NewRig(draft.name, target, text, draft.assumed(), experiment)


class _Draft:
    """A draft of an experiment file: its keys, each with value and source."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.keys: dict[str, tuple[Any, str]] = {}

    def set(self, source: str, values: Mapping[str, Any]) -> None:
        self.keys |= {
            key: (float(f"{value:.6g}") if isinstance(value, float) else value, source)
            for key, value in values.items()
        }

    def experiment(self) -> Experiment:
        return experiment_from_mapping(nest({key: value for key, (value, _) in self.keys.items()}), self.name)

    def in_real_time(self, ticks: int) -> Experiment:
        """Return the experiment as it runs in real time, over a link that delays commands by `ticks` loop periods."""
        return config.with_realtime(self.experiment(), {"rig.simulation.computation_delay_ticks": ticks})

    def unit(self, key: str) -> str:
        known = parameters().get(key.removeprefix(REALTIME))
        return known.unit_for(self.keys["rig.motion"][0]) if known else ""

    def assumed(self) -> tuple[Assumption, ...]:
        return tuple(
            Assumption(key, f"{value} {self.unit(key)}".rstrip(), source.removeprefix("[assumed] "))
            for key, (value, source) in self.keys.items()
            if source.startswith("[assumed]")
        )

    def text(self) -> str:
        lines = [
            f"# {self.name}, made by rig experiment new. Values are at the hand, in SI units. The "
            "source of each:",
            "# [data sheet]  as given",
            "# [computed]    from the given values",
            "# [assumed]     not known: rig identify measures it",
            "# [chosen]      for a first hit",
        ]
        section = ""
        for key in sorted(self.keys, key=lambda key: SECTIONS.index(_split_key(key)[0])):
            (value, source), (head, leaf) = self.keys[key], _split_key(key)
            if head != section:
                lines += ["", f"[{head}]"]
                section = head
            unit = self.unit(key)
            written = json.dumps(value, ensure_ascii=False)
            lines.append(f"{f'{leaf} = {written}':<36} # {f'{unit}: ' if unit else ''}{source}")
        return "\n".join(lines) + "\n"


def _split_key(key: str) -> tuple[str, str]:
    """Return the TOML section of a dotted key, and the key inside this section."""
    parts = key.split(".")
    depth = 2 if parts[0] == "rig" and len(parts) > 2 else 1
    return ".".join(parts[:depth]), ".".join(parts[depth:])


# ------------------------------------------------------------------ the rig


def _describe(draft: _Draft, a: DataSheets) -> None:
    """Set the keys of the sections [rig] and [controller] from the data-sheet values."""
    linear = a["mechanism"] != "lever"
    if a["mechanism"] == "lever":
        ratio, times = a["transmission"], f"ratio {a['transmission']:g}"
        radius = a["handle_length"]
    else:
        pulley = a.get("pulley_radius", 1.0)
        ratio, times, radius = 1.0 / pulley, f"1 / {pulley:g} m", 1.0
    draft.set("[chosen]", {"rig.name": draft.name, "rig.motion": "linear" if linear else "rotary"})
    draft.set(
        "[chosen]",
        {
            "rig.description": f"{a['mechanism']}, described from data sheets",
            "rig.source": "data sheets, by rig experiment new",
        },
    )
    constant, what = a.get("force_constant", a.get("torque_constant", 0.0)), "torque constant"
    if a["mechanism"] == "linear-motor":
        what, times = "force constant", "1"
    peak_a, peak_source = _peak_current(a)
    per_ampere = constant * ratio
    nominal = per_ampere * min(a["nominal_current"], peak_a)
    inertia = _masses(draft, a, ratio)
    _friction(draft, a, nominal, radius, inertia)
    draft.set(
        "[data sheet] from the axis to the hand" if not linear else "[computed] a carriage has no lever arm",
        {"rig.mechanics.handle_radius": radius},
    )
    draft.set(f"[computed] {what} {constant:g} × {times}", {"rig.amplifier.effort_per_ampere": per_ampere})
    draft.set(
        f"{peak_source} × effort_per_ampere",
        {"rig.amplifier.effort_limit": per_ampere * peak_a},
    )
    _amplifier(draft, a, peak_a, ratio)
    _encoder(draft, a, ratio)
    draft.set(
        f"[computed] nominal current {a['nominal_current']:g} A × effort_per_ampere, at most effort_limit",
        {"rig.limits.nominal_effort": nominal},
    )
    draft.set(
        "[chosen] effort_limit, for automated trials; with a person at most nominal_effort",
        {"rig.limits.effort": per_ampere * peak_a, "rig.limits.human": False},
    )
    thermal = a.get("thermal_time_constant")
    draft.set(
        "[data sheet] of the winding" if thermal else "[assumed] a small winding",
        {"rig.limits.thermal_time_constant_s": thermal or THERMAL_S},
    )
    _travel(draft, a, radius)
    _rates(draft, a.get("board", "rp2040"), peak_a)


def _masses(draft: _Draft, a: DataSheets, ratio: float) -> float:
    """Set the keys of the moving masses; return the inertia of motor and link together (kg·m² or kg)."""
    draft.set("[assumed] no elasticity between motor and hand", {"rig.mechanics.structure": "rigid"})
    if a["mechanism"] == "linear-motor":
        draft.set(
            "[data sheet] all that slides",
            {"rig.mechanics.motor_inertia": a["carriage_mass"], "rig.mechanics.link_inertia": 0.0},
        )
        return a["carriage_mass"]
    motor = a["rotor_inertia"] * ratio**2
    draft.set(
        f"[computed] rotor {a['rotor_inertia']:g} kg·m² × {ratio:g}², without pulley or pinion",
        {"rig.mechanics.motor_inertia": motor},
    )
    if a["mechanism"] == "lever":
        link = a["handle_mass"] * a["handle_length"] ** 2
        source = f"[computed] {a['handle_mass']:g} kg × ({a['handle_length']:g} m)², all of it at the hand"
    else:
        link, source = a["carriage_mass"], "[data sheet] all that slides"
    draft.set(source, {"rig.mechanics.link_inertia": link})
    return motor + link


def _friction(draft: _Draft, a: DataSheets, nominal: float, radius: float, inertia: float) -> None:
    force = a.get("friction")
    if force is None:
        source = f"[assumed] {FRICTION_SHARE:.0%} of the nominal effort"
        draft.set(source, {"rig.mechanics.motor_coulomb": _round_digits(FRICTION_SHARE * nominal)})
    else:
        source = f"[computed] {force:g} N at the hand, measured"
        draft.set(source, {"rig.mechanics.motor_coulomb": force * radius})
    draft.set(
        f"[assumed] a free motion decays within {DECAY_S:g} s",
        {"rig.mechanics.motor_damping": _round_digits(inertia / DECAY_S)},
    )


def _peak_current(a: DataSheets) -> tuple[float, str]:
    """Return the motor's largest current (A), and a text that names the source of this number."""
    profile = amplifiers.load(a.get("amplifier", "generic"))
    most = profile.most_a or math.inf
    peak = a.get("peak_current")
    if peak is not None and peak > most:
        raise ConfigError(
            f"peak_current = {peak:g} A is above the maximum of {profile.name}, {most:g} A",
            remedy=f"give at most {most:g} A, and set it in the amplifier",
        )
    if profile.drive == "voltage" and not {"winding_resistance", "supply_voltage"} <= a.keys():
        raise ConfigError(
            f"{profile.name} has no current loop, so winding_resistance and supply_voltage, which "
            "determine its current, must be given",
            remedy="give both, from the data sheet of the motor and from the power supply",
        )
    if peak is None:
        limit = min(PEAK_OVER_NOMINAL * a["nominal_current"], most)
        source = "[assumed] twice the nominal current,"
    else:
        limit, source = peak, "[computed] current limit of the amplifier,"
    if "winding_resistance" in a and "supply_voltage" in a:
        stall = a["supply_voltage"] / a["winding_resistance"]
        if stall < limit or profile.drive == "voltage":
            voltage, resistance = a["supply_voltage"], a["winding_resistance"]
            limit, source = stall, f"[computed] stall: {voltage:g} V / {resistance:g} ohm,"
    return limit, f"{source} {limit:.4g} A"


def _amplifier(draft: _Draft, a: DataSheets, peak_a: float, ratio: float) -> None:
    profile = amplifiers.load(a.get("amplifier", "generic"))
    inductance, resistance = a.get("winding_inductance"), a.get("winding_resistance")
    lag, source = LAG_S, "[assumed] of the current loop"
    if inductance and resistance:
        lag, source = inductance / resistance, "[computed] inductance / resistance; a current loop is faster"
    draft.set(source, {"rig.amplifier.lag_s": min(lag, 0.09)})
    step = 2.0 * peak_a / profile.steps if profile.steps else 0.0
    draft.set(
        f"[computed] one of {profile.steps} steps of {profile.name}" if step > QUANTUM_A else "[chosen]",
        {"rig.amplifier.current_quantum_a": _round_digits(max(QUANTUM_A, peak_a / QUANTA, step), math.ceil)},
    )
    draft.set(
        "[data sheet]" if "amplifier" in a else "[assumed] a current amplifier",
        {"rig.amplifier.profile": profile.name, "rig.amplifier.drive": profile.drive or "current"},
    )
    draft.set(
        f"[data sheet] of {profile.name}"
        if profile.set_point_delay_s
        else f"[assumed] {profile.name} states none",
        {"rig.amplifier.set_point_delay_s": profile.set_point_delay_s},
    )
    if profile.drive == "voltage" and resistance:
        constant = a.get("force_constant", a.get("torque_constant", 0.0))
        draft.set(
            "[computed] (torque constant × ratio)² / resistance",
            {"rig.amplifier.back_emf_damping": (constant * ratio) ** 2 / resistance},
        )
        draft.set(
            "[chosen] a bridge measures no current while it brakes", {"rig.amplifier.current_monitor": False}
        )


def _encoder(draft: _Draft, a: DataSheets, ratio: float) -> None:
    if a["mechanism"] == "linear-motor":
        draft.set("[data sheet] for one count", {"rig.encoder.quantum": a["encoder_resolution"]})
        return
    lines = a["encoder_lines"]
    if a["mechanism"] == "carriage":
        quantum = 2.0 * math.pi / (4 * lines * ratio)
        draft.set(
            f"[computed] 2π / (4 × {lines} lines) × radius of the pulley", {"rig.encoder.quantum": quantum}
        )
        return
    at_motor = a.get("encoder_at", "motor") == "motor"
    draft.set("[data sheet] lines", {"rig.encoder.counts_per_revolution": lines})
    draft.set("[chosen] all edges of a line are counted", {"rig.encoder.decoding": 4})
    draft.set(
        ("[data sheet]" if "encoder_at" in a else "[assumed]")
        + f" on the {'motor' if at_motor else 'lever'}",
        {"rig.encoder.ratio": ratio if at_motor else 1.0},
    )


def _travel(draft: _Draft, a: DataSheets, radius: float) -> None:
    travel = a.get("travel")
    if travel is None:
        half = HALF_TRAVEL_RAD if a["mechanism"] == "lever" else HALF_TRAVEL_M
        source = "[assumed] travel of the mechanism, zero in its middle"
    else:
        half, source = 0.5 * travel / radius, f"[computed] travel {travel:g} m, zero in its middle"
    draft.set(source, {"rig.limits.position_minimum": -half, "rig.limits.position_maximum": half})


def _rates(draft: _Draft, board: str, peak_a: float) -> None:
    """Set rates at which the board can run the control law, and the current at the full scale of its output (A)."""
    if board == "none":
        rate = velocity = PORT_RATE
        source = "[chosen] what a computer can run behind a port"
    else:
        most = named_budget(board).rate_maximum(INTEGERS)
        rate = next((each for each in RATES if each <= most), RATES[-1])
        velocity = max(rate // 10, PORT_RATE)
        source = f"[chosen] {board} can run it: rig hit FILE --loop device --estimator {INTEGERS}"
        draft.set(
            "[computed] A; set the same in the amplifier",
            {"rig.board.full_scale": _round_digits(peak_a, math.ceil)},
        )
    draft.set(source, {"controller.position_rate": rate, "controller.velocity_rate": velocity})
    draft.set("[chosen]", {"controller.estimator": "fdm-butterworth"})
    draft.set(
        "[chosen] a tenth of the velocity rate", {"controller.parameters.cutoff_hz": CUTOFF_SHARE * velocity}
    )


# ------------------------------------------------------------------ the first hit


def _prepare_hit(draft: _Draft) -> None:
    """Set the keys of a first trial: homing, wall, and the strongest push for which a stable wall is found."""
    keys = {key: value for key, (value, _) in draft.keys.items()}
    nominal, friction = keys["rig.limits.nominal_effort"], keys["rig.mechanics.motor_coulomb"]
    quantum = keys["rig.amplifier.effort_per_ampere"] * keys["rig.amplifier.current_quantum_a"]
    least = LEAST_FRICTIONS * friction + 2.0 * quantum
    if least > nominal:
        raise PlanError(
            f"the motor gives {nominal:.3g} {draft.unit('trial.effort')} continuously at the hand; at "
            f"least {least:.3g} are needed to push against friction of {friction:.3g}",
            remedy="choose a larger motor or ratio, or reduce the friction",
        )
    push = max(min(max(PUSH_SHARE * nominal, PUSH_FRICTIONS * friction), nominal), least)
    _adapt_to_encoder(draft, _provisional(draft, push))
    held = _set_homing(draft)
    for halvings in range(HALVINGS):
        weaker = _round_digits(max(friction + (push - friction) / 2**halvings, least), math.ceil)
        if _set_push(draft, min(weaker, nominal), held):
            return


def _set_push(draft: _Draft, push: float, held: float) -> bool:
    """Set a push (N·m or N), its start and wall; return False if no stable wall stops the handle in its travel.

    `held` is the largest distance from the start at which friction may stop the homing servo (rad or m).
    """
    draft.set("[chosen]", {"trial.effort": push, **SOFT})  # else the wall of a harder push may be refused
    experiment = draft.experiment()
    radius, half = experiment.rig.mechanics.handle_radius, experiment.rig.limits.position_maximum
    delta = experiment.rig.encoder.resolution
    inertia, net = homing.inertia(experiment), push - homing.holding_effort(experiment)
    start = min(inertia * (ARRIVAL_M_S / radius) ** 2 / (2.0 * net), START_SHARE * half)
    start = min(max(start, START_COUNTS * delta, HELD_OF_WAY * held), LARGEST_SHARE * half)
    speed, unseen = (math.sqrt(2.0 * net * way / inertia) for way in (start, UNMOVED_COUNTS * delta))
    count = COUNT_PEAK * float(experiment.controller.parameters["cutoff_hz"]) * delta
    draft.set(
        "[chosen]",
        {
            "rig.limits.speed": _round_digits(
                max(LIMIT_M_S / radius, 4.0 * speed, 2.5 * unseen, 4.0 * count), math.ceil
            ),
            "trial.start": -_round_digits(start),
        },
    )
    draft.set(SERVO, {"homing.tolerance_counts": homing.nearest_tolerance(draft.experiment())})
    holds, settles_s = True, 0.0
    for before, seen in (("", draft.experiment()), (REALTIME, draft.in_real_time(PORT_TICKS))):
        wall = _stable_wall(seen)
        holds &= wall.stiffness > wall.least
        damping = wall.damping + experiment.rig.mechanics.motor_damping
        settles_s = max(settles_s, SETTLES * 2.0 * inertia / damping)
        draft.set(
            "[chosen] within linear theory, what the push shows and the motor gives",
            {
                f"{before}wall.stiffness": _round_digits(max(wall.stiffness, wall.least)),
                f"{before}wall.damping": _round_digits(wall.damping),
            },
        )
    duration_s = max(1.0, 1.5 * speed * inertia / net + 0.9, speed * inertia / net + settles_s + 0.4)
    draft.set("[chosen]", {"trial.duration_s": _round_digits(min(duration_s, LONGEST_S), math.ceil)})
    return holds


def _provisional(draft: _Draft, push: float) -> Experiment:
    """Set all keys of the first trial to provisional values, and return the experiment; `push` is in N·m or N."""
    keys = {key: value for key, (value, _) in draft.keys.items()}
    half, radius = keys["rig.limits.position_maximum"], keys["rig.mechanics.handle_radius"]
    speed = HOMING_M_S / radius
    nominal_force = keys["rig.limits.nominal_effort"] / radius
    draft.set("[chosen]", {"rig.limits.speed": _round_digits(LIMIT_M_S / radius)})
    draft.set(
        "[chosen] above any step between two ticks: it acts only when something is wrong",
        {
            "rig.limits.slew": _round_digits(
                2.0 * keys["rig.limits.effort"] * keys["controller.position_rate"], math.ceil
            )
        },
    )
    draft.set("[chosen]", {**SOFT, "wall.damping": 0.0, "wall.position": 0.0, "wall.side": 1})
    draft.set(
        SERVO,
        {
            "homing.stiffness": 1.0,
            "homing.damping": 1.0,
            "homing.effort": push,
            "homing.slew": 1.0,
            "homing.tolerance_counts": 1.0,
        },
    )
    draft.set(
        "[chosen]",
        {
            "homing.speed": _round_digits(speed),
            "homing.settle_s": 0.1,
            "homing.timeout_s": _round_digits(2.0 * half / speed + 15.0),
            "trial.effort": push,
            "trial.start": -0.5 * half,
            "trial.duration_s": 1.0,
        },
    )
    draft.set(
        "[chosen] a tenth of the nominal force, at most 1 N",
        {"verdict.heard_force": _round_digits(min(1.0, 0.1 * nominal_force))},
    )
    draft.set("[chosen] the band ends below half of the slowest rate", {"verdict.lowpass_hz": 400.0})
    draft.set(
        "[chosen] what a computer can run behind a port",
        {
            "realtime.controller.position_rate": PORT_RATE,
            "realtime.controller.velocity_rate": PORT_RATE,
            "realtime.controller.parameters.cutoff_hz": CUTOFF_SHARE * PORT_RATE,
            "realtime.homing.stiffness": 1.0,
            "realtime.homing.damping": 1.0,
            "realtime.wall.damping": 0.0,
        },
    )
    return draft.experiment()


def _adapt_to_encoder(draft: _Draft, experiment: Experiment) -> None:
    """Lower the velocity filter's cut-off, and raise the limit of position ripple, if the encoder is coarse."""
    toggles = TOGGLING_COUNTS * experiment.rig.encoder.resolution * experiment.rig.mechanics.handle_radius
    if toggles > experiment.verdict.moved:
        draft.set(
            "[computed] one and a half counts: smaller motion cannot be measured", {"verdict.moved": toggles}
        )
    stiffness = motor_push(experiment) / (REST_COUNTS * experiment.rig.encoder.resolution)
    wall_hz = math.sqrt(stiffness / homing.inertia(experiment)) / (2.0 * math.pi)
    wanted = _round_digits(max(CUTOFF_OVER_WALL * wall_hz, LEAST_CUTOFF_HZ))
    for key in ("controller.parameters.cutoff_hz", "realtime.controller.parameters.cutoff_hz"):
        if wanted < draft.keys[key][0]:
            draft.set("[chosen] low, since one count of this encoder is a large step", {key: wanted})


def _set_homing(draft: _Draft) -> float:
    """Set the homing servo; return the largest position error that friction may cause (rad or m)."""
    offsets = []
    for before, experiment in (("", draft.experiment()), (REALTIME, draft.in_real_time(0))):
        servo = homing.stable_servo(experiment)
        values = {"homing.stiffness": servo.stiffness, "homing.damping": servo.damping}
        if not before:
            values |= {"homing.effort": servo.effort, "homing.slew": servo.slew}
        draft.set(SERVO, {f"{before}{key}": value for key, value in values.items()})
        offsets.append(homing.ABOVE_FRICTION * homing.holding_effort(experiment) / servo.stiffness)
    return max(offsets)


@dataclass(frozen=True, slots=True)
class _ChosenWall:
    """A stable wall: its stiffness and damping, and the smallest stiffness that stops the handle within its travel."""

    stiffness: float
    damping: float
    least: float


def _stable_wall(experiment: Experiment) -> _ChosenWall:
    """Return a wall well below the limits of linear theory and effort, soft enough to rest some counts deep."""
    delta, push, limits = experiment.rig.encoder.resolution, motor_push(experiment), experiment.rig.limits
    held, way = homing.holding_effort(experiment), experiment.wall.position - experiment.trial.start
    gained = 2.0 * (push - held) * way  # twice the kinetic energy at the wall
    cutoff = float(experiment.controller.parameters["cutoff_hz"])
    loop, room = theory.as_lifted(experiment, None), DEPTH_SHARE * limits.position_maximum
    quiet = NOISE_SHARE * push / (COUNT_PEAK * cutoff * delta)
    damping = min(OF_B_MAX * theory.damping_range(loop), quiet)
    strongest = PEAK_SHARE * limits.effort
    spared = max(0.0, strongest**2 - 2.0 * strongest * push)
    # The spring's effort for half a count must stay below friction, else a toggling count keeps the handle moving.
    shown = min(push / REST_COUNTS, max(2.0 * held, push / MOST_REST_COUNTS)) / delta
    most = min(shown, spared / gained)
    stiffness = min(most, OF_K_MAX * theory.k_max(loop, damping=damping).stiffness)
    # Damping above critical damping would only raise the noise.
    damping = min(damping, 2.0 * math.sqrt(stiffness * homing.inertia(experiment)))
    stiffness = min(stiffness, OF_K_MAX * theory.k_max(loop, damping=damping).stiffness)
    return _ChosenWall(stiffness, damping, (2.0 * push * room + gained) / room**2)


def _correct(draft: _Draft, *, in_real_time: bool) -> None:
    """Apply changes that failed checks propose; raise `PlanError` if a check of the plan still fails after these."""
    before = REALTIME if in_real_time else ""
    for _ in range(CORRECTIONS + 1):
        experiment = draft.in_real_time(0) if in_real_time else draft.experiment()
        if in_real_time:
            plan = plan_of(controller.prepare_controller(experiment), linked=True)
        else:
            plan = make_plan(experiment)
        found = refused(plan.checks)
        changes = {f"{before}{key}": value for check in found for key, value in check.changes.items()}
        if not changes:
            break
        draft.set("[computed] as rig experiment plan requires", changes)
    if found:
        text = "; ".join(f"{check.name}: {check.text}" for check in found)
        remedy = found[0].remedy
        if draft.keys["rig.mechanics.motor_coulomb"][1].startswith("[assumed]"):
            remedy += "; friction is assumed: give the measured `friction`"
        raise PlanError(f"{draft.name}: no settings for a first hit were found: {text}", remedy=remedy)


def _round_digits(value: float, way: Any = round) -> float:
    """Return `value` rounded to three significant digits by the function `way`, like `round` or `math.ceil`."""
    if value == 0.0 or not math.isfinite(value):
        return value
    scale = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    return float(f"{way(value / scale * (1.0 - 1e-12 if way is math.ceil else 1.0)) * scale:.6g}")
