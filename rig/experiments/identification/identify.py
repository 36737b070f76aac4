"""Identify a rig: record small pushes, slow strokes and excitations, then fit with `rig.analysis.identification`.

`rig identify` and `rig.experiments.measure` call this module. It must not change or write an experiment file:
`identified_file` formats the new file. The same code runs on the simulated rig and on a real rig.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from rig import config, devices
from rig.analysis.identification import (
    DOUBTFUL_DRIFT,
    MOST_DRIFT,
    CoggingMap,
    Dynamics,
    IdentificationError,
    Ripple,
    SignCheck,
    Sliding,
    Stroke,
    fit_cogging,
    fit_dynamics,
    fit_ripple,
    fit_sliding,
    pairs_of,
    period_change,
    stiction_warning,
)
from rig.analysis.impedance import ExcitedRun
from rig.config import Experiment
from rig.control.excitation import Multisine
from rig.core.check import refuse
from rig.core.errors import ConfigError, PlanError, RigError
from rig.core.keyword import Keyword
from rig.core.model import Cogging
from rig.core.present import Item, Row, reported
from rig.core.same_rig import check_rig
from rig.core.sample import RowFlag, unit_of
from rig.core.shown import Drawn, Shown
from rig.devices.device import DeviceUrl
from rig.devices.framed import FramedDevice
from rig.doctor.pace import SECONDS
from rig.experiments.identification._identified_values import identified_values
from rig.experiments.identification._identify_rate import RATES, at_rate, choose_rate, halves, measure_for
from rig.experiments.motion._motion_run import (
    ATTEMPTS,
    LONGEST_FILLED,
    FreeRigRequest,
    TimingError,
    position_now,
    refuse_unverified,
    repeat_if_late,
    run_motion,
    signs_of,
    spoiled_by_timing,
    trial_rows,
)
from rig.experiments.motion._weigh import (
    STANDARD_GRAVITY,
    Ask,
    WeighRequest,
    hung,
    refuse_load,
    weigh,
    with_mass,
)
from rig.experiments.trials._identify_motions import (
    PERIODS,
    PUSHES,
    IdentificationMotion,
    cogging_motion,
    cogging_period,
    cogging_sweeps,
    excitation,
    excitation_motion,
    excited_s,
    identification_plan,
    loaded_plan,
    most_push,
    pushes_motion,
    settle_periods,
    still,
    strokes_motion,
    strokes_of,
)
from rig.experiments.trials.excitation_run import late_ticks
from rig.experiments.trials.plan import link_checks
from rig.experiments.trials.planned import Plan
from rig.experiments.trials.preparation import position_zero
from rig.realtime import stop_requests
from rig.recording.files import free_name, plain_errors

__all__ = [
    "Identification",
    "IdentifyRequest",
    "WeighRequest",
    "acting_effort",
    "excited_run_of",
    "identify",
    "plan_of",
    "trial_rows",
    "weigh",
    "without_end_mass",
]

# Highest harmonic of cogging: a higher harmonic needs a slower sweep.
MOST_ORDER = 200

Tell = Callable[[str], None]
Floats = NDArray[np.float64]
Swept = tuple[Floats, Floats, Floats, list[Stroke]]  # time, effort, position


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyRequest(FreeRigRequest):
    """A request of an identification; the described rig is the initial guess.

    Attributes
    ----------
    rate_hz
        Rate of the loop during the motions only (Hz). None: the experiment's rate, or in real time a rate that the
        device and the measured link permit.
    mass_kg, arm_m
        Mass (kg) and lever arm (m) with which the slow sweeps for cogging are repeated to measure torque ripple.
        Without a mass (None) ripple is not measured; without an arm the radius of the handle is used.
    """

    realisations: Annotated[int, Keyword("Number of excitations, each with other phases.")] = 6
    period_s: Annotated[float, Keyword("Period of the excitation (s).", names=("--period",))] = 0.5
    seed: Annotated[int, Ge(0), Keyword("Seed of the phases of the excitation. [0]", group="Experiment")] = 0
    cogging: Annotated[
        int | None,
        Keyword(
            "Also map cogging, up to this harmonic of the motor's turn, by slow sweeps over the window.",
            metavar="ORDER",
        ),
    ] = None
    rate_hz: int | None = None
    mass_kg: float | None = None
    arm_m: float | None = None
    output: Annotated[
        str | Path, Keyword("Directory of recordings and picture.", "", ("--recordings",), "Result", "path")
    ] = "recordings"

    def __post_init__(self) -> None:
        if self.mass_kg is not None and self.cogging is None:
            raise ConfigError(
                "a mass is given to measure ripple, but ripple needs the cogging sweeps, which are not requested",
                remedy="also give the highest harmonic of cogging (`cogging`), or omit the mass",
            )
        for name, value in (("mass", self.mass_kg), ("arm", self.arm_m)):
            if value is not None and not (0.0 < value < math.inf):
                raise ConfigError(
                    f"the {name} is {value:g} {'kg' if name == 'mass' else 'm'}; it must be finite and above zero",
                    remedy=f"give a {name} above zero",
                )
        if self.realisations < 2:
            raise ConfigError(
                f"{self.realisations} realisations are too few for a confidence interval: at least 2 are needed",
                remedy="use 2 or more; 6 are usual",
            )
        if self.cogging is not None and not 1 <= self.cogging <= MOST_ORDER:
            raise ConfigError(
                f"cogging up to harmonic {self.cogging} is out of range",
                remedy=f"choose 1 to {MOST_ORDER}: the least common multiple of slots and poles, or twice that",
            )
        if not 0.1 <= self.period_s <= 10.0:
            raise ConfigError(
                f"the period of the excitation is {self.period_s:g} s, outside of 0.1 to 10 s",
                remedy="choose 0.1 to 10 s",
            )


@dataclass(frozen=True, kw_only=True, repr=False)
class Identification(Shown, Drawn):
    """A result of an identification: the fits, their recordings, and the experiment with the identified values.

    Attributes
    ----------
    before, experiment
        Experiment as it was described, and with the identified values.
    signs, sliding, dynamics
        Fits of small pushes, of strokes at constant speed, and of a multisine excitation
        (`rig.analysis.identification`): signs, friction, and inertia with delay.
    cogging
        Fit of slow sweeps over the travel; None if it was not requested.
    ripple
        Fit of the same sweeps with a mass; None without a mass.
    recordings
        Recordings of each fit: ``"signs"``, ``"sliding"``, ``"dynamics"``, ``"cogging"``, ``"ripple"``.
    sources
        For each identified key a text with its value, its interval and its recordings.
    warnings
        Warnings that a person should check.
    simulated
        True if the device was simulated.
    """

    before: Experiment = field(repr=False)
    experiment: Experiment = field(repr=False)
    signs: SignCheck
    sliding: Sliding
    dynamics: Dynamics
    cogging: CoggingMap | None
    ripple: Ripple | None
    recordings: Mapping[str, tuple[Path, ...]]
    sources: Mapping[str, str]
    warnings: tuple[str, ...]
    simulated: bool

    @reported
    def rig(self) -> str:
        """Return the name of the identified rig."""
        return self.experiment.rig.name

    @reported
    def motion(self) -> str:
        """Return the rig's kind of motion, rotary or linear, which determines the units."""
        return self.experiment.rig.motion

    def brief(self) -> list[Item]:
        """Return the lines of a short report: friction, damping, inertia and delay with intervals, and warnings."""
        experiment, sliding, dynamics = self.experiment, self.sliding, self.dynamics
        values = {
            "Coulomb friction": sliding.coulomb.text(_unit(experiment, "effort")),
            "viscous damping": sliding.damping.text(_unit(experiment, "damping")),
            "inertia": dynamics.inertia.text(_unit(experiment, "inertia")),
            "delay": dynamics.delay_s.scaled(1e3).text("ms"),
        }
        rows = [Row(name, text) for name, text in values.items()]
        return [f"{self.rig}, identified", *rows, *(f"warning: {one}" for one in self.warnings)]


