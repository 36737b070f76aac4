"""One run that says what this machine and a link can do: `rig doctor` as a function."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from firmware_protocol.messages import MAJOR, MINOR
from rig import config, devices
from rig.bench.doctor.finding import Finding, Outcome
from rig.bench.doctor.gate import Gate, Reason, gate
from rig.bench.doctor.in_effect import in_effect
from rig.bench.doctor.machine import machine_checks
from rig.bench.doctor.ports import Port, look_at_port, ports_here
from rig.bench.doctor.round_trip import LinkMeasurement, measure_link
from rig.bench.doctor.walls import Supported, supported_walls
from rig.config import Experiment
from rig.core.errors import RealtimeError, RigError
from rig.devices.framed import FramedDevice
from rig.devices.local import opened
from rig.realtime.scheduling import obtained

SECONDS = 4.0  # of measuring: bounds p99.9 from some 750 questions a second on

Told = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceFacts:
    """Who answers at a URL."""

    url: str
    device: str
    firmware: str
    protocol: str
    our_protocol: str
    simulated: bool
    state: str
    fault: str | None
    position_rate_default: int
    position_rate_maximum: int
    messages: tuple[str, ...]  # what the link did not obtain when it was opened

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {name: getattr(self, name) for name in self.__slots__} | {"messages": list(self.messages)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """What was found.

    Attributes
    ----------
    findings
        Of the machine, its ports, and the scheduling that was asked for.
    ports
        That are here.
    device, measurement, walls, gate
        Of the device that was asked about; None or empty without one, or as far as it got.
    experiment
        As it would run there.
    error
        Why the device could not be examined to the end.
    """

    findings: tuple[Finding, ...]
    ports: tuple[Port, ...]
    device: DeviceFacts | None = None
    experiment: Experiment | None = None
    measurement: LinkMeasurement | None = None
    walls: tuple[Supported, ...] = ()
    gate: Gate | None = None
    error: RigError | None = None

    @property
    def armable(self) -> bool:
        """Whether nothing was found that forbids the experiment's wall; a simulated device forbids nothing."""
        return self.gate is None or self.gate.armable or self.gate.simulated

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""

        def of(part: DeviceFacts | LinkMeasurement | Gate | None) -> dict[str, Any] | None:
            return None if part is None else part.as_mapping()

        return {
            "findings": [finding.as_mapping() for finding in self.findings],
            "ports": [port.as_mapping() for port in self.ports],
            "device": of(self.device),
            "link": of(self.measurement),
            "walls": [row.as_mapping() for row in self.walls],
            "gate": of(self.gate),
            "armable": None if self.gate is None else self.armable,  # None: nothing was measured
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What to examine.

    Attributes
    ----------
    experiment
        Validated experiment, before `changes`: its wall is the one to arm, its rig and estimator make the table.
    changes
        Keys that the user set by hand.
    url
        Of the device; None looks at machine and ports only.
    realtime
        Without a URL, or with one of a simulation: measure against a simulated device that is a process of its own.
    seconds
        How long to measure.
    machine
        Whether to look at machine and ports, too.
    """

    experiment: Experiment
    changes: Mapping[str, Any] = field(default_factory=dict)
    url: str | None = None
    realtime: bool = False
    seconds: float = SECONDS
    machine: bool = True


def examine(question: Question, told: Told = lambda what, share: None) -> Examination:
    """Look at the machine and its ports, and, with a device, measure its link and say which walls that supports.

    Parameters
    ----------
    question
        What to look at.
    told
        Called with what is being done and the share of it that is done, 0 … 1.

    Raises
    ------
    ConfigError
        Changes that cannot be; the rest, a device that is not there included, stands in the result.
    """
    host = config.override(question.experiment, question.changes).host
    findings: list[Finding] = []
    ports: list[Port] = []
    if question.machine:
        told("looking at the machine", 0.0)
        findings += machine_checks(host)
        ports, found = ports_here()
        findings += found
    seen = Examination(findings=tuple(findings), ports=tuple(ports))
    if question.url is None and not question.realtime:
        return seen
    try:
        with _opened(question) as device:
            return _with_device(question, device, seen, told)
    except RigError as error:
        return replace(seen, error=error)


@contextmanager
def _opened(question: Question) -> Iterator[FramedDevice]:
    """Open the device; a simulated one in real time becomes a process of its own."""
    loop = question.changes.get("controller.loop", question.experiment.controller.loop)
    url = devices.url_for(question.url or "sim://", loop)
    simulated = url.startswith("sim:")
    changed = config.with_realtime if simulated and question.realtime else config.override
    experiment = changed(question.experiment, question.changes)
    model = config.rig_model(experiment) if simulated else None
    seed, realtime = experiment.trial.seed, experiment.host.realtime
    with opened(url, model, in_real_time=question.realtime, seed=seed, realtime=realtime) as device:
        yield device


def _with_device(question: Question, device: FramedDevice, seen: Examination, told: Told) -> Examination:
    told("asking who is there", 0.0)
    facts = _facts(device)
    seen = replace(seen, device=facts)
    findings = list(seen.findings)
    if device.link.url.scheme == "serial" and all(port.url != facts.url for port in seen.ports):
        findings += look_at_port(device.link.url.place)[1]
    experiment = in_effect(question.experiment, device, question.changes)
    refused: Reason | None = None

    def shown(share: float) -> None:
        told("measuring the link", share)

    try:
        measurement = _measured(device, experiment, question.seconds, shown)
    except RealtimeError as error:
        findings.append(_refused_scheduling(error))
        refused = Reason(error.message, error.remedy)
        plain = replace(experiment, host=replace(experiment.host, realtime="off"))
        try:
            measurement = _measured(device, plain, question.seconds, shown)
        except RigError as lost:
            return replace(seen, findings=tuple(findings), experiment=experiment, error=lost)
    except RigError as lost:
        return replace(seen, findings=tuple(findings), experiment=experiment, error=lost)
    rows = supported_walls(
        experiment,
        measurement,
        device.dictionary.position_rate_maximum,
        lambda share: told("computing walls", share),
    )
    passed = gate(experiment, measurement)
    if refused is not None:
        passed = replace(passed, armable=False, reasons=(*passed.reasons, refused))
    return replace(
        seen,
        findings=tuple(findings),
        experiment=experiment,
        measurement=measurement,
        walls=tuple(rows),
        gate=passed,
    )


def _measured(
    device: FramedDevice, experiment: Experiment, seconds: float, progress: Callable[[float], None]
) -> LinkMeasurement:
    virtual = device.link.clock.virtual
    rate = (
        experiment.controller.position_rate if virtual else None
    )  # virtual time passes between questions only
    with obtained(experiment.host, virtual=virtual) as realtime:
        return measure_link(device, seconds, rate, realtime=realtime, progress=progress)


def _facts(device: FramedDevice) -> DeviceFacts:
    dictionary = device.dictionary
    fault = device.fault_report() if device.connection.state.name == "FAULT" else None
    return DeviceFacts(
        url=device.link.url.text,
        device=dictionary.device,
        firmware=dictionary.firmware,
        protocol=f"{dictionary.major}.{dictionary.minor}",
        our_protocol=f"{MAJOR}.{MINOR}",
        simulated=dictionary.simulated,
        state=device.connection.state.name,
        fault=None if fault is None else f"{fault.text}; {fault.remedy}",
        position_rate_default=dictionary.position_rate_default,
        position_rate_maximum=dictionary.position_rate_maximum,
        messages=tuple(device.link.messages),
    )


def _refused_scheduling(error: RealtimeError) -> Finding:
    return Finding(
        name="real-time scheduling",
        outcome=Outcome.PROBLEM,
        text=error.message,
        why='host.realtime = "enforce" demands it: no run begins without',
        command=error.remedy,
    )
