"""Check rules between several keys of an experiment; each rule is a function that yields the problems that it finds.

The rules run after the type and range of each key have been checked. The loader of experiments calls them. A rule must
not change the experiment.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

from rig.config import amplifiers
from rig.config._derive import motor_push, press_for, push_at_rest, push_s
from rig.config._files import flatten
from rig.config._problems import Problem, did_you_mean
from rig.config._sections import Experiment
from rig.config._table import parameters, shown
from rig.core.present import plain
from rig.core.sample import Motion, unit_of

# In current quanta: a command contains the current as i16.
LARGEST_CURRENT = 32767
# Five times `rig.loop._run.POLL_S`, the period of the supervising thread.
SHORTEST_HEARTBEAT_S = 0.1
# between two indices: fewer, and one count is too large a share to judge where one lies
LEAST_INDEX_COUNTS = 16
# Magnitudes of any quantity in SI units; a place may be what rounding left, such as 0.1 + 0.2 - 0.3.
LEAST, GREATEST = 1e-30, 1e15
# A travel of one distance between indices contains an index; a quarter more, so that one lies beyond the switch.
TRAVEL_OVER_INDEX_DISTANCE = 1.25
MOST_ORDER = 1000  # of cogging; no motor has as many slots
LARGEST_DISC = 10_000_000  # lines of an encoder; no disc has more


def broken_rules(experiment: Experiment) -> list[Problem]:
    """Return the problems that all rules find in the experiment; an empty list if there is no problem."""
    return [problem for rule in RULES for problem in rule(experiment)]


def magnitudes(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem for each number so small or large that its square or product could overflow.

    Settings of laws and estimators have their own ranges and are not checked here.
    """
    for key, value in flatten(plain(experiment)):
        if ".parameters." in key:
            continue
        if isinstance(value, float) and value and not LEAST <= abs(value) <= GREATEST:
            must = f"must be 0, or between {LEAST:g} and {GREATEST:g} in magnitude"
            yield Problem(key, shown(value), must, "check the unit: the value is beyond that of any rig")


