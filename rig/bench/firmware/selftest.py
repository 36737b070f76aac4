"""A device tests itself and its link; nothing moves.

Everything goes over the link that a loop would use. Each check has a name, an outcome and a remedy; one that fails
does not keep the others from running. Only without an answer to the first question there is nobody to ask.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Input, Status
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME
from rig import config
from rig.bench.firmware.check import Check
from rig.bench.firmware.info import compatibility
from rig.bench.firmware.stream import judge_stream
from rig.config import Experiment
from rig.config.controller import prepared
from rig.core.board import describe
from rig.core.errors import DeviceRefusedError, RigError
from rig.core.model import RigModel
from rig.core.sample import unit_of
from rig.devices.framed import FramedDevice

EXCHANGES, EXCHANGES_S = 20, 1.0
VIRTUAL_S = 0.1  # where time costs computing
DRIFT_LIMIT_PPM = 300.0  # two crystals differ by less than 200; an RC oscillator by thousands
RATE_LIMIT_PPM = 300.0
JITTER_LIMIT = 0.05  # of a period: the time between two samples is what a velocity is divided by
INPUTS_S, INPUTS_LOOKS = 0.05, 20
MOVE_COUNTS = 20  # a hand moves farther; one channel alone, or noise, does not
MOVE_LOOK_S, REST_S = 0.1, 0.5
MOVE_LOOKS = 2_000  # STATE frames of an unarmed device: twenty seconds
_SESSION = 0xFF  # asked for by an ARM that must be refused

Told = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfTestRequest:
    """What to test.

    Attributes
    ----------
    experiment
        The rig to which the image should belong, and the law for `stream`; None: do not compare.
    rate
        Tick rate to count at (Hz); None: the device's maximum.
    seconds
        How long ticks are counted.
    move
        Whether a person will move the handle by hand.
    stream
        Whether to arm, with a current limit of zero, and check the samples of the law on the device.
    """

    experiment: Experiment | None = None
    rate: int | None = None
    seconds: float = 1.0
    move: bool = False
    stream: bool = False

    @property
    def model(self) -> RigModel | None:
        """The rig to compare with."""
        return None if self.experiment is None else config.rig_model(self.experiment)


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfTest:
    """What a device answered."""

    url: str
    device: str
    firmware: str
    simulated: bool
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return all(check.outcome != "failed" for check in self.checks)

    def as_mapping(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**asdict(self), "passed": self.passed}


def failure(found: SelfTest) -> DeviceRefusedError | None:
    """Return the error of a test that found one."""
    failed = [check for check in found.checks if check.outcome == "failed"]
    if not failed:
        return None
    return DeviceRefusedError(
        f"the device at {found.url} fails its self test: {', '.join(check.name for check in failed)}",
        remedy=failed[0].remedy or "keep motor power off",
    )


def selftest(
    device: FramedDevice, request: SelfTestRequest, told: Told = lambda _what, _share: None
) -> SelfTest:
    """Test a device that is connected.

    Parameters
    ----------
    device
        Open; it is left as it was found, but for a fault that was latched, which is told and cleared.
    request
        What to test.
    told
        Called with what is being done and the share of it that is done.

    Raises
    ------
    LinkLostError, IncompatibleDeviceError
        There is nobody to test.
    """
    dictionary = device.dictionary
    steps: list[tuple[str, Callable[[FramedDevice, SelfTestRequest], Check]]] = [
        ("protocol", _protocol),
        ("rig", _rig),
        ("fault memory", _fault_memory),
        ("parameters", _parameters),
        ("refusals", _refusals),
        ("clock", _clock),
        ("ticks", _ticks),
        ("inputs", _inputs),
        ("encoder", _encoder),
        ("stream", _stream),
        ("link", _link),
    ]
    checks = []
    for number, (name, step) in enumerate(steps):
        told(name, number / len(steps))
        checks.append(_checked(name, step, device, request))
    return SelfTest(
        url=device.link.url.text,
        device=dictionary.device,
        firmware=dictionary.firmware,
        simulated=dictionary.simulated,
        checks=tuple(checks),
    )


def _checked(
    name: str,
    step: Callable[[FramedDevice, SelfTestRequest], Check],
    device: FramedDevice,
    request: SelfTestRequest,
) -> Check:
    try:
        return step(device, request)
    except RigError as error:
        return Check(name, "failed", error.message, error.remedy)


# ------------------------------------------------------------------ who it is


def _protocol(device: FramedDevice, _request: SelfTestRequest) -> Check:
    dictionary = device.dictionary
    problems, notes = compatibility(dictionary)
    text = f"{dictionary.major}.{dictionary.minor}, dictionary {device.dictionary_hash:016x}"
    if problems:
        return Check(
            "protocol", "failed", f"{text}: {'; '.join(problems)}", "build and flash this package's firmware"
        )
    return Check("protocol", "ok", "; ".join([text, *notes]))


def _rig(device: FramedDevice, request: SelfTestRequest) -> Check:
    dictionary = device.dictionary
    model = request.model
    if model is None:
        return Check("rig", "skipped", f"it says {dictionary.device}; --rig compares it with yours")
    ours = describe(
        model,
        firmware=dictionary.firmware,
        simulated=dictionary.simulated,
        rate_default=dictionary.position_rate_default,
        rate_maximum=dictionary.position_rate_maximum,
    )
    differ = [
        f"{name} is {theirs:g} there and {wanted:g} here"
        for name, theirs, wanted in (
            ("current quantum (A)", dictionary.current_quantum_a, ours.current_quantum_a),
            *(
                (name, _most(dictionary, name), _most(ours, name))
                for name in ("motion", "encoder_sign", "current_limit")
            ),
        )
        if theirs != wanted
    ]
    if differ:
        remedy = f"build the image for this rig: rig firmware build --rig {model.name}, and flash it"
        return Check("rig", "failed", f"the image is for {dictionary.device}: {', '.join(differ)}", remedy)
    return Check("rig", "ok", f"{dictionary.device}, of the same scales and limits as {model.name}")


def _most(dictionary: Any, name: str) -> float:
    info = dictionary.parameter(name)
    return float("nan") if info is None else float(info.maximum)


# ------------------------------------------------------------------ what it remembers


def _fault_memory(device: FramedDevice, _request: SelfTestRequest) -> Check:
    device.identify()  # brings its state
    report = device.fault_report()
    if not _is_faulty(device):
        return Check("fault memory", "ok", f"nothing is latched, {len(report.entries)} ticks are remembered")
    device.disarm(clear_fault=True)
    if _is_faulty(device):
        return Check("fault memory", "failed", f"{report.text} stays latched", report.remedy)
    return Check(
        "fault memory", "ok", f"an earlier run had left {report.name} latched: {report.text}; cleared"
    )


def _is_faulty(device: FramedDevice) -> bool:
    return device.connection.state == State.FAULT


def _parameters(device: FramedDevice, _request: SelfTestRequest) -> Check:
    before = device.active_parameters()
    kept: dict[str, Value] = {"verified": before["verified"], "ramp_us": before["ramp_us"]}
    other = 5_000 if before["ramp_us"] != 5_000 else 6_000
    changed = device.configure({**kept, "ramp_us": other})
    back = device.configure(kept)
    if changed.values != {**before, "ramp_us": other} or back.values != before:
        return Check(
            "parameters", "failed", "what is read back is not what was set", "flash the device again"
        )
    return Check(
        "parameters",
        "ok",
        f"{len(before)} active; a change and its undoing were read back",
    )


def _refusals(device: FramedDevice, _request: SelfTestRequest) -> Check:
    before = device.active_parameters()
    wrong = m.Arm(0, device.dictionary_hash ^ 1, 0)
    taken = []
    if device.status_of(wrong, session=_SESSION) == Status.OK:
        device.stop()
        device.disarm()
        taken.append("an ARM with another dictionary's hash")
    info = device.dictionary.parameter("current_limit")
    if info is not None and info.maximum < BY_NAME["current_limit"].maximum:
        try:
            device.configure({"current_limit": int(info.maximum) + 1, "verified": before["verified"]})
            taken.append("a current above the amplifier's")
        except DeviceRefusedError as error:
            if error.status != Status.OUT_OF_RANGE:
                raise
    if taken:
        return Check(
            "refusals",
            "failed",
            f"it takes {' and '.join(taken)}",
            "keep motor power off; flash it again",
        )
    if device.active_parameters() != before:
        return Check(
            "refusals", "failed", "a block that was refused has changed something", "flash the device again"
        )
    return Check("refusals", "ok", "a wrong ARM and a current out of range are refused, and change nothing")


# ------------------------------------------------------------------ its time


def _clock(device: FramedDevice, _request: SelfTestRequest) -> Check:
    virtual = device.link.clock.virtual
    fit = device.clock(EXCHANGES, over_s=VIRTUAL_S if virtual else EXCHANGES_S)
    drift = f"drift {fit.drift_ppm:.1f} ± {fit.drift_sd_ppm:.1f} ppm"
    text = f"{drift}, round trip {fit.round_trip_ns / 1e3:.0f} µs at least"
    if abs(fit.drift_ppm) - 3.0 * fit.drift_sd_ppm > DRIFT_LIMIT_PPM:
        return Check("clock", "failed", text, "check the board's crystal: the device's time is not real time")
    return Check("clock", "ok", text)


def _ticks(device: FramedDevice, request: SelfTestRequest) -> Check:
    rate = request.rate or device.dictionary.position_rate_maximum
    with _at_rate(device, rate):
        states = device.states(request.seconds)
    if len(states) < 3:
        return Check(
            "ticks", "failed", f"{len(states)} samples came in {request.seconds:g} s", "update its firmware"
        )
    unit_s = device.dictionary.time_unit_ns * 1e-9
    indices = [(state.sample_index - states[0].sample_index) % 2**32 for state in states]
    times = [(state.device_time - states[0].device_time) % 2**32 * unit_s for state in states]
    counted = indices[-1] / times[-1] if times[-1] else 0.0
    jitter_s = (
        max(abs(time - index / counted) for time, index in zip(times, indices, strict=True))
        if counted
        else 0.0
    )
    missed = states[-1].missed_ticks - states[0].missed_ticks
    load = states[-1].execution_time * unit_s * rate
    text = (
        f"{counted:.2f} Hz of {rate} by its own clock, samples within {1e9 * jitter_s:.0f} ns of the grid, "
        f"{missed} missed, the longest tick took {100 * load:.2g} % of a period"
    )
    if abs(counted / rate - 1.0) > RATE_LIMIT_PPM * 1e-6 or missed or jitter_s * rate > JITTER_LIMIT:
        return Check(
            "ticks", "failed", text, f"run it slower: rig firmware selftest … --rate {max(50, rate // 2)}"
        )
    return Check("ticks", "ok", text)


@contextmanager
def _at_rate(device: FramedDevice, rate: int) -> Iterator[None]:
    """Tick at another rate for a while."""
    before = device.active_parameters()
    kept: dict[str, Value] = {"verified": before["verified"]}
    device.configure({**kept, "position_rate": rate})
    try:
        yield
    finally:
        device.configure({**kept, "position_rate": before["position_rate"]})


# ------------------------------------------------------------------ its senses, and its line


def _inputs(device: FramedDevice, _request: SelfTestRequest) -> Check:
    looks = (device.states(INPUTS_S) for _ in range(INPUTS_LOOKS))
    states = next((found for found in looks if found), [])
    if not states:
        return Check("inputs", "failed", "no STATE came", "update its firmware")
    inputs = states[-1].inputs
    stop = "pressed" if inputs & Input.EMERGENCY_STOP else "not pressed"
    held = "held" if inputs & Input.HOLD_TO_RUN else "released"
    return Check("inputs", "ok", f"emergency stop {stop}, hold-to-run switch {held}")


def _encoder(device: FramedDevice, request: SelfTestRequest) -> Check:
    first = device.count()
    if not request.move:
        return Check("encoder", "skipped", f"it reads {first}; --move looks for the counts of a hand")
    counts = [first]
    while max(counts) - min(counts) < MOVE_COUNTS and len(counts) < MOVE_LOOKS:
        counts += [state.count for state in device.states(MOVE_LOOK_S)] or [counts[-1]]
    counts += _until_rest(device, counts[-1])
    least, most = min(counts), max(counts)
    if _is_faulty(device):
        report = device.fault_report()
        return Check("encoder", "failed", report.text, report.remedy)
    if most == least:
        remedy = "move the handle when asked; else check the encoder's supply and both of its wires"
        return Check("encoder", "failed", f"it read {first} all the time", remedy)
    if most - least == 1:
        return Check(
            "encoder", "failed", "one count toggles", "one channel is missing: check both encoder wires"
        )
    return Check("encoder", "ok", _way(first, counts[-1], most - least, request.model))


def _until_rest(device: FramedDevice, last: int) -> list[int]:
    """Counts until the hand has stopped."""
    counts = [last]
    while len(counts) < MOVE_LOOKS:
        new = [state.count for state in device.states(REST_S)] or [counts[-1]]
        counts += new
        if max(new) - min(new) <= 1:
            break
    return counts


def _way(first: int, last: int, span: int, model: RigModel | None) -> str:
    """Say how far the handle went, and which way, as far as the rig is known."""
    text = f"from {first} to {last}, through {span} counts"
    if model is None or first == last:
        return text
    way = (last - first) * model.encoder.sign * model.encoder.resolution
    direction = "rose" if way > 0.0 else "fell"
    return f"{text}: the position {direction} by {abs(way):.4g} {unit_of('position', model.motion)}"


# ------------------------------------------------------------------ the law on the device


def _stream(device: FramedDevice, request: SelfTestRequest) -> Check:
    law = device.dictionary.parameter("law")
    if law is None or law.maximum == 0:
        return Check("stream", "skipped", "it has no law of its own")
    if not request.stream or request.experiment is None:
        return Check("stream", "skipped", "--stream with --rig runs its law with a current limit of zero")
    experiment = config.override(request.experiment, {"controller.loop": "device"})
    before = device.active_parameters()
    wanted = prepared(
        experiment,
        current_quantum_a=device.dictionary.current_quantum_a,
        reference_count=device.count(),
        verified=True,
    ).parameters
    device.configure({**wanted, "current_limit": 0, "hold_to_run": 0})
    try:
        device.arm()
        said = device.supervise(request.seconds, int(wanted["supervise_lifetime_us"]))
        device.stop()
        device.disarm(clear_fault=True)
    finally:
        device.configure(before)
    rate = experiment.controller.position_rate
    return judge_stream(said, rate * request.seconds, rate, device.dictionary)


def _link(device: FramedDevice, _request: SelfTestRequest) -> Check:
    said, ours = device.statistics(), device.connection.statistics
    bad = {
        "frames that the device could not read": said.framing_errors + said.crc_errors,
        "frames that this computer could not read": ours.framing_errors + ours.crc_errors,
        "frames that the device found malformed": said.malformed,
    }
    wrong = [f"{count} {what}" for what, count in bad.items() if count]
    text = f"{said.frames} frames there, {ours.frames} back"
    if wrong:
        remedy = "check cable, ground and baud rate; noise that came before the link was opened counts, too: try again"
        return Check("link", "failed", f"{text}; {', '.join(wrong)}", remedy)
    return Check("link", "ok", f"{text}, none damaged")
