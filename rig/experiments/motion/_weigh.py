"""Calibrate the motor's effort by a known mass: the weight is the difference of slow strokes with and without the mass.

    found = weigh(WeighRequest(experiment=x, url="usb://…", verified=True, mass_kg=0.1, arm_m=0.05), ask=input)
    found.effort_per_ampere

`rig identify --weight` calls this module. An error of `rig.amplifier.effort_per_ampere` (torque constant times ratio)
is an error of every reported stiffness. The mass hangs on a string from a drum of radius `arm_m`: on the handle itself,
the lever arm would shrink by up to 2 % within 0.2 rad (cosine), 0.7 % on average.
"""

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rig import config, devices
from rig.analysis.identification import IdentificationError, Interval, Sliding, fit_sliding
from rig.config import Experiment
from rig.core.check import refuse
from rig.core.errors import ConfigError, PlanError
from rig.core.present import Row, reported
from rig.core.same_rig import check_rig
from rig.core.sample import Motion, unit_of
from rig.devices.framed import FramedDevice
from rig.experiments.motion._motion_run import FreeRigRequest, position_now, refuse_unverified, run_motion
from rig.experiments.motion.pulse import at_own_rate
from rig.experiments.trials._identify_motions import coulomb_of, still, weighing_motion, weighing_strokes
from rig.experiments.trials.plan import link_checks
from rig.experiments.trials.preparation import position_zero
from rig.realtime import stop_requests
from rig.recording.files import free_name, plain_errors

STANDARD_GRAVITY = 9.80665  # m/s², by definition; local gravity differs by up to 0.3 %
# Fraction of rig.limits.effort above which a device mistakes a resting handle for a dead encoder.
STILL_SHARE = 0.2

Ask = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class WeighRequest(FreeRigRequest):
    """A request of a calibration: rig, device and mass.

    Attributes
    ----------
    mass_kg
        Mass that hangs on the rig during the second strokes (kg).
    arm_m
        Lever arm of the mass (m); None: the radius of the handle.
    gravity
        Local gravity (m/s²).
    """

    mass_kg: float
    arm_m: float | None = None
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        for name, value in (("mass", self.mass_kg), ("arm", self.arm_m), ("gravity", self.gravity)):
            if value is not None and not (0.0 < value < math.inf):
                raise ConfigError(
                    f"the {name} is {value:g}; it must be finite and above zero",
                    remedy="give the mass in kg, the arm in m and the gravity in m/s², each above zero",
                )


@dataclass(frozen=True, kw_only=True)
class Weighing:
    """A result of the calibration of the motor's effort by a mass.

    Attributes
    ----------
    rig, motion, device
        Name of the rig, its kind of motion (which determines the units), and name of the device.
    mass_kg, arm_m, weight
        Mass (kg) and lever arm (m) of the load, and the effort of its weight (N·m or N).
    measured
        Effort of the weight as measured by the motor's current and the described effort per ampere (N·m or N).
    bare, loaded
        Friction fits of slow strokes without and with the mass.
    described
        `rig.amplifier.effort_per_ampere` of the experiment (N·m/A or N/A).
    recordings
        Recordings of both runs.
    """

    rig: str
    motion: Motion
    device: str
    mass_kg: float
    arm_m: float
    weight: float
    measured: Interval
    bare: Sliding
    loaded: Sliding
    described: float
    recordings: tuple[Path, ...]

    @reported
    def effort_per_ampere(self) -> Interval:
        """Return the calibrated effort per ampere (N·m/A or N/A), with its 95 % interval."""
        share = self.measured.ci95 / self.measured.value
        value = self.described * self.weight / self.measured.value
        return Interval(value, value * share)

    @reported
    def agrees(self) -> bool:
        """Return True if the experiment's effort per ampere lies within the 95 % interval of the calibrated one."""
        return self.effort_per_ampere.holds(self.described)

    def rows(self) -> list[Row]:
        """Return the results as rows to print: weight, measured effort, friction, effort per ampere, recordings."""
        effort, unit = unit_of("effort", self.motion), unit_of("effort/A", self.motion)
        off = self.effort_per_ampere.value / self.described - 1.0
        agreement = (
            "as described, within the interval" if self.agrees else f"{100 * off:+.2g} % of that described"
        )
        return [
            Row("weight", self.weight, effort, f"{self.mass_kg:g} kg at {self.arm_m:g} m"),
            Row("measured", self.measured.text(effort)),
            Row("friction", f"{self.bare.coulomb.text()}, with the mass {self.loaded.coulomb.text(effort)}"),
            Row("rig.amplifier.effort_per_ampere", self.effort_per_ampere.text(unit)),
            Row("  described", self.described, unit, agreement),
            *(Row("recording", str(path)) for path in self.recordings),
        ]


