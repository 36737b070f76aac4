"""Examine the machine, its ports, and the link to a device, for `rig doctor`.

`rig doctor` and the console's page of devices call this module. It must not move the handle. An error of the device is
stored in the result, not raised.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from annotated_types import Ge, Le

from rig import config, devices
from rig.config import Experiment
from rig.core import answers
from rig.core.answers import question
from rig.core.check import Check, Outcome, refused
from rig.core.errors import RealtimeError, RigError
from rig.core.keyword import Keyword
from rig.core.present import Item, Row, reported
from rig.core.sample import unit_of
from rig.devices.device_facts import DeviceFacts
from rig.devices.framed import FramedDevice
from rig.devices.local import host_beside, open_for_run
from rig.doctor.gate import gate
from rig.doctor.gate_result import Gate
from rig.doctor.interface import (
    NO_PORTS,
    LinkMeasurement,
    Port,
    Supported,
    machine_checks,
    measure_link,
    ports_here,
    serial_port,
    supported_walls,
    wall_items,
)
from rig.experiments.hits.admission import admission_checks
from rig.experiments.hits.hit import in_effect
from rig.experiments.trials.preparation import prepared_on
from rig.realtime.scheduling import obtained

# Duration of the link's measurement (s): enough exchanges for the 99.9th percentile from about 750 per second on.
SECONDS = 4.0

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """Result of an examination of this computer, its ports, and optionally one device.

    Attributes
    ----------
    checks
        Checks of the machine, its ports, and the requested scheduling.
    ports
        Ports found on this computer.
    admission
        Checks that `rig hit` makes for the experiment on this device before it measures the link.
    device, link, walls, gate
        Facts of the device, measurement of its link, stable walls over this link, and whether the motor may be armed;
        None or empty without a device, or if the examination ended earlier.
    experiment
        Experiment as it would run on the device.
    error
        Error that ended the examination of the device early; None if the examination was complete.
    """

    checks: tuple[Check, ...]
    ports: tuple[Port, ...]
    admission: tuple[Check, ...] = ()
    device: DeviceFacts | None = None
    experiment: Experiment | None = field(default=None, repr=False)
    link: LinkMeasurement | None = None
    walls: tuple[Supported, ...] = ()
    gate: Gate | None = None
    error: RigError | None = field(default=None, repr=False)

    @reported
    def armable(self) -> bool | None:
        """Return whether `rig hit` would arm the motor for the experiment's wall; None if the link was not measured.

        A simulated link never prevents arming.
        """
        if refused(self.admission):
            return False
        return None if self.gate is None else self.gate.armable or self.gate.simulated

    @property
    def remedy(self) -> str:
        """Return what to do before the motor may be armed: remedies of refused checks, joined by semicolons; or ""."""
        remedies = [one.remedy for one in refused(self.admission)]
        return "; ".join(dict.fromkeys(filter(None, [*remedies, self.gate.remedy if self.gate else ""])))

    def items(self) -> list[Item]:
        """Return the lines to print: checks of machine, ports, device and link; supported walls; arming."""
        found: list[Item] = ["machine", *self.checks]
        if self.ports:
            found += ["ports", *(Row(port.url, port.description) for port in self.ports)]
        if self.device is not None:
            found += ["device", *self.device.rows()]
        if self.link is not None:
            found += ["link", *self.link.rows()]
        experiment = self.experiment
        if experiment is not None and self.walls:
            found += wall_items(experiment, self.walls)
        if experiment is not None and self.gate is not None:
            stiffness, damping = (unit_of(name, experiment.rig.motion) for name in ("stiffness", "damping"))
            on_the_device = experiment.controller.loop == "device"
            wall = f"K = {experiment.wall.stiffness:g} {stiffness}, B = {experiment.wall.damping:g} {damping}"
            verdict, *reasons = self.gate.items()
            if refused(self.admission):
                verdict = Check("arming", Outcome.REFUSED, "this wall must not be armed")
            where = f"at {self.gate.rate_hz:g} Hz, the law on the {'device' if on_the_device else 'host'}"
            found += [f"arming {experiment.rig.name} with {wall} {where}", verdict, *self.admission, *reasons]
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class ExaminationRequest:
    """A request to examine this computer and optionally one device.

    Attributes
    ----------
    experiment
        Validated experiment, before `changes`. Its wall is checked for arming; the table of stable walls is computed
        for its rig and estimator.
    changes
        Values by key that the user set by hand.
    """

    experiment: Experiment
    changes: Mapping[str, Any] = field(default_factory=dict)
    url: Annotated[
        str | None,
        Keyword(
            "serial:///dev/ttyACM0, usb://1209:0001, sim://. [machine and ports only]",
            group="Device",
            values="url",
        ),
    ] = None
    realtime: Annotated[
        bool, Keyword("Examine a simulated rig, as a process behind a port.", group="Device")
    ] = False
    seconds: Annotated[float, Ge(0.1), Le(600.0), Keyword("Time of the measurement.")] = SECONDS


def examine(question: ExaminationRequest, on_progress: Progress = lambda what, share: None) -> Examination:
    """Examine the machine and its ports; with a device also measure its link and compute the walls that are stable.

    Parameters
    ----------
    question
        Request of the examination; without a URL and without real time, no device is examined.
    on_progress
        Called with the name of the present step and the finished fraction of the step (0 to 1).

    Raises
    ------
    ConfigError
        A key or value in `question.changes` is invalid. All other errors, as of a missing device, are in the result.
    """
    host = config.override(question.experiment, question.changes).host
    on_progress("examining the machine", 0.0)
    ports, problems = ports_here()
    seen = Examination(checks=(*machine_checks(host), *problems), ports=tuple(ports))
    if question.url is None and not question.realtime:
        return seen
    try:
        with _open_device(question) as device:
            return _with_device(question, device, seen, on_progress)
    except RigError as error:
        return replace(seen, error=error)


@contextmanager
def _open_device(question: ExaminationRequest) -> Iterator[FramedDevice]:
    """Open the device of a request; a simulated device in real time runs as a separate process."""
    loop = question.changes.get("controller.loop", question.experiment.controller.loop)
    url = devices.url_for(question.url or "sim://", loop)
    simulated = url.startswith("sim:")
    bridged = not simulated and devices.is_made_for_a_rig(url)
    changed = config.with_realtime if bridged or (simulated and question.realtime) else config.override
    experiment = changed(question.experiment, question.changes)
    model = config.rig_model(experiment) if simulated or bridged else None
    seed, realtime = experiment.trial.seed, experiment.host.realtime
    with open_for_run(url, model, in_real_time=question.realtime, seed=seed, realtime=realtime) as device:
        yield device


def _with_device(
    asked: ExaminationRequest, device: FramedDevice, seen: Examination, on_progress: Progress
) -> Examination:
    on_progress("identifying the device", 0.0)
    facts, link_url = DeviceFacts.of(device), device.link.url
    experiment = in_effect(asked.experiment, device, asked.changes)
    admission = tuple(admission_checks(prepared_on(device, experiment), device))
    seen = replace(seen, device=facts, experiment=experiment, admission=admission)
    # The device replied, so that a port exists, even if the list of ports was empty.
    if link_url.scheme != "sim":
        seen = replace(seen, checks=tuple(check for check in seen.checks if check.name != NO_PORTS))
    if link_url.scheme == "serial" and all(port.url != facts.url for port in seen.ports):
        port, about = serial_port(link_url.place)
        seen = replace(seen, ports=(*seen.ports, port), checks=(*seen.checks, *about.problems()))
    scheduling: tuple[Check, ...] = ()

    def shown(share: float) -> None:
        on_progress("measuring the link", share)

    try:
        try:
            link = _measure_link(device, experiment, asked.seconds, shown)
        except RealtimeError as error:
            scheduling = (_report_not_scheduled(error),)
            seen = replace(seen, checks=(*seen.checks, *scheduling))
            # The link is measured without the scheduling that was refused: its numbers are worth more than an error.
            plain = replace(experiment, host=replace(experiment.host, realtime="off"))
            link = _measure_link(device, plain, asked.seconds, shown)
    except RigError as lost:
        return replace(seen, error=lost)
    rows = supported_walls(
        experiment,
        link,
        device.dictionary.position_rate_maximum,
        lambda share: on_progress("computing walls", share),
    )
    found = gate(experiment, link)
    return replace(
        seen, link=link, walls=tuple(rows), gate=replace(found, checks=(*found.checks, *scheduling))
    )


def _measure_link(
    device: FramedDevice, experiment: Experiment, seconds: float, progress: Callable[[float], None]
) -> LinkMeasurement:
    virtual = device.link.clock.virtual
    # In virtual time exchanges have no rate of their own: time advances only between them.
    rate = experiment.controller.position_rate if virtual else None
    with obtained(host_beside(experiment.host, device.link), virtual=virtual) as realtime:
        return measure_link(device, seconds, rate, realtime=realtime, progress=progress)


@question("real-time scheduling", 'required by host.realtime = "enforce": without it no run begins')
def _report_not_scheduled(error: RealtimeError) -> Check:
    return answers.refused(error.message, error.remedy)