@stop_requests.together()
def identify(request: IdentifyRequest, tell: Tell | None = None, ask: Ask | None = None) -> Identification:
    """Identify a rig: run the motions, fit the recorded signals, and return the result.

    Parameters
    ----------
    request
        Rig, device and options.
    tell
        Called with a line of text about the next step.
    ask
        Called with the instruction to hang a mass on a real rig; must return when a person has hung the mass.

    Raises
    ------
    PlanError
        The request is not permitted; nothing has moved.
    IdentificationError
        The signs of motor and encoder are wrong, or the data do not determine a value; the message states the reason.
    RigError
        A trial ended early, by the link, the device, the safety guard or the operator; the effort is zero.
    """
    say = tell or (lambda text: None)
    free = without_end_mass(request)
    url = request.url or "sim://"
    if request.mass_kg is not None and ask is None and not url.startswith("sim:"):
        raise ConfigError(
            "a mass must be hung on the rig, but no function is given that instructs the operator",
            remedy="give ask=, a function that shows a text to the operator and returns when this is done",
        )
    with ExitStack() as stack:
        device = stack.enter_context(devices.open_device(url, config.rig_model(still(free))))
        refuse_unverified(device, verified=request.verified)
        if device.dictionary.simulated:
            free = without_end_mass(request, served=not url.startswith("sim:"))
        output = Path(request.output)
        spoiled: RigError | None = None  # timing error at a higher rate
        for base in _at_rates(free, request, device, say):
            plan = plan_of(base, request)
            if spoiled is not None and not plan.ok:
                raise spoiled
            try:
                refuse(plan.checks)
            except PlanError as error:
                if not device.link.clock.virtual and _stated_rate(request) is None:
                    carried = f"computer and link now support {base.controller.position_rate} Hz"
                    error.remedy = f"{carried}: end other programs on the computer; {error.remedy}"
                raise
            refuse(link_checks(base, device.dictionary.position_rate_maximum, device.link.bytes_per_second))
            with plain_errors("make", output):
                output.mkdir(parents=True, exist_ok=True)
            # The link may support less than a minute ago: motions with timing errors run again at half of the rate.
            session = _Session(device, base, request)
            try:
                signs, sliding, dynamics = session.free_motions(base, say)
                break
            except RigError as error:
                if not halves(base.controller.position_rate) or not session.may_go_slower(error):
                    raise
                spoiled = error
                say(f"at {base.controller.position_rate} Hz: {error.message}")
        cogging = ripple = None
        if request.cogging is not None:
            damping = sliding.damping.value + base.rig.amplifier.back_emf
            cogging = session.cogging(dynamics.inertia.value, damping)
            if request.mass_kg is not None:
                arm = _arm(base, request)
                say(f"ripple: the sweeps again, with {request.mass_kg:g} kg at {arm:g} m")
                loaded = with_mass(base, request.mass_kg, arm)
                session.device = hung(
                    stack, device, loaded, url, ask or say, mass_kg=request.mass_kg, arm=arm
                )
                heavy = dynamics.inertia.value + request.mass_kg * arm**2
                ripple = session.ripple(loaded, request.cogging, dynamics.inertia.value, heavy, damping)
        simulated = device.dictionary.simulated
    found = _make_identification(
        request, base, signs, sliding, dynamics, cogging, ripple, session.recordings, simulated=simulated
    )
    return replace(found, warnings=(*found.warnings, *_doubts(base, found, session.drift, session.repeated)))