def rates(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the position rate is not an integer multiple of the velocity rate."""
    fast, slow = experiment.controller.position_rate, experiment.controller.velocity_rate
    if fast % slow == 0:
        return
    multiples = [n * slow for n in (fast // slow, fast // slow + 1) if n > 0]
    below = next(v for v in range(min(slow, fast), 0, -1) if fast % v == 0)
    above = next((v for v in range(slow + 1, fast + 1) if fast % v == 0), below)
    yield _problem(
        experiment,
        "controller.position_rate",
        f"must be an integer multiple of controller.velocity_rate = {slow} Hz",
        f"nearest allowed: position_rate = {_either(multiples)} Hz, "
        f"or velocity_rate = {_either([below, above])} Hz",
    )


def wall_position(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the law uses the estimator's position although position and velocity rate differ."""
    fast, slow = experiment.controller.position_rate, experiment.controller.velocity_rate
    if experiment.wall.position_from == "estimator" and fast != slow:
        yield _problem(
            experiment,
            "wall.position_from",
            f"needs an estimate in every tick, but controller.velocity_rate is {slow} Hz and position_rate {fast} Hz",
            f'set controller.velocity_rate = {fast}, or wall.position_from = "encoder"',
        )


def slow_rate(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the slow velocity rate of adaptive sampling does not divide the velocity rate."""
    slow, rate = experiment.controller.slow_velocity_rate, experiment.controller.velocity_rate
    if slow is not None and (slow > rate or rate % slow):
        yield _problem(
            experiment,
            "controller.slow_velocity_rate",
            f"must divide controller.velocity_rate = {rate} Hz",
            f"set a divisor of it, for example {rate // 2 if rate % 2 == 0 else 1} Hz",
        )


def encoder(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if a rotary encoder lacks its number of lines, or a linear encoder its quantum (m per count)."""
    motion, lines = experiment.rig.motion, experiment.rig.encoder.counts_per_revolution
    if motion == "rotary" and lines is None:
        yield _wrong_encoder(experiment, "quantum", "counts_per_revolution", "linear")
    elif motion == "linear" and lines is not None:
        yield _wrong_encoder(experiment, "counts_per_revolution", "quantum", "rotary")
    elif lines is not None and lines > LARGEST_DISC:
        key = "rig.encoder.counts_per_revolution"
        yield _problem(
            experiment, key, f"must be > 0 and ≤ {LARGEST_DISC}", "give the lines in its data sheet"
        )


def _wrong_encoder(experiment: Experiment, given: str, wanted: str, other: Motion) -> Problem:
    parameter = parameters()[f"rig.encoder.{wanted}"]
    return _problem(
        experiment,
        f"rig.encoder.{given}",
        f'belongs to a rig with motion = "{other}"; rig.motion = "{experiment.rig.motion}" needs rig.encoder.{wanted}, '
        f"{parameter.expected(experiment.rig.motion)} ({parameter.meaning})",
        f'give {wanted} in its place, or set rig.motion = "{other}"',
    )


def reference(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the encoder's index does not identify a single position in the travel of the handle."""
    given, key, unit = experiment.rig.reference, "rig.reference", _unit(experiment, "position")
    if not given.index:
        if given.limit_switch != "none":
            yield _problem(
                experiment,
                f"{key}.limit_switch",
                'must be "none" without an index',
                f"set {key}.index = true, or remove it",
            )
        return
    counts, window = (
        given.index_counts(experiment.rig.encoder),
        experiment.rig.limits.position_maximum - experiment.rig.limits.position_minimum,
    )
    distance = counts * experiment.rig.encoder.resolution
    if counts < LEAST_INDEX_COUNTS:
        yield _problem(
            experiment,
            f"{key}.index_distance",
            f"must be at least {LEAST_INDEX_COUNTS} counts, "
            f"{LEAST_INDEX_COUNTS * experiment.rig.encoder.resolution:.3g} {unit}",
            "give the distance between two indices from the encoder's data sheet",
        )
    elif given.travel is None or given.travel < window:
        yield _problem(
            experiment,
            f"{key}.travel",
            f"must be given with an index, and be at least the position window, {window:.4g} {unit}",
            "measure the travel of the handle from stop to stop",
        )
    elif given.limit_switch == "none" and given.travel >= distance:
        yield _problem(
            experiment,
            f"{key}.limit_switch",
            f"must name an end of the travel: a travel of {given.travel:.4g} {unit} may contain more "
            f"than one index, one every {distance:.4g} {unit}, and only a limit switch identifies "
            "which one was found",
            "wire a limit switch at one end, or mount the encoder where it turns less than once",
        )
    elif given.travel <= TRAVEL_OVER_INDEX_DISTANCE * distance and given.limit_switch != "none":
        yield _problem(
            experiment,
            f"{key}.travel",
            "must be long enough to contain an index beyond the switch: more than "
            f"{TRAVEL_OVER_INDEX_DISTANCE * distance:.4g} {unit}",
            'set limit_switch = "none", which is enough if the travel contains one index',
        )


def cogging(experiment: Experiment) -> Iterator[Problem]:
    """Yield problems of the cogging map: wrong orders, lists of unequal length, missing period, or an invalid range."""
    given, key = experiment.rig.cogging, "rig.cogging"
    if len(set(given.orders)) < len(given.orders) or not all(1 <= n <= MOST_ORDER for n in given.orders):
        yield _problem(
            experiment,
            f"{key}.orders",
            f"must be different numbers from 1 to {MOST_ORDER}",
            "name each harmonic once",
        )
    for name in ("cosine", "sine"):
        if len(getattr(given, name)) != len(given.orders):
            yield _problem(
                experiment,
                f"{key}.{name}",
                f"must have one number for each of the {len(given.orders)} orders in {key}.orders",
                "change both lists together; write 0.0 for an absent component",
            )
    yield from _ripple(experiment)
    if given.orders and given.period is None:
        yield _problem(
            experiment,
            f"{key}.period",
            f"must be given with {key}.orders",
            "give the travel at the link after which cogging repeats: one turn of the motor, or the "
            "pitch of the magnets",
        )
    low, high = given.minimum, given.maximum
    if (low is None) != (high is None) or (low is not None and high is not None and low >= high):
        yield _problem(
            experiment,
            f"{key}.minimum",
            f"must lie below {key}.maximum, and both be given",
            "give both, or neither",
        )


def _ripple(experiment: Experiment) -> Iterator[Problem]:
    given, key = experiment.rig.cogging, "rig.cogging"
    cosines, sines = len(given.ripple_cosine), len(given.ripple_sine)
    if cosines != sines or cosines not in (0, len(given.orders)):
        yield _problem(
            experiment,
            f"{key}.ripple_cosine",
            f"must have one number for each of the {len(given.orders)} orders in {key}.orders, as {key}.ripple_sine",
            "change both lists together, with 0.0 for an absent component; or give neither",
        )
    elif given.ripple_crest >= 1.0:
        yield _problem(
            experiment,
            f"{key}.ripple_cosine",
            f"gives with {key}.ripple_sine up to {given.ripple_crest:.3g} of the effort: must stay below 1",
            "give shares of the effort, such as 0.02",
        )


def cogging_compensation(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem for each missing requirement of cogging compensation: map, encoder index, law on the host."""
    if not experiment.controller.cogging_compensation:
        return
    given, key = experiment.rig.cogging, "controller.cogging_compensation"
    if not given.orders or given.minimum is None or given.maximum is None:
        yield _problem(
            experiment,
            key,
            "needs a map: rig.cogging.orders, minimum and maximum",
            "measure the map with `rig identify --cogging`",
        )
    if not experiment.rig.reference.index:
        yield _problem(
            experiment,
            key,
            "needs a position zero from an index (rig.reference.index); otherwise the map may be shifted",
            f"wire the encoder's index and describe it in [rig.reference], or set {key} = false",
        )
    if experiment.controller.loop == "device":
        yield _problem(
            experiment,
            key,
            'must be false with controller.loop = "device": the firmware does not compensate cogging',
            f'set {key} = false, or let the host run the law (controller.loop = "host")',
        )


def handle(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if a linear rig, which has no lever arm, has a handle radius other than 1."""
    if experiment.rig.motion == "linear" and experiment.rig.mechanics.handle_radius != 1.0:
        yield _problem(
            experiment,
            "rig.mechanics.handle_radius",
            "must be 1 on a linear rig, which has no lever arm",
            "remove this key",
        )


def current(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the largest current does not fit into the 16 bits of a command."""
    amplifier = experiment.rig.amplifier
    largest = LARGEST_CURRENT * amplifier.effort_quantum
    if amplifier.effort_limit > largest:
        yield _problem(
            experiment,
            "rig.amplifier.effort_limit",
            f"must be ≤ {largest:.4g} {_unit(experiment, 'effort')}, which is {LARGEST_CURRENT} current quanta",
            "raise rig.amplifier.current_quantum_a",
        )


def profile(experiment: Experiment) -> Iterator[Problem]:
    """Yield problems if keys of ``[rig.amplifier]`` contradict the profile (data sheet) of the rig's amplifier."""
    amplifier, key = experiment.rig.amplifier, "rig.amplifier.profile"
    if (why := amplifiers.REFUSED.get(amplifier.profile)) is not None:
        yield _problem(experiment, key, why, 'use a bridge with phase and enable inputs ("voltage-bridge")')
        return
    if amplifier.profile not in amplifiers.names():
        known = f"choose one of: {', '.join(amplifiers.names())}"
        remedy = did_you_mean(amplifier.profile, amplifiers.names(), known)
        yield _problem(experiment, key, "must be a known amplifier", remedy)
        return
    known_of = amplifiers.load(amplifier.profile)
    if known_of.drive not in (None, amplifier.drive):
        yield _problem(
            experiment,
            "rig.amplifier.drive",
            f"must be {known_of.drive} with {key} = {shown(known_of.name)}",
            f"set rig.amplifier.drive to {known_of.drive}"
            if known_of.drive == "current"
            else "set it to voltage, and rig.amplifier.back_emf_damping to k_t²/R at the link",
        )
    if amplifier.drive == "voltage" and known_of.drive == "voltage" and amplifier.back_emf_damping == 0.0:
        yield _problem(
            experiment,
            "rig.amplifier.back_emf_damping",
            "must be > 0 on a plain bridge",
            "set it to k_t²/R at the link",
        )
    if amplifier.set_point_delay_s < known_of.set_point_delay_s * (1.0 - 1e-9):
        yield _problem(
            experiment,
            "rig.amplifier.set_point_delay_s",
            f"must be ≥ {known_of.set_point_delay_s:g} s with {key} = {shown(known_of.name)}",
            "set at least the delay of the set-point to the amplifier: a PWM period, or until the "
            "amplifier reads the voltage",
        )


def efforts(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem for each effort above its limit: of the motor, of the trial, or for a person at the handle."""
    limits, motor = experiment.rig.limits, experiment.rig.amplifier.effort_limit
    for key, value, bound_key, bound in (
        ("rig.limits.nominal_effort", limits.nominal_effort, "rig.amplifier.effort_limit", motor),
        ("rig.limits.effort", limits.effort, "rig.amplifier.effort_limit", motor),
        ("homing.effort", experiment.homing.effort, "rig.limits.effort", limits.effort),
        ("trial.effort", abs(motor_push(experiment)), "rig.limits.effort", limits.effort),
        ("excitation.peak", experiment.excitation.peak or 0.0, "rig.limits.effort", limits.effort),
        ("excitation.rms", experiment.excitation.rms or 0.0, "rig.limits.effort", limits.effort),
    ):
        if value > bound:
            yield _problem(
                experiment,
                key,
                f"must be at most {bound_key}, {bound:g} {_unit(experiment, 'effort')}",
                f"lower {key}, or raise {bound_key} if the motor allows it",
            )
    if limits.human and not limits.override_stall and limits.effort > limits.nominal_effort:
        yield _problem(
            experiment,
            "rig.limits.effort",
            f"must be at most rig.limits.nominal_effort, {limits.nominal_effort:g} {_unit(experiment, 'effort')}, "
            "while a person holds the handle (rig.limits.human = true)",
            "lower rig.limits.effort; or set rig.limits.override_stall = true and take responsibility for it",
        )


def window(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the wall, the start or the initial position is outside the allowed position window."""
    low, high, unit = (
        experiment.rig.limits.position_minimum,
        experiment.rig.limits.position_maximum,
        _unit(experiment, "position"),
    )
    if low >= high:
        yield _problem(
            experiment,
            "rig.limits.position_minimum",
            f"must be below position_maximum, {high:g} {unit}",
            "swap the two values",
        )
        return
    for key, value in (
        ("wall.position", experiment.wall.position),
        ("trial.start", experiment.trial.start),
        ("rig.simulation.initial_position", experiment.rig.simulation.initial_position),
    ):
        if value is not None and not low < value < high:
            yield _problem(
                experiment,
                key,
                f"must lie inside the position window, {low:g} to {high:g} {unit}",
                f"change {key}, or widen rig.limits.position_minimum and position_maximum if the rig allows it",
            )


def approach(experiment: Experiment) -> Iterator[Problem]:
    """Yield problems if a trial starts inside the wall, or if its constant push points away from the wall."""
    side, wall, unit = experiment.wall.side, experiment.wall.position, _unit(experiment, "position")
    # An excitation begins inside a wall that acts on both sides, so it has no free side.
    if experiment.trial.kind == "excitation":
        return
    if side * (experiment.trial.start - wall) >= 0:
        where = "below" if side > 0 else "above"
        yield _problem(
            experiment,
            "trial.start",
            f"must be {where} wall.position, {wall:g} {unit}: the free side for wall.side = {side}",
            "start farther out, or change the sign of wall.side",
        )
    if experiment.trial.kind == "constant-effort" and side * experiment.trial.effort <= 0:
        sign = ">" if side > 0 else "<"
        yield _problem(
            experiment,
            "trial.effort",
            f"must be {sign} 0 {_unit(experiment, 'effort')} to push into a wall with wall.side = {side}",
            "change its sign, or the sign of wall.side",
        )


def choreography(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem for a baseline, foreperiod or hold time in a trial without a person, which has no cue to move."""
    if experiment.trial.kind == "human":
        return
    for name in ("baseline_s", "foreperiod_s", "hold_s"):
        if getattr(experiment.trial, name) > 0.0:
            yield _problem(
                experiment,
                f"trial.{name}",
                f'must be 0 with trial.kind = "{experiment.trial.kind}", which has no cue and starts at a fixed time',
                f'remove trial.{name}, or set trial.kind = "human"',
            )


def rest(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the push rests fewer encoder counts deep in the wall than ``trial.minimum_rest_counts``."""
    if experiment.wall.stiffness == 0 or any(
        encoder(experiment)
    ):  # without a valid encoder there is no resolution
        return
    resolution, least = experiment.rig.encoder.resolution, experiment.trial.minimum_rest_counts
    push, needed = push_at_rest(experiment), least * resolution * experiment.wall.stiffness
    if push >= needed or push == 0:
        return
    softest = push / (least * resolution)
    key, asked = "trial.effort", f"{needed:.3g} {_unit(experiment, 'effort')}"
    if experiment.trial.kind == "human":
        key, asked = "operator.press", f"{press_for(experiment, needed):.3g} N"
    yield _problem(
        experiment,
        key,
        f"must be at least {asked}: against wall.stiffness = {experiment.wall.stiffness:g} "
        f"{_unit(experiment, 'stiffness')} it rests {least * push / needed:.2g} counts deep, less than "
        f"trial.minimum_rest_counts = {least:g}",
        f"raise {key}, or choose a wall.stiffness of at most {softest:.3g} {_unit(experiment, 'stiffness')}",
    )


def press(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the push of the hand exceeds the effort limit."""
    push, limit = push_at_rest(experiment), experiment.rig.limits.effort
    if experiment.trial.kind == "human" and push > limit:
        effort = _unit(experiment, "effort")
        yield _problem(
            experiment,
            "operator.press",
            f"must leave the push, {push:.3g} {effort} at the link with the spring of the hand, at most "
            f"rig.limits.effort, {limit:g} {effort}",
            "lower operator.press, or raise rig.limits.effort if the motor allows it",
        )


def reach(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the simulated hand's movement to the wall ends too late to judge the trial.

    It must end before the last part of the trial, which is judged; with a hold time, within the longest wait for a
    contact (`trial.duration_s`).
    """
    end = experiment.operator.begin_s + experiment.operator.reach_s
    if experiment.trial.hold_s > 0.0:
        if experiment.trial.kind == "human" and end > experiment.trial.duration_s:
            yield _problem(
                experiment,
                "operator.reach_s",
                f"must end before the wait for a contact: the reach ends {end:g} s after the cue (operator.begin_s + "
                f"reach_s), trial.duration_s is {experiment.trial.duration_s:g} s",
                "reach faster, or lengthen trial.duration_s",
            )
        return
    tail = experiment.trial.duration_s - experiment.verdict.tail_s
    if experiment.trial.kind == "human" and end > tail > 0:  # a tail that is too long has its own problem
        yield _problem(
            experiment,
            "operator.reach_s",
            f"must end before the judged tail: the reach begins {experiment.operator.begin_s:g} s into the trial "
            f"(operator.begin_s) and ends at {end:g} s, the tail begins at {tail:g} s "
            f"(trial.duration_s = {experiment.trial.duration_s:g} s less "
            f"verdict.tail_s = {experiment.verdict.tail_s:g} s)",
            "reach faster, or lengthen trial.duration_s",
        )


def speeds(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the homing speed is not below the speed at which a run ends (``rig.limits.speed``)."""
    if experiment.homing.speed >= experiment.rig.limits.speed:
        yield _problem(
            experiment,
            "homing.speed",
            f"must be below rig.limits.speed, {experiment.rig.limits.speed:g} {_unit(experiment, 'velocity')}",
            "choose a lower homing speed",
        )


def times(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the judged last part is not shorter than the push, or the velocity band has no width.

    The last part is `verdict.tail_s` long; in it the rms velocity is measured from `highpass_hz` to `lowpass_hz`.
    """
    if experiment.trial.kind != "excitation" and experiment.verdict.tail_s >= push_s(experiment):
        of = "hold_s" if experiment.trial.hold_s else "duration_s"
        yield _problem(
            experiment,
            "verdict.tail_s",
            f"must be shorter than trial.{of}, {push_s(experiment):g} s",
            f"shorten verdict.tail_s or lengthen trial.{of}",
        )
    if experiment.verdict.highpass_hz >= experiment.verdict.lowpass_hz:
        yield _problem(
            experiment,
            "verdict.highpass_hz",
            f"must be below verdict.lowpass_hz, {experiment.verdict.lowpass_hz:g} Hz",
            "swap the two values",
        )


def excitation(experiment: Experiment) -> Iterator[Problem]:
    """Yield problems of the multisine: its band (empty, or above Nyquist), its period, or both an rms and a peak."""
    multisine, rate = experiment.excitation, experiment.controller.position_rate
    if multisine.low_hz > multisine.high_hz:
        yield _problem(
            experiment,
            "excitation.low_hz",
            f"must be at most excitation.high_hz, {multisine.high_hz:g} Hz",
            "swap the two",
        )
    elif math.ceil(multisine.low_hz * multisine.period_s - 1e-6) > math.floor(
        multisine.high_hz * multisine.period_s + 1e-6
    ):
        yield _problem(
            experiment,
            "excitation.period_s",
            f"must have a line between {multisine.low_hz:g} and {multisine.high_hz:g} Hz: the lines are "
            f"{1.0 / multisine.period_s:g} Hz apart",
            "lengthen the period, or widen the band from low_hz to high_hz",
        )
    if multisine.rms is not None and multisine.peak is not None:
        yield _problem(
            experiment,
            "excitation.peak",
            "must be left out when excitation.rms is given",
            "remove rms or peak",
        )
    if multisine.kind == "schroeder" and multisine.realisations > 1:
        yield _problem(
            experiment,
            "excitation.realisations",
            'must be 1 with excitation.kind = "schroeder", whose phases are always the same',
            'set it to 1, or excitation.kind = "random"',
        )
    if experiment.trial.kind != "excitation":
        return
    if multisine.high_hz >= 0.5 * rate:
        yield _problem(
            experiment,
            "excitation.high_hz",
            f"must be below {0.5 * rate:g} Hz, half of controller.position_rate",
            "lower excitation.high_hz, or raise controller.position_rate",
        )
    ticks = multisine.period_s * rate
    if abs(ticks - round(ticks)) > 1e-6:
        yield _problem(
            experiment,
            "excitation.period_s",
            f"must be a whole number of ticks of 1/{rate} s",
            f"nearest allowed: {max(1, round(ticks)) / rate:.9g} s",
        )


def heartbeat(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if the heartbeat timeout is neither 0 (no check) nor long enough for the supervising thread."""
    # The supervising thread runs some fifty times a second, when it gets the interpreter.
    if 0.0 < experiment.host.heartbeat_s < SHORTEST_HEARTBEAT_S:
        yield _problem(
            experiment,
            "host.heartbeat_s",
            f"must be 0 or at least {SHORTEST_HEARTBEAT_S:g} s",
            f"set at least {SHORTEST_HEARTBEAT_S:g} s, or 0 to run without this check",
        )


def device_loop(experiment: Experiment) -> Iterator[Problem]:
    """Yield a problem if ``host.pacing`` or ``host.overrun`` has a value that needs a force law on the host."""
    if experiment.controller.loop != "device":
        return
    why = 'where the device runs the law (controller.loop = "device")'
    if experiment.host.pacing == "host":
        yield _problem(experiment, "host.pacing", f'must be "device" {why}', "remove this key")
    if experiment.host.overrun == "stop":
        yield _problem(
            experiment,
            "host.overrun",
            f'must be "skip" {why}',
            "remove this key: the device counts its own ticks",
        )


RULES: tuple[Callable[[Experiment], Iterator[Problem]], ...] = (
    magnitudes,
    rates,
    wall_position,
    slow_rate,
    encoder,
    reference,
    cogging,
    cogging_compensation,
    handle,
    current,
    profile,
    efforts,
    window,
    approach,
    choreography,
    rest,
    press,
    reach,
    speeds,
    times,
    excitation,
    heartbeat,
    device_loop,
)


def _problem(experiment: Experiment, key: str, must: str, remedy: str) -> Problem:
    value: Any = experiment
    for part in key.split("."):
        value = getattr(value, part)
    unit = parameters()[key].unit_for(experiment.rig.motion)
    return Problem(key, f"{shown(value)} {unit}".rstrip(), must, remedy)


def _unit(experiment: Experiment, quantity: str) -> str:
    return unit_of(quantity, experiment.rig.motion)


def _either(values: list[int]) -> str:
    return " or ".join(str(v) for v in dict.fromkeys(values))
