"""List the steps of an experiment, and check if the experiment is permitted, before a person touches the handle.

`rig experiment plan`, the commands that run trials, designs, admission and sessions call this module. It must not open
a device or change the experiment. The predictions are for one rigid mass without damping, the worst case: a real hit is
slower and softer.
"""

import math
from dataclasses import dataclass, replace

from firmware_protocol.dictionary import Dictionary
from firmware_protocol.law_parameters import LAW_PARAMETERS
from rig.analysis.theory import default_schemes
from rig.config import (
    Experiment,
    controller,
    device_law,
    homing,
    human_limits_exceeded,
    motor_push,
    push_at_rest,
    push_s,
    rig_model,
)
from rig.config.device_law import wall_elsewhere
from rig.config.homing import holding_effort
from rig.config.prepared_run import PreparedRun
from rig.config.schemes import describe_cutoffs
from rig.config.velocity_reading import highest_reading
from rig.core.check import Check, Outcome
from rig.core.sample import unit_of
from rig.devices.device import LINK_SHARE, STATE_BYTES
from rig.doctor.gate_result import ticks_late
from rig.doctor.predicted import (
    COUNT_SPEED_SHARE,
    finding,
    homing_checks,
    late_wall,
    predict_checks,
    quieter_changes,
    speed_reading,
)
from rig.experiments.trials._device_limits import check_limits
from rig.experiments.trials._excitation_plan import excitation_plan
from rig.experiments.trials._identify_motions import RATE_STEP, pushes_checks
from rig.experiments.trials.planned import (
    ARITHMETIC_WORDS,
    Plan,
    Step,
    check_positive,
    heat_check,
    limited,
    where_it_runs,
)
from rig.firmware.tick_budget import BOARD, INTEGERS, named_budget

STANDS_FOR_DEVICE = (
    "simulated with the law of the host, in float64: it represents that of the device, which has no "
    "more delay and differs by one or two quanta"
)


def stands_for_device(experiment: Experiment) -> str:
    """Return a sentence on how well a simulation of the host's law represents the law on a device or in a drive."""
    rates = experiment.controller
    return wall_elsewhere(rates.arithmetic).stands_for if rates.wall_is_elsewhere else STANDS_FOR_DEVICE


CUTOFFS = "cut-offs compared"
# Proposed values stay below a limit by this factor.
LESS = 0.9
FLASH = "flash the firmware of this package (rig firmware)"
LAW_NAMES = frozenset(parameter.name for parameter in LAW_PARAMETERS)


def make_plan(experiment: Experiment) -> Plan:
    """Return an experiment's plan (steps, checks); raise `ConfigError` if its law or estimator cannot be prepared."""
    return plan_of(controller.prepare_controller(experiment))


def is_linked(url: str | None, *, realtime: bool, round_trip_s: float | None) -> bool:
    """Return True if a plan must include a link's delay: in real time, with a round trip, or with a real device."""
    return realtime or round_trip_s is not None or (url is not None and not url.startswith("sim:"))


def plan_of(
    run: PreparedRun,
    *,
    linked: bool = False,
    round_trip_s: float | None = None,
    board: str = BOARD,
) -> Plan:
    """Return the plan (steps and checks) of a prepared run.

    `linked` adds the wall's stability with the delay of a link, whose round trip is `round_trip_s` (s). `board` names
    the processor for which the time of a tick is estimated if the law runs on the device. Raise `ConfigError` for an
    unknown board, and `PlanError` for a round trip that is not above 0.
    """
    experiment = run.experiment
    delay = delay_checks(experiment, round_trip_s) if linked else []
    ticks = (
        _link_ticks(experiment, round_trip_s)[0]
        if linked
        else experiment.rig.simulation.computation_delay_ticks
    )
    beside = (
        *delay,
        *_tick_checks(experiment, board),
        *_cutoff_checks(experiment),
        *pushes_checks(experiment),
    )
    if experiment.trial.kind == "excitation":
        planned = excitation_plan(experiment)
        homes = experiment.excitation.channel == "motor"
        homed = homing_checks(experiment, ticks) if homes else [speed_reading(experiment)]
        return replace(planned, run=run, checks=(*planned.checks, *homed, *beside))
    checks = (
        *_wall_checks(experiment),
        *predict_checks(experiment, ticks),
        *_watch_checks(experiment),
        *human_limit_checks(experiment),
        _heat_check(experiment),
        *_drive_wall_checks(experiment),
        *beside,
    )
    return Plan(experiment.rig.name, experiment.trial.repeats, _steps(experiment), checks, run)