def _doubts(experiment: Experiment, found: Identification, drift: float, repeated: int) -> Iterator[str]:
    """Yield warnings about identified values that may be wrong by more than their interval, or are unknown."""
    dynamics, damping = found.dynamics, found.sliding.damping
    if repeated:
        yield f"{repeated} motions were measured again: they had lost or late samples"
    if drift > DOUBTFUL_DRIFT:
        yield (
            f"the motion at the median line changed by {100 * drift:.0f} % from one period to the "
            f"next, where {100 * DOUBTFUL_DRIFT:.0f} % are usual at most: keep everything off the "
            "handle, and identify again"
        )
    if damping.ci95 > damping.value:
        value = damping.text(_unit(experiment, "damping"))
        yield (
            f"the viscous damping, {value}, cannot be distinguished from zero: it is masked by "
            "friction and by the encoder's resolution"
        )
    elastic = dynamics.mode_above_hz is not None or experiment.rig.mechanics.structure == "two-mass"
    if dynamics.mode is None and elastic:
        yield (
            f"the first mode lies above the band or is hidden in it (up to {dynamics.band.high_hz:.4g} Hz): inertia "
            "and delay may be wrong by more than their intervals; a finer encoder or more effort widens the band"
        )


def without_end_mass(request: IdentifyRequest, *, served: bool = False) -> Experiment:
    """Return the experiment for the identification: handle free, law on this computer, requested rate.

    The end mass, which only automated trials have, is removed. On a rig that ``sim://name`` or another process behind a
    port (`served`) simulates it stays, and is subtracted from the result.
    """
    experiment = config.override(request.experiment, request.changes)
    url = request.url or "sim://"
    named = url.startswith("sim://") and bool(DeviceUrl.parse(url).place)
    bare = {} if named or served else {"rig.mechanics.end_mass": 0.0}
    free = config.override(experiment, {**bare, "controller.loop": "host"}, "identification")
    return free if request.rate_hz is None else at_rate(free, request.rate_hz, "identification")