@stop_requests.together()
def weigh(request: WeighRequest, ask: Ask) -> Weighing:
    """Calibrate the effort: run slow strokes, let a person hang a mass on the rig, and run the strokes again.

    Parameters
    ----------
    request
        Rig, device and mass. A simulated rig is created again with the mass.
    ask
        Called with an instruction to a person; must return when the person has followed it.

    Raises
    ------
    PlanError
        The weight exceeds the nominal effort, or the effort that a device allows at rest; nothing has moved.
    ConfigError
        The polarity of a real rig's motor and encoder is not verified.
    IdentificationError
        The weight cannot be distinguished from friction, or the strokes do not determine it.
    RigError
        A run ended early; the effort is zero.
    """
    described = config.override(request.experiment, request.changes)
    unloaded = {"controller.loop": "host", "rig.mechanics.end_mass": 0.0}
    experiment = config.override(described, unloaded, "weighing")
    arm = experiment.rig.mechanics.handle_radius if request.arm_m is None else request.arm_m
    weight = request.mass_kg * request.gravity * arm
    refuse_load(experiment, weight)
    loaded = with_mass(experiment, request.mass_kg, arm)
    url, output = request.url or "sim://", Path(request.output)
    with ExitStack() as stack:
        device = stack.enter_context(devices.open_device(url, config.rig_model(still(experiment))))
        refuse([check_rig(config.rig_model(still(experiment)), device.dictionary)])
        refuse_unverified(device, verified=request.verified)
        with plain_errors("make", output):
            output.mkdir(parents=True, exist_ok=True)
        zero = position_zero(device, experiment)
        bare, first = _slide(device, experiment, request, zero, "bare")
        device = hung(
            stack, device, loaded, url, ask, mass_kg=request.mass_kg, arm=arm, gravity=request.gravity
        )
        pulled, second = _slide(device, loaded, request, zero, "loaded")
        name = device.dictionary.device
    # Sliding slowly, the motor gives weight plus friction on the way up and weight less friction on the way down: the
    # mean is the weight. Friction that depends on the direction, or a bent cable, also acts in the strokes without the
    # mass, and cancels in the difference.
    difference = pulled.bias.value - bare.bias.value
    measured = Interval(abs(difference), math.hypot(pulled.bias.ci95, bare.bias.ci95))
    if measured.low <= 0.0:
        effort = unit_of("effort", experiment.rig.motion)
        raise IdentificationError(
            f"the weight of {weight:.3g} {effort} was measured as {measured.text(effort)}, so it "
            "cannot be distinguished from friction",
            remedy="hang a larger mass, or slide more slowly (homing.speed)",
        )
    return Weighing(
        rig=experiment.rig.name,
        motion=experiment.rig.motion,
        device=name,
        mass_kg=request.mass_kg,
        arm_m=arm,
        weight=weight,
        measured=measured,
        bare=bare,
        loaded=pulled,
        described=experiment.rig.amplifier.effort_per_ampere,
        recordings=(first, second),
    )


def refuse_load(experiment: Experiment, weight: float) -> None:
    """Raise `PlanError` if a weight (N·m or N) exceeds the nominal effort, or the effort a device allows at rest."""
    limits, effort = experiment.rig.limits, unit_of("effort", experiment.rig.motion)
    needed = weight + coulomb_of(experiment)
    for bound, meaning, remedy in (
        (
            limits.nominal_effort,
            "the effort that the motor can hold continuously (rig.limits.nominal_effort)",
            "hang a smaller mass, or use a shorter arm",
        ),
        (
            STILL_SHARE * limits.effort,
            "the effort that a device allows while the handle rests (a fifth of rig.limits.effort)",
            "hang a smaller mass, or raise rig.limits.effort while no hand holds the handle",
        ),
    ):
        if needed > bound:
            raise PlanError(
                f"the mass weighs {weight:.3g} {effort}, with the described friction {needed:.3g}: more than "
                f"{bound:.3g} {effort}, {meaning}",
                remedy=remedy,
            )


def hung(
    stack: ExitStack,
    device: FramedDevice,
    loaded: Experiment,
    url: str,
    ask: Ask,
    *,
    mass_kg: float,
    arm: float,
    gravity: float = STANDARD_GRAVITY,
) -> FramedDevice:
    """Let a person hang a mass on the rig, and return the device; in simulation open a new device with the mass.

    `stack` closes the new device. `loaded` is the experiment with the mass, `ask` shows the instruction; `mass_kg` is
    in kg, `arm` in m, `gravity` in m/s².
    """
    if url.startswith("sim:"):
        # The end mass has the right inertia (square of the arm): scale gravity, because weight grows with the arm.
        pull = -gravity * loaded.rig.mechanics.handle_radius / arm
        mechanics = replace(loaded.rig.mechanics, gravity=pull)
        model = replace(config.rig_model(still(loaded)), mechanics=mechanics)
        return stack.enter_context(devices.open_device(url, model))
    ask(
        f"hang {mass_kg:g} kg on it at {arm:g} m, and hold it near the middle of the travel; let go "
        "when the motor holds it, and hold it again at the end, before the motor releases it"
    )
    return device


def with_mass(experiment: Experiment, mass_kg: float, arm: float) -> Experiment:
    """Return the experiment with a mass (kg) at a lever arm (m) as its end mass, for which servos are then computed."""
    at_the_handle = mass_kg * (arm / experiment.rig.mechanics.handle_radius) ** 2
    return config.override(experiment, {"rig.mechanics.end_mass": at_the_handle}, "weighing")


def _slide(
    device: FramedDevice, experiment: Experiment, request: WeighRequest, zero: int, name: str
) -> tuple[Sliding, Path]:
    experiment = config.override(experiment, at_own_rate(experiment, device), "weighing")
    most_hz, bytes_per_second = device.dictionary.position_rate_maximum, device.link.bytes_per_second
    refuse(link_checks(still(experiment), most_hz, bytes_per_second))
    position_now(device, experiment, zero)
    motion = weighing_motion(experiment)
    rows, recording = run_motion(
        device,
        motion,
        free_name(Path(request.output), f"{experiment.rig.name}-weigh-{name}"),
        verified=request.verified,
        reference_count=zero,
        extra={"weighing": name, "mass_kg": request.mass_kg if name == "loaded" else 0.0},
    )
    fit = fit_sliding(
        np.arange(len(rows)) / motion.experiment.controller.position_rate,
        rows["effort_sent"],
        rows["position"],
        weighing_strokes(experiment)[1],
        resolution=experiment.rig.encoder.resolution,
        back_emf=experiment.rig.amplifier.back_emf,
    )
    return fit, recording