def _drive_wall_checks(experiment: Experiment, dictionary: Dictionary | None = None) -> list[Check]:
    """Return checks of a wall that a motor drive renders by itself; empty for all other walls.

    They check that the device with this `dictionary` (description) renders the wall; None: that it can be planned.
    """
    if not experiment.controller.wall_is_elsewhere:
        return []
    wall = wall_elsewhere(experiment.controller.arithmetic)
    return wall.planned(experiment) if dictionary is None else wall.fits(experiment, dictionary)


def _tick_checks(experiment: Experiment, board: str) -> list[Check]:
    """Warn if the board's processor is too slow for the control law at this rate; empty if this computer runs it."""
    if experiment.controller.loop != "device" or experiment.controller.wall_is_elsewhere:
        return []
    budget, own = named_budget(board), experiment.controller
    most, divider = budget.rate_maximum(own.estimator), own.position_rate // own.velocity_rate
    velocity_rate = RATE_STEP * math.floor(most / divider / RATE_STEP)
    rates = {"controller.position_rate": divider * velocity_rate, "controller.velocity_rate": velocity_rate}
    return [
        finding(
            "tick budget",
            own.position_rate <= most,
            f"the law at {own.position_rate} Hz; {budget.text(own.estimator)}",
            rates if velocity_rate > 0 else None,
            f"choose controller.estimator = {INTEGERS}: {budget.text(INTEGERS)}",
            Outcome.WARNING,
        )
    ]


def _cutoff_checks(experiment: Experiment) -> list[Check]:
    """Return a note if uniform and dual-rate sampling would get different filter cut-offs; else an empty list."""
    found = describe_cutoffs(default_schemes(experiment), experiment)
    return [] if found is None else [Check(CUTOFFS, Outcome.OK, found)]