def plan_of(free: Experiment, request: IdentifyRequest) -> Plan:
    """Return the plan (steps and checks) of all motions; `free` is the experiment from `without_end_mass`."""
    plan = identification_plan(
        free,
        realisations=request.realisations,
        period_s=request.period_s,
        seed=request.seed,
        cogging=request.cogging,
    )
    if request.cogging is None or request.mass_kg is None:
        return plan
    arm = _arm(free, request)
    weight = request.mass_kg * STANDARD_GRAVITY * arm
    refuse_load(free, weight)
    return loaded_plan(plan, with_mass(free, request.mass_kg, arm), request.cogging, weight)


def _arm(experiment: Experiment, request: IdentifyRequest) -> float:
    return experiment.rig.mechanics.handle_radius if request.arm_m is None else request.arm_m


# ---------------------------------------------------------------------- running them


class _Session:
    """The motions of one identification on an open device, with their recordings."""

    def __init__(self, device: FramedDevice, experiment: Experiment, request: IdentifyRequest) -> None:
        self.device, self._request = device, request
        self._stem = f"identify-{datetime.now():%Y%m%d-%H%M%S}"
        self._reference = position_zero(device, experiment)
        self._swept: Swept  # for cogging, with nothing on the rig
        self._swept_in: tuple[float, int]  # period and highest harmonic
        self._cogging = Cogging()  # measured cogging, which later fits add to the motor's effort
        self.recordings: dict[str, tuple[Path, ...]] = {}
        self.repeated = 0  # number of motions repeated because of late or lost samples
        self.drift = 0.0  # largest change of an excited motion from period to period

    def free_motions(self, experiment: Experiment, say: Tell) -> tuple[SignCheck, Sliding, Dynamics]:
        """Run pushes, slow sweeps for cogging, strokes and excitations; return fits of signs, friction and dynamics."""
        request = self._request
        most = f"{most_push(experiment):.3g} {_unit(experiment, 'effort')}"
        say(f"signs: {PUSHES} small pushes, at most {most}")
        # The order matters: pushes need no known sign and end by themselves after a few counts; strokes need the sign,
        # and measure the friction that the excitation must exceed.
        signs = self.signs(experiment)
        _check_signs(signs)
        if request.cogging is not None:
            say(f"cogging: slow sweeps for {cogging_sweeps(experiment, request.cogging)[1][-1].end_s:.3g} s")
            self.sweep(experiment, request.cogging)
        say("friction: strokes at constant speeds")
        sliding = self.sliding(experiment)
        say(f"dynamics: excited {request.realisations} times for {excited_s(request.period_s):.3g} s")
        return signs, sliding, self.dynamics(experiment, signs, sliding)

    def may_go_slower(self, error: RigError) -> bool:
        """Return True if a lower rate may help: samples were late or lost, and the user set no rate."""
        virtual = self.device.link.clock.virtual
        return spoiled_by_timing(error) and not virtual and _stated_rate(self._request) is None

    def signs(self, experiment: Experiment) -> SignCheck:
        at = position_now(self.device, experiment, self._reference)
        rows, rate = self._run(pushes_motion(experiment, at), "signs")
        return signs_of(experiment, rows, rate)

    def sliding(self, experiment: Experiment) -> Sliding:
        rows, rate = self._run(self._compensate_cogging(strokes_motion(experiment)), "sliding")
        return fit_sliding(
            np.arange(len(rows)) / rate,
            self._effort(rows),
            rows["position"],
            strokes_of(experiment)[1],
            resolution=experiment.rig.encoder.resolution,
            back_emf=experiment.rig.amplifier.back_emf,
        )

    def dynamics(self, experiment: Experiment, signs: SignCheck, sliding: Sliding) -> Dynamics:
        request = self._request
        # The smaller of both inertias determines the excitation: a too large effort could move the handle out of its
        # window, a too small effort only widens the intervals.
        inertia = experiment.rig.mechanics.inertia
        if math.isfinite(signs.inertia):
            inertia = min(inertia, signs.inertia)
        runs, lates = [], []
        for number in range(request.realisations):
            multisine = excitation(experiment, request.seed, request.period_s, inertia, number)
            run, late = self._run_excitation(experiment, multisine, inertia, number)
            runs.append(run)
            lates.append(late)
        found = fit_dynamics(
            runs,
            resolution=experiment.rig.encoder.resolution,
            inertia=inertia,
            sliding=sliding,
            damping=sliding.damping,
            back_emf=experiment.rig.amplifier.back_emf,
        )
        self.drift = max(period_change(run, found.band.chosen) for run in runs)
        return found.later(round(float(np.median(lates))), 1.0 / experiment.controller.position_rate)

    def _run_excitation(
        self, experiment: Experiment, multisine: Multisine, inertia: float, number: int
    ) -> tuple[ExcitedRun, int]:
        """Run the excitation with one draw of phases; return its signals, and the delay of commands (ticks)."""
        motion = self._compensate_cogging(excitation_motion(experiment, multisine, inertia))
        for attempt in range(1 if self.device.link.clock.virtual else ATTEMPTS):
            if attempt:
                self.repeated += 1
                self.recordings["dynamics"] = self.recordings["dynamics"][:-1]
            rows, rate = self._run(motion, "dynamics", number)
            _check_undisturbed(rows)
            effort, late = acting_effort(rows)
            run = excited_run_of(rows, rate, multisine, effort + self._cogging.effort(rows["position"]))
            if period_change(run) <= MOST_DRIFT or not (rows["flags"] & (RowFlag.GAP | RowFlag.LATE)).any():
                break
        return run, late

    def sweep(self, experiment: Experiment, most_order: int) -> None:
        """Run slow sweeps and fit cogging with the rig's described inertia; later motions compensate this cogging."""
        self._swept = self._sweeps(experiment, most_order, "cogging")
        self._swept_in = (cogging_period(experiment), most_order)
        self._cogging = self.cogging(
            experiment.rig.mechanics.inertia, config.rig_model(experiment).damping
        ).cogging

    def cogging(self, inertia: float, damping: float) -> CoggingMap:
        """Fit cogging to the recorded sweeps with this inertia and damping (SI units)."""
        period, most_order = self._swept_in
        return fit_cogging(
            *self._swept, period=period, most_order=most_order, inertia=inertia, damping=damping
        )

    def ripple(
        self, loaded: Experiment, most_order: int, inertia: float, heavy: float, damping: float
    ) -> Ripple:
        """Run the sweeps with a mass and fit torque ripple; `heavy` is the inertia with the mass (kg·m² or kg)."""
        period = cogging_period(loaded)
        free, hanging = (
            pairs_of(*swept, wave=period / most_order, inertia=moving, damping=damping)
            for swept, moving in (
                (self._swept, inertia),
                (self._sweeps(loaded, most_order, "ripple", loaded=True), heavy),
            )
        )
        return fit_ripple(free, hanging, period=period, most_order=most_order)

    def _sweeps(self, experiment: Experiment, most_order: int, name: str, *, loaded: bool = False) -> Swept:
        rows, rate = self._run(cogging_motion(experiment, most_order, loaded=loaded), name)
        sweeps = cogging_sweeps(experiment, most_order, loaded=loaded)[1]
        return np.arange(len(rows)) / rate, rows["effort_sent"], rows["position"], sweeps

    def _compensate_cogging(self, motion: IdentificationMotion) -> IdentificationMotion:
        """Return the motion with known cogging compensated, so that the handle does not jump between detents."""
        experiment = motion.experiment
        if not self._cogging.orders:
            return motion
        taken = replace(experiment.controller, cogging_compensation=True, cogging_limit=1.0)
        evened = replace(experiment, rig=replace(experiment.rig, cogging=self._cogging), controller=taken)
        return IdentificationMotion(config.override(evened, {}, "identification"), motion.law)

    def _effort(self, rows: NDArray[np.void]) -> NDArray[np.float64]:
        """Return for each sample of a motion the sent effort plus the measured cogging (N·m or N)."""
        return np.asarray(rows["effort_sent"] + self._cogging.effort(rows["position"]))

    def _run(
        self, motion: IdentificationMotion, name: str, number: int = 0
    ) -> tuple[NDArray[np.void], float]:
        """Run one motion, again if samples are late; return its samples and their rate (Hz)."""
        experiment, request = motion.experiment, self._request

        def run() -> tuple[NDArray[np.void], Path]:
            return run_motion(
                self.device,
                motion,
                free_name(Path(request.output), f"{experiment.rig.name}-{self._stem}-{name}-{number + 1}"),
                verified=request.verified,
                reference_count=self._reference,
                extra={"identification": name, "number": number + 1, "seed": request.seed},
            )

        (rows, recording), repeated = repeat_if_late(self.device, run, experiment.controller.position_rate)
        self.repeated += repeated
        self.recordings[name] = (*self.recordings.get(name, ()), recording)
        return rows, float(experiment.controller.position_rate)


