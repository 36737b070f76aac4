"""Test a device and its link without moving the handle: the checks of `rig firmware selftest`.

The tests use the same link as the control loop. It must not arm a device, except for the test `stream`, with a current
limit of zero.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Ge, Le

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Input, Status
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME
from rig import config
from rig.config import Experiment
from rig.config.controller import prepare_controller
from rig.core import check
from rig.core.answers import ok, refused, skipped
from rig.core.check import Check, Outcome
from rig.core.errors import DeviceRefusedError, RigError
from rig.core.keyword import Keyword
from rig.core.model import RigModel
from rig.core.present import Item, reported
from rig.core.same_rig import check_rig
from rig.core.sample import unit_of
from rig.devices.framed import FramedDevice
from rig.firmware._info import FLASH, compatibility
from rig.firmware._stream import judge_stream

DRIFT_LIMIT_PPM = 300.0  # two crystals differ by less than 200; an RC oscillator by thousands
RATE_LIMIT_PPM = 300.0
JITTER_LIMIT = 0.05  # share of a period: velocities are divided by the time between two samples
INPUTS_S, INPUTS_LOOKS = 0.05, 20  # duration of one read of STATE frames, and most reads
MOVE_COUNTS = 20  # less than a hand moves, more than noise or a single encoder channel shows
MOVE_LOOK_S, REST_S = 0.1, 0.5  # duration of one read while the handle moves, and until it rests
MOVE_LOOKS = 2_000  # STATE frames of an unarmed device: twenty seconds
LEAST_SAMPLES = 3  # for a rate and its jitter
_SESSION = 0xFF  # in the header of an ARM that must be refused

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfTestRequest:
    """Parameters of a self test.

    Attributes
    ----------
    experiment
        Experiment with the rig for which the image should be built, and with the law to run for `stream`; None to skip
        the tests that need them.
    rate
        Tick rate at which ticks are counted (Hz); None for the device's maximum.
    """

    experiment: Experiment | None = None
    rate: int | None = None
    seconds: Annotated[float, Ge(0.05), Le(600.0), Keyword("Time (s) for which ticks are counted.")] = 1.0
    move: Annotated[bool, Keyword("Test the encoder: move the handle by hand when asked.")] = False
    stream: Annotated[
        bool,
        Keyword("Check the samples of the law on the device: it is armed, with a current limit of zero."),
    ] = False

    @property
    def model(self) -> RigModel | None:
        """Return the rig to compare the device with, or None if no experiment was given."""
        return None if self.experiment is None else config.rig_model(self.experiment)


Step = Callable[[FramedDevice, SelfTestRequest], Check]


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfTest:
    """Result of a self test: URL, name and firmware of the device, and the checks."""

    url: str
    device: str
    firmware: str
    simulated: bool
    checks: tuple[Check, ...]

    @reported
    def passed(self) -> bool:
        """Return True if no check of the self test failed."""
        return not check.refused(self.checks)

    def items(self) -> list[Item]:
        """Return a line with name and firmware of the device, then its checks, for printing."""
        return [f"{self.device}, firmware {self.firmware}", *self.checks]


def failure(found: SelfTest) -> DeviceRefusedError | None:
    """Return the error that names all failed checks of a self test, or None if no check failed."""
    failed = check.refused(found.checks)
    if not failed:
        return None
    return DeviceRefusedError(
        f"the device at {found.url} fails its self test: {', '.join(one.name for one in failed)}",
        remedy=failed[0].remedy or "keep motor power off",
    )


def selftest(
    device: FramedDevice, request: SelfTestRequest, on_progress: Progress = lambda _what, _share: None
) -> SelfTest:
    """Run all checks of the self test on a connected device, and return their results.

    Raise `LinkLostError` if the device does not reply, and `IncompatibleDeviceError` if it has another version of the
    protocol.

    Parameters
    ----------
    device
        Open device. Its parameters are restored at the end; a latched fault is reported and cleared.
    request
        Parameters of the test.
    on_progress
        Called with the name of the current check and the completed share of the test, 0 … 1.
    """
    dictionary = device.dictionary
    steps: dict[str, Step] = {
        "protocol": _protocol,
        "rig": _rig,
        "fault memory": _fault_memory,
        "parameters": _parameters,
        "refusals": _refusals,
        "clock": _clock,
        "ticks": _ticks,
        "inputs": _inputs,
        "encoder": _encoder,
        "stream": _stream,
        "link": _link,
    }
    checks = []
    for number, (name, step) in enumerate(steps.items()):
        on_progress(name, number / len(steps))
        # All checks run, even if one fails, so that one run shows everything that is wrong.
        try:
            answer = step(device, request)
        except RigError as error:
            answer = refused(error.message, error.remedy)
        checks.append(replace(answer, name=name))
    return SelfTest(
        url=device.link.url.text,
        device=dictionary.device,
        firmware=dictionary.firmware,
        simulated=dictionary.simulated,
        checks=tuple(checks),
    )


# ------------------------------------------------------------------ identity


def _protocol(device: FramedDevice, _request: SelfTestRequest) -> Check:
    dictionary = device.dictionary
    differences = tuple(compatibility(dictionary))
    text = f"{dictionary.major}.{dictionary.minor}, dictionary {device.dictionary_hash:016x}"
    text = "; ".join([text, *(one.text for one in differences)])
    return refused(text, FLASH) if check.refused(differences) else ok(text)


def _rig(device: FramedDevice, request: SelfTestRequest) -> Check:
    dictionary = device.dictionary
    model = request.model
    if model is None:
        return skipped(f"the device's name is {dictionary.device}; give `rig` to compare it with your rig")
    found = check_rig(model, dictionary)
    if found.outcome is Outcome.REFUSED:
        return refused(
            found.text, f"build the image for this rig: rig firmware build --rig {model.name}, and flash it"
        )
    return found


# ------------------------------------------------------------------ fault memory and parameters


def _fault_memory(device: FramedDevice, _request: SelfTestRequest) -> Check:
    device.identify()  # the reply contains the state
    report = device.fault_report()
    stopped_at = device.statistics().stopped_at
    place = f", at {stopped_at:#010x}" if stopped_at else ""
    if not _is_faulty(device):
        return ok(f"no fault is latched; {len(report.entries)} ticks are logged")
    device.disarm(clear_fault=True)
    if _is_faulty(device):
        return refused(f"the fault remains latched: {report.text}", report.remedy)
    return ok(f"{report.name} was latched by an earlier run ({report.text}{place}) and is now cleared")


def _is_faulty(device: FramedDevice) -> bool:
    return device.connection.state == State.FAULT


def _parameters(device: FramedDevice, _request: SelfTestRequest) -> Check:
    before = device.active_parameters()
    kept: dict[str, Value] = {"verified": before["verified"], "ramp_us": before["ramp_us"]}
    other = 5_000 if before["ramp_us"] != 5_000 else 6_000
    changed = device.configure({**kept, "ramp_us": other})
    back = device.configure(kept)
    if changed.values != {**before, "ramp_us": other} or back.values != before:
        return refused("parameters read back differ from those set", "flash the device again")
    return ok(f"{len(before)} parameters are active; a change was read back and undone")


def _refusals(device: FramedDevice, _request: SelfTestRequest) -> Check:
    before = device.active_parameters()
    device.configure({"verified": before["verified"]})  # an unconfigured device rejects every ARM
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
        return refused(
            f"the device accepts {' and '.join(taken)}", "keep motor power off; flash the device again"
        )
    if device.active_parameters() != before:
        return refused("a refused parameter block has changed parameters", "flash the device again")
    return ok("a wrong ARM and a current out of range are refused without effect")


# ------------------------------------------------------------------ clock and ticks


def _clock(device: FramedDevice, _request: SelfTestRequest) -> Check:
    fit = device.drift()
    drift = f"drift {fit.drift_ppm:.1f} ± {fit.drift_sd_ppm:.1f} ppm"
    text = f"{drift}, round trip {fit.round_trip_ns / 1e3:.0f} µs at least"
    if abs(fit.drift_ppm) - 3.0 * fit.drift_sd_ppm > DRIFT_LIMIT_PPM:
        return refused(text, "check the board's crystal: the device's clock has the wrong frequency")
    return ok(text)


def _ticks(device: FramedDevice, request: SelfTestRequest) -> Check:
    rate = request.rate or device.dictionary.position_rate_maximum
    with _at_rate(device, rate):
        states = device.states(request.seconds)
    if len(states) < LEAST_SAMPLES:
        return refused(
            f"only {len(states)} samples arrived in {request.seconds:g} s; at least {LEAST_SAMPLES} are needed",
            "flash current firmware: rig firmware build, then rig firmware flash",
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
        f"{counted:.2f} Hz instead of {rate} by its own clock, samples within {1e9 * jitter_s:.0f} ns of the grid, "
        f"{missed} missed, the longest tick took {100 * load:.2g} % of a period"
    )
    if abs(counted / rate - 1.0) > RATE_LIMIT_PPM * 1e-6 or missed or jitter_s * rate > JITTER_LIMIT:
        return refused(text, f"use a lower rate: rig firmware selftest … --rate {max(50, rate // 2)}")
    return ok(text)


@contextmanager
def _at_rate(device: FramedDevice, rate: int) -> Iterator[None]:
    """Return a context in which the device has the tick rate `rate` (Hz); its rate is restored at the end."""
    before = device.active_parameters()
    kept: dict[str, Value] = {"verified": before["verified"]}
    device.configure({**kept, "position_rate": rate})
    try:
        yield
    finally:
        device.configure({**kept, "position_rate": before["position_rate"]})


# ------------------------------------------------------------------ inputs and encoder


def _inputs(device: FramedDevice, _request: SelfTestRequest) -> Check:
    looks = (device.states(INPUTS_S) for _ in range(INPUTS_LOOKS))
    states = next((found for found in looks if found), [])
    if not states:
        return refused(
            f"no STATE frame arrived within {INPUTS_LOOKS * INPUTS_S:g} s",
            "flash current firmware: rig firmware build, then rig firmware flash",
        )
    inputs = states[-1].inputs
    stop = "pressed" if inputs & Input.EMERGENCY_STOP else "not pressed"
    held = "held" if inputs & Input.HOLD_TO_RUN else "released"
    end = ", limit switch pressed" if inputs & Input.LIMIT_SWITCH else ""
    return ok(f"emergency stop {stop}, hold-to-run switch {held}{end}")


def _encoder(device: FramedDevice, request: SelfTestRequest) -> Check:
    first = device.count()
    if not request.move:
        return skipped(f"the encoder reads {first}; give `move` to test it by hand")
    counts = [first]
    while max(counts) - min(counts) < MOVE_COUNTS and len(counts) < MOVE_LOOKS:
        counts += [state.count for state in device.states(MOVE_LOOK_S)] or [counts[-1]]
    counts += _counts_until_rest(device, counts[-1])
    least, most = min(counts), max(counts)
    if _is_faulty(device):
        report = device.fault_report()
        return refused(report.text, report.remedy)
    if most == least:
        remedy = "move the handle when asked; if you did, check the encoder's supply and both of its wires"
        return refused(
            f"the encoder's count stayed at {first}; it must change by {MOVE_COUNTS} or more", remedy
        )
    if most - least == 1:
        return refused("the count only toggles by one", "check both encoder wires: one channel is missing")
    return ok(_describe_motion(first, counts[-1], most - least, request.model))


def _counts_until_rest(device: FramedDevice, last: int) -> list[int]:
    """Read STATE frames until the handle is at rest; return their encoder counts, after the count `last`."""
    counts = [last]
    while len(counts) < MOVE_LOOKS:
        new = [state.count for state in device.states(REST_S)] or [counts[-1]]
        counts += new
        if max(new) - min(new) <= 1:
            break
    return counts


def _describe_motion(first: int, last: int, span: int, model: RigModel | None) -> str:
    """Return a sentence on the handle's motion, in counts, and in rad or m if the rig is known.

    `first` and `last` are encoder counts, `span` is the largest minus the smallest count.
    """
    text = f"from {first} to {last}, through {span} counts"
    if model is None or first == last:
        return text
    way = (last - first) * model.encoder.sign * model.encoder.resolution
    direction = "rose" if way > 0.0 else "fell"
    return f"{text}: the position {direction} by {abs(way):.4g} {unit_of('position', model.motion)}"


# ------------------------------------------------------------------ law on the device, and link


def _stream(device: FramedDevice, request: SelfTestRequest) -> Check:
    law = device.dictionary.parameter("law")
    if law is None or law.maximum == 0:
        return skipped("the device cannot run the law")
    if not request.stream or request.experiment is None:
        return skipped("give `stream` and `rig` to run the rig's law with a current limit of zero")
    experiment = config.override(request.experiment, {"controller.loop": "device"})
    before = device.active_parameters()
    wanted = prepare_controller(
        experiment,
        current_quantum_a=device.dictionary.current_quantum_a,
        reference_count=device.count(),
        verified=True,
    ).parameters
    device.configure({**wanted, "current_limit": 0, "hold_to_run": 0})
    try:
        device.arm()
        received = device.supervise(request.seconds, int(wanted["supervise_lifetime_us"]))
        device.stop()
        device.disarm(clear_fault=True)
    finally:
        device.configure(before)
    rate = experiment.controller.position_rate
    return judge_stream(received, rate * request.seconds, rate, device.dictionary)


def _link(device: FramedDevice, _request: SelfTestRequest) -> Check:
    theirs, ours = device.statistics(), device.connection.statistics
    bad = {
        "frames that the device could not read": theirs.framing_errors + theirs.crc_errors,
        "frames that this computer could not read": ours.framing_errors + ours.crc_errors,
        "frames that the device found malformed": theirs.malformed,
    }
    wrong = [f"{count} {what}" for what, count in bad.items() if count]
    text = f"{theirs.frames} frames to the device, {ours.frames} to the host"
    if wrong:
        remedy = "check cable, ground and baud rate, then try again (noise received before the start is counted too)"
        return refused(f"{text}; {', '.join(wrong)}", remedy)
    return ok(f"{text}, none damaged")