def link_checks(experiment: Experiment, rate_maximum: int, bytes_per_second: float | None) -> list[Check]:
    """Check that the device supports the requested rate, and that the link's capacity is enough for every sample.

    `rate_maximum` is the device's highest rate (Hz). `bytes_per_second` is the link's capacity; None: unknown and not
    checked.
    """
    rate = experiment.controller.position_rate
    checks = [
        limited(
            "device rate",
            rate <= rate_maximum,
            f"the law needs {rate} Hz, and the device supports at most {rate_maximum} Hz",
            f"choose `rate` {rate_maximum} or less",
        )
    ]
    if bytes_per_second is not None and experiment.controller.loop == "device":
        checks.append(_batch_check(experiment, LINK_SHARE * bytes_per_second))
    elif bytes_per_second is not None:
        needed, usable = rate * STATE_BYTES, LINK_SHARE * bytes_per_second
        possible = int(usable // STATE_BYTES)
        checks.append(
            limited(
                "link capacity",
                needed <= usable,
                f"samples at {rate} Hz need {needed / 1e3:.1f} kB/s; the link's capacity is {usable / 1e3:.1f} kB/s",
                f"choose `rate` {possible} or less, or a faster link",
            )
        )
    return checks


def delay_checks(experiment: Experiment, round_trip_s: float | None = None) -> list[Check]:
    """Return a check that states the delay of commands over a link, and the wall's stability checks with this delay.

    No check refuses the run: a wall that is unstable with the delay becomes a warning.

    Parameters
    ----------
    experiment
        Experiment as it would run.
    round_trip_s
        Measured round trip of the link, and of the drive behind a bridge (s). None:
        `rig.simulation.computation_delay_ticks`, or the smallest possible delay of a link if that key is 0.

    Raises
    ------
    PlanError
        The round trip is not above 0.
    """
    check_positive({"round_trip": round_trip_s})
    tick_s = 1.0 / experiment.controller.position_rate
    ticks, why = _link_ticks(experiment, round_trip_s)
    amplifier = experiment.rig.amplifier
    beside, late_s = amplifier.set_point_ticks(tick_s), amplifier.set_point_delay_s
    total = ticks + beside
    text = (
        f"{total} tick{'' if total == 1 else 's'}, {1e6 * total * tick_s:.4g} µs, from a sample to its effort: "
        f"{ticks} by the link ({why}), {beside} by a set-point that is {1e6 * late_s:.4g} µs late"
    )
    wall = [
        replace(check, outcome=Outcome.WARNING) if check.outcome is Outcome.REFUSED else check
        for check in late_wall(experiment, ticks).checks
    ]
    return [Check("delay", Outcome.OK, text), *wall]


def _link_ticks(experiment: Experiment, round_trip_s: float | None) -> tuple[int, str]:
    """Return the link's delay of commands (ticks), and a text that names the source of this number."""
    rate, described = experiment.controller.position_rate, experiment.rig.simulation.computation_delay_ticks
    if experiment.controller.loop == "device":
        return 0, "the device runs the law"
    if round_trip_s is not None:
        return ticks_late(
            round_trip_s, rate, experiment.host.pacing
        ), f"a round trip of {1e6 * round_trip_s:.4g} µs, as stated"
    if described > 0:
        return described, "rig.simulation.computation_delay_ticks"
    return ticks_late(
        0.0, rate, experiment.host.pacing
    ), "assumed, the smallest possible for a link: `rig doctor` measures it"


def _batch_check(experiment: Experiment, usable: float) -> Check:
    """Check that the link's capacity `usable` (bytes/s) is enough to report every tick of a law on the device."""
    needed = device_law.bytes_per_second(experiment)
    remedy = "choose a lower `rate`, or a faster link"
    if experiment.controller.measured_current:
        short = replace(experiment, controller=replace(experiment.controller, measured_current=False))
        if device_law.bytes_per_second(short) <= usable:
            remedy = f"leave the measured current out (controller.measured_current = false), {remedy}"
    return limited(
        "link capacity",
        needed <= usable,
        f"{needed / 1e3:.1f} kB/s for every tick at {experiment.controller.position_rate} Hz, "
        f"the link's capacity is {usable / 1e3:.1f} kB/s",
        remedy,
    )


def device_checks(run: PreparedRun, dictionary: Dictionary) -> list[Check]:
    """Check that a device accepts the limits of a run, and supports its control law if the device must compute it.

    Parameters
    ----------
    run
        Prepared run.
    dictionary
        Description that the device sends about itself.
    """
    experiment, limits = run.experiment, check_limits(run, dictionary)
    if experiment.controller.loop != "device":
        return [limits]
    arithmetic = device_law.arithmetic_of(experiment.controller)
    own = dictionary.parameter("law")
    if own is None or own.maximum < 1:
        simulated = "open sim://NAME?firmware=1, which runs the firmware" if dictionary.simulated else FLASH
        return [
            limits,
            Check(
                "law on the device",
                Outcome.REFUSED,
                f"{dictionary.device} ({dictionary.firmware}) cannot run the law itself",
                f'{simulated}; or let the host run it (controller.loop = "host")',
            ),
        ]
    narrow = [
        f"{name} = {value:g} (allowed: {info.minimum:g} to {info.maximum:g})"
        for name, value in run.parameters.items()
        if name in LAW_NAMES
        and (info := dictionary.parameter(name)) is not None
        and not info.minimum <= value <= info.maximum
    ]
    return [
        limits,
        Check(
            "law on the device",
            Outcome.REFUSED if narrow else Outcome.OK,
            f"{dictionary.device} does not support {'; '.join(narrow)}"
            if narrow
            else f"{dictionary.device} runs it in {ARITHMETIC_WORDS[arithmetic]}",
            "choose another rate, estimator or arithmetic, or a firmware that supports it",
        ),
        *_drive_wall_checks(experiment, dictionary),
    ]


@dataclass(frozen=True, slots=True)
class PredictedImpact:
    """A prediction of a hit by a rigid, undamped mass.

    Attributes
    ----------
    velocity
        Velocity at the first contact with the wall (rad/s or m/s).
    peak_penetration
        Deepest penetration (rad or m).
    peak_effort
        Effort of the wall's spring at the deepest penetration (N·m or N).
    """

    velocity: float
    peak_penetration: float
    peak_effort: float


def predict_impact(experiment: Experiment) -> PredictedImpact:
    """Predict the hit by energy balance: the wall's spring absorbs the work of the push minus Coulomb friction."""
    mechanics, wall, push = rig_model(experiment).mechanics, experiment.wall, push_at_rest(experiment)
    inertia = mechanics.inertia
    distance = abs(wall.position - experiment.trial.start)
    # A hand follows the intended motion without lag, and is so soft that its mass can be neglected.
    if experiment.trial.kind == "human":
        inertia += experiment.operator.pads_mass * mechanics.handle_radius**2
        velocity = _reach_velocity(experiment, distance)
    else:
        net = max(0.0, push - mechanics.motor_coulomb - mechanics.link_coulomb)
        velocity = math.sqrt(2.0 * net * distance / inertia)
    if wall.stiffness == 0.0:
        return PredictedImpact(velocity, math.inf, 0.0)
    rest = push / wall.stiffness
    peak = rest + math.sqrt(rest**2 + inertia * velocity**2 / wall.stiffness)
    return PredictedImpact(velocity, peak, wall.stiffness * peak)


def _hand_travel(experiment: Experiment, distance: float) -> float:
    """Return how far a hand would push the handle from its start (rad or m) if the wall at `distance` were missing."""
    operator = experiment.operator
    stretch = math.inf
    if operator.hand_stiffness > 0.0:
        stretch = operator.press * (1.0 + operator.press_modulation) / operator.hand_stiffness
    return distance + (operator.depth + stretch) / experiment.rig.mechanics.handle_radius


def _reach_velocity(experiment: Experiment, distance: float) -> float:
    """Return a modelled hand's velocity at the wall (rad/s or m/s), at `distance` from the start (rad or m).

    The position follows a raised cosine over the whole distance that the hand would move without a wall.
    """
    way = _hand_travel(experiment, distance)
    if math.isinf(way):
        return math.inf
    share = distance / way
    return math.pi * way / experiment.operator.reach_s * math.sqrt(share * (1.0 - share))


def _push_text(experiment: Experiment) -> str:
    motion, o = experiment.rig.motion, experiment.operator
    if experiment.trial.kind != "human":
        return f"{experiment.trial.effort:g} {unit_of('effort', motion)}"
    return (
        f"a person's hand with a {o.grip} grip, no motor: it reaches {o.depth * 1e3:g} mm deep in {o.reach_s:g} s "
        f"from {o.begin_s:g} s on, and presses {o.press:g} N"
    )


def _steps(experiment: Experiment) -> tuple[Step, ...]:
    motion = experiment.rig.motion
    position, effort, velocity = (unit_of(name, motion) for name in ("position", "effort", "velocity"))
    c, t, h, w = experiment.controller, experiment.trial, experiment.homing, experiment.wall
    scheme = "uniform" if c.position_rate == c.velocity_rate else "dual-rate"
    wall = f"{w.stiffness:g} {unit_of('stiffness', motion)}, {w.damping:g} {unit_of('damping', motion)}"
    push = f"{_push_text(experiment)} into a wall of {wall} at {w.position:g} {position}"
    judged = f"on the last {experiment.verdict.tail_s:g} s of the push; disarm and seal the recording"
    return (
        Step(
            "configure",
            f"{scheme}: position {c.position_rate} Hz, velocity {c.velocity_rate} Hz by {c.estimator}, "
            f"{where_it_runs(experiment)}",
            0.0,
        ),
        Step(
            "home",
            f"to {t.start:g} {position} at {h.speed:g} {velocity}, at most {h.effort:g} {effort}",
            h.timeout_s,
        ),
        *_baseline_step(experiment),
        Step("push", push, push_s(experiment)),
        Step("release", "ramp the effort to zero", t.release_s),
        Step("judge", judged, 0.0),
    )


def _baseline_step(experiment: Experiment) -> tuple[Step, ...]:
    trial = experiment.trial
    if trial.baseline_s + trial.foreperiod_s == 0.0:
        return ()
    most = f", and up to {trial.foreperiod_s:g} s more" if trial.foreperiod_s else ""
    return (Step("wait", f"in free space for the cue{most}", trial.baseline_s),)


def _watch_checks(experiment: Experiment) -> list[Check]:
    """Check the push against the limit of energy that ends a run, and state the limit of oscillations."""
    energy, oscillations = controller.energy_limit(experiment), controller.oscillation_limit(experiment)
    checks = []
    if energy > 0.0 and experiment.wall.stiffness > 0.0:
        hit = predict_impact(experiment)
        way = abs(experiment.wall.position - experiment.trial.start) + hit.peak_penetration
        work = abs(motor_push(experiment)) * way
        leak = experiment.wall.stiffness * experiment.rig.encoder.resolution**2
        checks.append(
            limited(
                "energy",
                work <= energy,
                f"the push gives up to {work:.2g} J, leaving and entering one count {leak:.2g} J; "
                f"limit {energy:g}",
                "raise rig.limits.energy, push less or start closer",
            )
        )
    if oscillations > 0:
        within = f"each within {experiment.rig.limits.oscillation_s:g} s"
        checks.append(
            Check(
                "violence",
                Outcome.OK,
                f"{oscillations} full oscillations of the effort in a row, {within}, end the run",
            )
        )
    return checks


def human_limit_checks(experiment: Experiment, *, real: bool = False) -> list[Check]:
    """Check the limits that protect a person: exceeded limits are refused on a `real` rig, else they are warnings."""
    if experiment.trial.kind != "human":
        return []
    limits, unit = experiment.rig.limits, unit_of("effort", experiment.rig.motion)
    if exceeded := human_limits_exceeded(experiment):
        text = f"a person holds the handle, and {', '.join(exceeded)}; a real rig refuses this trial"
        outcome = Outcome.REFUSED if real else Outcome.WARNING
        return [
            Check("human limits", outcome, text, f"remove {', '.join(one.split(' ')[0] for one in exceeded)}")
        ]
    if limits.effort > limits.nominal_effort:
        text = (
            f"the effort may reach {limits.effort:g} {unit}, {limits.effort / limits.nominal_effort:.3g} times the "
            "nominal effort, with a person at the handle (rig.limits.override_stall = true)"
        )
        return [
            Check(
                "human limits",
                Outcome.WARNING,
                text,
                "remove override_stall unless the study needs those peaks",
            )
        ]
    within = f"at most {limits.effort:g} {unit}, no more than the nominal effort"
    return [Check("human limits", Outcome.OK, within)]


def _saturation_remedy(experiment: Experiment) -> str:
    """Return what to do about a hit in which the wall's effort exceeds the effort limit at the deepest point."""
    most = push_at_rest(experiment) * (1.0 + experiment.operator.press_modulation)
    if experiment.trial.kind == "human" and most < experiment.rig.limits.effort:
        return (
            "expected briefly at impact; the verdict judges the end of the push; to avoid it push "
            "less or start closer"
        )
    return "the hit will saturate; push less or start closer"


def _wall_checks(experiment: Experiment) -> list[Check]:
    limits, motion, delta = experiment.rig.limits, experiment.rig.motion, experiment.rig.encoder.resolution
    position, effort, velocity = (unit_of(q, motion) for q in ("position", "effort", "velocity"))
    if experiment.wall.stiffness == 0.0:
        return [
            Check(
                "stiffness", Outcome.REFUSED, "0: no wall would stop the handle", "set wall.stiffness above 0"
            )
        ]
    hit = predict_impact(experiment)
    end = experiment.wall.position + experiment.wall.side * hit.peak_penetration
    inside = limits.position_minimum <= end <= limits.position_maximum
    # The velocity of a hand without stiffness has no upper bound.
    reading = highest_reading(experiment, hit.velocity) if math.isfinite(hit.velocity) else math.inf
    checks = [
        finding(
            "impact velocity",
            reading <= limits.speed,
            f"up to {hit.velocity:.3g} {velocity}, which reads as up to {reading:.3g} {velocity}; "
            f"limit {limits.speed:g}",
            {**quieter_changes(experiment), **_slower_changes(experiment, hit.velocity)},
            "push less, start closer to the wall, or choose another estimator",
        ),
        finding(
            "peak penetration",
            inside,
            f"up to {hit.peak_penetration:.3g} {position} ({hit.peak_penetration / delta:.1f} counts), "
            f"window {limits.position_minimum:g} … {limits.position_maximum:g}",
            _stiffer_changes(experiment, hit),
            "raise wall.stiffness, push less, or widen the window",
        ),
        limited(
            "peak effort",
            hit.peak_effort <= limits.effort,
            f"spring up to {hit.peak_effort:.3g} {effort}, limit {limits.effort:g}",
            _saturation_remedy(experiment),
            Outcome.WARNING,
        ),
    ]
    rest = push_at_rest(experiment) / experiment.wall.stiffness
    enough = rest / delta >= experiment.trial.minimum_rest_counts
    if experiment.trial.kind == "human":
        checks.append(_let_go_check(experiment))
    if share := experiment.rig.cogging.ripple_crest:
        low, high = (experiment.wall.stiffness * (1.0 + way * share) for way in (-1.0, 1.0))
        varies = f"K·(1 ± {share:.2g}) over position, {low:.4g} to {high:.4g} {unit_of('stiffness', motion)}"
        checks.append(Check("ripple", Outcome.OK, f"{varies}, as much of B; not compensated"))
    return [
        *checks,
        limited(
            "resting penetration",
            enough,
            f"{rest:.3g} {position} ({rest / delta:.2f} counts), least {experiment.trial.minimum_rest_counts:g} counts",
            "push more, or lower wall.stiffness",
        ),
    ]


def _slower_changes(experiment: Experiment, velocity: float) -> dict[str, float]:
    """Return by key a push and stiffness with which the handle reaches the wall below the speed limit.

    `velocity` is the predicted velocity at the wall (rad/s or m/s). Empty for a person's trial, if `velocity` is low
    enough, and if the estimator diverges.
    """
    way = abs(experiment.wall.position - experiment.trial.start)
    count = highest_reading(experiment)
    speed = LESS * experiment.rig.limits.speed - min(count, COUNT_SPEED_SHARE * experiment.rig.limits.speed)
    if experiment.trial.kind == "human" or velocity <= speed or math.isinf(count):
        return {}
    push = holding_effort(experiment) + 0.5 * homing.inertia(experiment) * speed**2 / way
    rest = experiment.trial.minimum_rest_counts * experiment.rig.encoder.resolution
    rests = push >= rest * experiment.wall.stiffness
    softer = {} if rests else {"wall.stiffness": float(f"{LESS * push / rest:.3g}")}
    return {"trial.effort": experiment.wall.side * float(f"{push:.3g}"), **softer}


def _stiffer_changes(experiment: Experiment, hit: PredictedImpact) -> dict[str, float]:
    """Return by key the stiffness of a wall that stops the handle within the window; empty for a person's trial."""
    limits = experiment.rig.limits
    end = limits.position_maximum if experiment.wall.side > 0 else limits.position_minimum
    room = LESS * abs(end - experiment.wall.position)
    if experiment.trial.kind == "human" or room == 0.0:
        return {}
    work, kinetic = push_at_rest(experiment) * room, homing.inertia(experiment) * hit.velocity**2
    stiffness = (2.0 * work + kinetic) / room**2
    return {"wall.stiffness": float(f"{stiffness:.3g}")}


def _let_go_check(experiment: Experiment) -> Check:
    """Check that a pressing hand stays within the window when the wall is switched off at the end of a trial."""
    limits = experiment.rig.limits
    start = experiment.trial.start
    end = start + experiment.wall.side * _hand_travel(experiment, abs(experiment.wall.position - start))
    inside = limits.position_minimum <= end <= limits.position_maximum
    return limited(
        "after the wall",
        inside,
        f"the hand continues to {end:.3g} {unit_of('position', experiment.rig.motion)}, window "
        f"{limits.position_minimum:g} … {limits.position_maximum:g}",
        "press less, or choose a stiffer grip",
    )


def _heat_check(experiment: Experiment) -> Check:
    seconds = experiment.trial.duration_s * experiment.trial.repeats
    remedy = "push less, shorten trial.duration_s, or let the motor cool between repeats"
    return heat_check(experiment, push_at_rest(experiment), seconds, remedy)