def excited_run_of(
    rows: NDArray[np.void], rate: float, multisine: Multisine, effort: NDArray[np.float64]
) -> ExcitedRun:
    """Return the signals of one excited motion, without the first periods, in which transients decay.

    `rows` are the logged samples, `rate` is in Hz, and `effort` (N·m or N) is held from each sample to the next. Raise
    `TimingError` if more than three of the last samples are lost.
    """
    n = round(rate * multisine.period_s)
    end = (settle_periods(multisine.period_s) + PERIODS) * n
    lost = max(0, end - len(rows))
    if lost > LONGEST_FILLED:
        raise TimingError(
            f"the last {lost} samples of the excitation are missing, allowed are {LONGEST_FILLED}",
            remedy="identify again",
        )
    # If the last samples are lost, take all periods correspondingly earlier.
    kept = slice(end - PERIODS * n - lost, end - lost)
    return ExcitedRun(
        rate_hz=rate,
        period_samples=n,
        periods=PERIODS,
        excitation=np.roll(np.tile(multisine.period(rate), PERIODS), lost),
        effort=effort[kept],
        position=rows["position"][kept],
        lines_hz=multisine.lines_hz,
        effort_hold_s=1.0 / rate,
    )


def acting_effort(rows: NDArray[np.void]) -> tuple[NDArray[np.float64], int]:
    """Return the effort from each sample to the next as the device reports it (N·m or N), and its delay (ticks)."""
    # Without delay a command acts from its sample on, and the next sample reports it. With the sent effort instead of
    # the reported effort a varying delay would spoil the fit. `late` is the delay of most ticks.
    late = late_ticks(rows["current_sent"], rows["current_applied"])
    applied = np.append(rows["effort_applied"][1:], rows["effort_sent"][-1 - late])
    return applied, late


def _check_undisturbed(rows: NDArray[np.void]) -> None:
    bound = (rows["flags"] & (RowFlag.SATURATED | RowFlag.SLEW_BOUND)) != 0
    if bound.any():
        raise IdentificationError(
            f"the effort or its slew rate was clipped at its limit in {int(bound.sum())} of {len(rows)} ticks, but the "
            "excitation must not be clipped",
            remedy="raise rig.limits.slew or rig.limits.effort",
        )


# ---------------------------------------------------------------------- checks before, results after


def _at_rates(
    free: Experiment, request: IdentifyRequest, device: FramedDevice, say: Tell
) -> Iterator[Experiment]:
    """Yield the experiment at the user's rate only, or at the highest rate of the link and then at its halves."""
    refuse([check_rig(config.rig_model(still(free)), device.dictionary)])
    if device.link.clock.virtual:
        yield free
        return
    stated, dictionary = _stated_rate(request), device.dictionary
    most = min(dictionary.position_rate_default, dictionary.position_rate_maximum)
    say(f"link: measured for {SECONDS:g} s")
    measurement = measure_for(device, free, most if stated is None else free.controller.position_rate)
    choice = choose_rate(
        free, measurement, most_hz=most, stated_hz=None if stated is None else free.controller.position_rate
    )
    if stated is not None:
        yield free
        return
    rate = choice.rate_hz
    say(f"rate: {rate} Hz, by the measured link (silent for {1e3 * choice.silence_s:.3g} ms at most)")
    for slower in (rate, *halves(rate)):
        yield at_rate(free, slower, "real time")


def _stated_rate(request: IdentifyRequest) -> Any:
    """Return the rate that the user set (Hz); None if no rate was set."""
    return request.rate_hz or next((request.changes[key] for key in RATES if key in request.changes), None)


def _check_signs(signs: SignCheck) -> None:
    if signs.sign != 1:
        raise IdentificationError(
            "; ".join(signs.warnings) or "the pushes give no result",
            remedy="change the sign of rig.encoder.sign, or swap two wires of motor or encoder; then identify again",
        )
    if not signs.ok:
        raise IdentificationError(
            "; ".join(signs.warnings) or "the pushes do not show the inertia",
            remedy="correct rig.amplifier.effort_per_ampere, rig.encoder or rig.mechanics; then identify again",
        )


def _make_identification(
    request: IdentifyRequest,
    base: Experiment,
    signs: SignCheck,
    sliding: Sliding,
    dynamics: Dynamics,
    cogging: CoggingMap | None,
    ripple: Ripple | None,
    recordings: Mapping[str, tuple[Path, ...]],
    *,
    simulated: bool,
) -> Identification:
    before = config.override(request.experiment, request.changes)
    on_board = before.controller.loop == "device"
    values = identified_values(base, sliding, dynamics, cogging, ripple, on_board=on_board)
    named = {key: f"{text}; {_files(recordings[kind])}" for key, (text, kind) in values.sources.items()}
    sticking = stiction_warning(0.5 * (signs.breakaway_up + signs.breakaway_down), sliding.coulomb.value)
    return Identification(
        before=before,
        experiment=config.override(before, values.values, "identification"),
        signs=signs,
        sliding=sliding,
        dynamics=dynamics,
        cogging=cogging,
        ripple=ripple,
        recordings=dict(recordings),
        sources=named,
        warnings=(*signs.warnings, *([sticking] if sticking else [])),
        simulated=simulated,
    )


def _files(paths: tuple[Path, ...]) -> str:
    return str(paths[0]) if len(paths) == 1 else f"{paths[0]} … {paths[-1].name}"


def _unit(experiment: Experiment, quantity: str) -> str:
    return unit_of(quantity, experiment.rig.motion)
