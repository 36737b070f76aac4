"""Find the reference: move the handle to the limit switch and back to the encoder's index, which gives position zero.

    found = find_reference(ReferenceRequest(experiment=x, url="usb://…", verified=True))
    found.reference_count

`rig device reference` calls this module. It must not begin a search without the torque pulse, nor run a search without
limits: the speed and effort of homing, a window of the travel plus a margin, and time. Makers of drives call this
"homing by limit switch and index pulse"; here homing is the servo that moves the handle to the start of a trial.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import Input
from firmware_protocol.messages import State
from rig import config, devices
from rig.analysis.identification import IdentificationError
from rig.config import Experiment
from rig.config.controller import resolution
from rig.core.check import refuse
from rig.core.errors import ConfigError, DeviceFaultError, GuardError
from rig.core.keyword import Keyword
from rig.core.present import Row
from rig.core.same_rig import check_rig
from rig.core.sample import Motion, unit_of
from rig.devices.framed import FramedDevice
from rig.experiments.motion._motion_run import FreeRigRequest, refuse_unverified, run_motion
from rig.experiments.motion.pulse import at_own_rate, pulse
from rig.experiments.trials._identify_motions import still, way_motion
from rig.experiments.trials._trial import end_of
from rig.experiments.trials.plan import link_checks
from rig.experiments.trials.preparation import prepared_on
from rig.loop.layout import EndReason
from rig.realtime import stop_requests
from rig.recording.files import free_name, plain_errors

# Distance that a search may exceed the travel (fraction of the travel), and that the handle keeps from the window's
# ends (fraction of the window).
MARGIN = 0.1
LEAVE = 1 / 16  # step by which the handle leaves the switch, as a fraction of the distance of two indices
# If the index is nearer to the switch than this fraction of the distance, a later search may find another index first.
NEAR = 0.1
SAME_COUNTS = 2  # allowed error of the distance of two indices (counts), each latched within a count
BOTH = 2.25  # the second index is measured only if the travel has this many distances of indices
FOLLOWS = 0.05  # allowed error at the end of a motion, as a fraction of the distance of two indices
LOOK_S, HAND_S = 0.02, 120.0
BLOCKED = "remove obstacles from the travel, such as a stop before the switch, or a hand"

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceRequest(FreeRigRequest):
    """A request to find position zero; if a person moves the handle, motor and encoder signs may be unverified."""

    by_hand: Annotated[bool, Keyword("Move the handle by hand; the motor stays off.")] = False


@dataclass(frozen=True, kw_only=True)
class FoundReference:
    """A result of a search for position zero by the encoder's index.

    Attributes
    ----------
    rig, motion, device
        Name of the rig, its kind of motion (which determines the units), and name of the device.
    reference_count
        Encoder count at position zero.
    index_count
        Encoder count at the index.
    position
        Position of the handle (rad or m).
    switch_position
        Position at which the limit switch opens (rad or m); None without a limit switch.
    index_counts
        Measured distance to the next index (counts); None if the travel contains no second index.
    recordings
        Recordings of the motions; empty if a person moved the handle.
    """

    rig: str
    motion: Motion
    device: str
    reference_count: int
    index_count: int
    position: float
    switch_position: float | None
    index_counts: int | None
    recordings: tuple[Path, ...]

    def rows(self) -> list[Row]:
        """Return the results as rows to print: counts of position zero and index, positions, recordings."""
        unit = unit_of("position", self.motion)
        between = (
            "not measured: the travel contains one index" if self.index_counts is None else self.index_counts
        )
        return [
            Row("position zero", self.reference_count, "count"),
            Row("index", self.index_count, "count"),
            Row("distance to the next index", between, "" if self.index_counts is None else "count"),
            *([] if self.switch_position is None else [Row("limit switch", self.switch_position, unit)]),
            Row("handle", self.position, unit),
            *(Row("recording", str(path)) for path in self.recordings),
        ]


def find_reference(request: ReferenceRequest, tell: Tell | None = None) -> FoundReference:
    """Open a device and find its position zero by limit switch and index; raise `RigError` if the search fails."""
    experiment = config.override(request.experiment, request.changes)
    _refuse_without_index(experiment)
    url = devices.url_for(request.url or "sim://", experiment.controller.loop)
    with devices.open_device(url, config.rig_model(still(experiment))) as device:
        return reference(
            device,
            experiment,
            output=Path(request.output),
            verified=request.verified,
            by_hand=request.by_hand,
            tell=tell,
        )


@stop_requests.together()
def reference(
    device: FramedDevice,
    experiment: Experiment,
    *,
    output: Path,
    verified: bool,
    by_hand: bool = False,
    tell: Tell | None = None,
) -> FoundReference:
    """Find position zero of an open device by the encoder's index, and store the count in the device.

    Parameters
    ----------
    device
        Open device, at rest.
    experiment
        Experiment whose rig has an index (`rig.reference`); its homing limits the speed and effort of the search.
    output
        Directory of the recordings.
    verified
        True if the signs of motor and encoder were checked; not needed if a person moves the handle.
    by_hand
        True if a person moves the handle, not the motor.
    tell
        Called with a text about the next step, or with an instruction.

    Raises
    ------
    ConfigError
        The rig has no index or no limit switch, or the polarity of a real rig is not verified. Nothing has moved.
    IdentificationError
        The rig does not move as described, a switch or an index is not found, or two indices have a wrong distance.
    RigError
        A motion ended early; the effort is zero.
    """
    _refuse_without_index(experiment)
    refuse([check_rig(config.rig_model(still(experiment)), device.dictionary)])
    experiment = config.override(experiment, at_own_rate(experiment, device), "reference")
    search = _IndexSearch(device, experiment, output, tell or (lambda text: None), verified=verified)
    if by_hand:
        index_count, switch_count, passed = search.by_hand()
    else:
        index_count, switch_count, passed = search.by_motor()
    scale, at = resolution(experiment), experiment.rig.reference.position
    zero = index_count - round(at / scale)
    device.reference_count = zero
    verified = verified or device.dictionary.simulated
    run = prepared_on(device, still(experiment), verified=verified, reference_count=zero)
    device.configure(run.parameters)
    if not by_hand:
        search.into_the_window(zero)
    return FoundReference(
        rig=experiment.rig.name,
        motion=experiment.rig.motion,
        device=device.dictionary.device,
        reference_count=zero,
        index_count=index_count,
        position=scale * (device.count() - zero),
        switch_position=None if switch_count is None else scale * (switch_count - zero),
        index_counts=passed,
        recordings=tuple(search.recordings),
    )


def _refuse_without_index(experiment: Experiment) -> None:
    if not experiment.rig.reference.index:
        raise ConfigError(
            f"{experiment.rig.name} has no index to find: rig.reference.index is false",
            remedy="set rig.reference.index = true and rig.reference.travel, and describe a limit switch if the travel "
            "contains more than one index; or put the handle at position zero before each run",
        )


_Found = tuple[int, int | None, int | None]  # counts: of the index, of the switch, to the next index


class _IndexSearch:
    """A search for index and switch on an open device, in counts; positions are relative to a provisional zero."""

    def __init__(
        self, device: FramedDevice, experiment: Experiment, output: Path, tell: Tell, *, verified: bool
    ) -> None:
        self._device, self._experiment, self._verified = device, experiment, verified
        self._output, self._tell = output, tell
        self._scale, self._reference = resolution(experiment), experiment.rig.reference
        self._every = self._reference.index_counts(experiment.rig.encoder)
        assert self._reference.travel is not None  # a rule of the configuration
        self._travel = self._reference.travel
        # Direction away from the switch in counts; upwards without a switch.
        self._away = (self._reference.away or 1) * experiment.rig.encoder.sign
        limits = experiment.rig.limits
        self._middle = 0.5 * (limits.position_minimum + limits.position_maximum)
        self._zero = device.count() - round(self._middle / self._scale)
        self.recordings: list[Path] = []

    # ------------------------------------------------------------------ by the motor

    def by_motor(self) -> _Found:
        device, experiment = self._device, self._experiment
        if self._reference.limit_switch == "none":
            raise ConfigError(
                f"{experiment.rig.name} has no limit switch to move to (rig.reference.limit_switch)",
                remedy="move the handle by hand: `by_hand`; this is enough, since the travel contains "
                "one index",
            )
        most_hz, bytes_per_second = device.dictionary.position_rate_maximum, device.link.bytes_per_second
        refuse(link_checks(still(experiment), most_hz, bytes_per_second))
        refuse_unverified(device, verified=self._verified)
        with plain_errors("make", self._output):
            self._output.mkdir(parents=True, exist_ok=True)
        # With a wrong sign the search would move away from the switch and not stop.
        self._tell("signs: a torque pulse, hands off the handle")
        name, verified = self._name("pulse"), self._verified
        signs = pulse(device, experiment, recording=name, verified=verified, reference_count=self._zero)
        self.recordings.append(signs.recording)
        signs.insist()
        if not self._is_pressed():
            self._tell(f"to the limit switch at the {self._reference.limit_switch} of the travel")
            self._seek()
        # The index pulse occurs once per turn of the encoder: after the limit switch the first index on the way back is
        # always the same. Pass it always in the same direction, because the pulse has a width.
        self._tell("back to the index")
        switch, before = self._leave()
        self._go(switch + self._away * self._every, "index")
        first = self._one_more(before)
        self._check_near(first, switch)
        if self._travel < BOTH * self._every * abs(self._scale):
            return first, switch, None
        self._go(switch + 2 * self._away * self._every, "next-index")
        second = self._one_more(before + 1)
        self._check_distance(first, second)
        return first, switch, abs(second - first)

    def _is_pressed(self) -> bool:
        return bool(self._look().inputs & Input.LIMIT_SWITCH)

    def _look(self) -> State:
        for _ in range(round(1.0 / LOOK_S)):
            if found := self._device.states(LOOK_S):
                return found[-1]
        raise IdentificationError("the device sent no STATE message within 1 s", remedy="update its firmware")

    def _name(self, what: str) -> Path:
        return free_name(self._output, f"{self._experiment.rig.name}-reference-{what}")

    def _go(self, count: int, what: str, *, zero: int | None = None) -> NDArray[np.void]:
        """Move to a count; return the logged samples. Raise `IdentificationError` if the handle stops short of it."""
        device, zero = self._device, self._zero if zero is None else zero
        at, to = self._scale * (device.count() - zero), self._scale * (count - zero)
        try:
            rows, recording = run_motion(
                device,
                way_motion(self._experiment, at, to, MARGIN * self._travel),
                self._name(what),
                verified=self._verified,
                reference_count=zero,
                extra={"reference": what},
                leaves_switch=what != "switch",
            )
        except DeviceFaultError as error:  # the device reports a blocked handle as a fault
            error.remedy = f"{BLOCKED}; {error.remedy}"
            raise
        except GuardError as error:
            end = end_of(error)
            if end is not None and end.reason is EndReason.UNMOVED:
                error.remedy = f"{BLOCKED}; {error.remedy}"
            if end is None or end.reason is not EndReason.HOMING_FAILED:  # only the homing of a board ends so
                raise
            raise self._short(abs(to - self._scale * (device.count() - zero))) from error
        self.recordings.append(recording)
        short = abs(to - float(rows["position"][-1]))
        if what != "switch" and short > FOLLOWS * self._every * abs(self._scale):
            raise self._short(short)
        return rows

    def _short(self, way: float) -> IdentificationError:
        return IdentificationError(
            f"the handle stopped {way:.3g} {unit_of('position', self._experiment.rig.motion)} before its target",
            remedy="take all hands off the handle and remove obstacles from its travel; or raise homing.effort",
        )

    def _seek(self) -> None:
        """Move until the limit switch is pressed, which ends the run; raise `IdentificationError` without a switch."""
        way = -self._away * round((1.0 + MARGIN) * self._travel / abs(self._scale))
        try:
            self._go(self._device.count() + way, "switch")
        except GuardError as error:
            end = end_of(error)
            if end is None or end.reason is not EndReason.LIMIT_SWITCH:
                raise
            self.recordings.append(end.recording)
            return
        unit = unit_of("position", self._experiment.rig.motion)
        raise IdentificationError(
            f"no limit switch was found within a travel of {self._travel:.4g} {unit} towards the "
            f"{self._reference.limit_switch} of the travel",
            remedy="check rig.reference.limit_switch and travel, the board's setting of the switch, and "
            "that the handle presses it; a stop before it, or a hand, can hold the handle back "
            "too",
        )

    def _leave(self) -> tuple[int, int]:
        """Move until the switch opens; return its last pressed count, and the index edges seen before the last step."""
        step = max(1, round(LEAVE * self._every))
        for _ in range(round(1.0 / LEAVE)):
            before = self._device.reference().index_edges
            rows = self._go(self._device.count() + self._away * step, "leave")
            if not self._is_pressed():
                pressed = np.flatnonzero(rows["inputs"] & int(Input.LIMIT_SWITCH))
                return int(rows["count"][pressed[-1] if len(pressed) else 0]), before
        raise IdentificationError(
            "the limit switch is still reported as pressed after the handle moved away from it",
            remedy="repair the switch's wire; or, if the switch is at the other end of the travel, correct "
            "rig.reference.limit_switch",
        )

    # ------------------------------------------------------------------ by hand

    def by_hand(self) -> _Found:
        """Find index and switch while a person moves the handle; return count of index, of switch, between indices."""
        away = "rising" if self._away * self._experiment.rig.encoder.sign > 0 else "falling"
        switched = self._reference.limit_switch != "none"
        where = "press the limit switch with the handle, then move it" if switched else "move the handle"
        self._tell(f"{where} slowly through its travel, with {away} position, without turning back")
        switch: int | None = None
        before, begun, first = self._device.reference().index_edges, self._device.count(), None
        both = switched and self._travel >= BOTH * self._every * abs(self._scale)
        for _ in range(round(HAND_S / LOOK_S)):
            state, seen = self._look(), self._device.reference()
            if switched and (state.inputs & Input.LIMIT_SWITCH or switch is None):
                pressed = state.inputs & Input.LIMIT_SWITCH
                switch, before, first = (state.count if pressed else None), seen.index_edges, None
                continue
            if seen.index_edges == before:
                continue
            if first is None:
                first = self._one_more(before)
                self._check_near(first, begun if switch is None else switch)
                if not both:
                    return first, switch, None
            elif seen.index_edges != before + 1:
                second = self._one_more(before + 1)
                self._check_distance(first, second)
                return first, switch, abs(second - first)
        missing = "the limit switch" if switched and switch is None else "an index"
        raise IdentificationError(
            f"{missing} was not seen within {HAND_S:g} s",
            remedy="move the handle as the instruction says; if it was moved so, check the wires and "
            "the board's settings of index and limit switch",
        )

    # ------------------------------------------------------------------ judging

    def _one_more(self, before: int) -> int:
        """Return the index's count if exactly one index edge came after `before` edges; raise otherwise."""
        seen = self._device.reference()
        passed = (seen.index_edges - before) % 2**32
        if passed == 1:
            return seen.index_count
        raise IdentificationError(
            "no index was seen within twice the distance between two indices"
            if passed == 0
            else f"{passed} indices were seen where exactly one is expected",
            remedy="check the index's wire, the board's setting of the index, and "
            "rig.encoder.counts_per_revolution; then move the handle without turning back"
            if passed == 0
            else "check the index's wire for noise, and rig.encoder.counts_per_revolution and decoding",
        )

    def _check_near(self, index: int, switch: int) -> None:
        """Raise if the index lies so near to the switch that the next search could find the neighbouring index."""
        way = self._away * (index - switch)
        if self._reference.limit_switch == "none":
            if way < 0:
                raise IdentificationError(
                    "the index was passed in the wrong direction",
                    remedy="move the handle as the instruction says",
                )
            return
        if not NEAR * self._every <= way <= (1.0 - NEAR) * self._every:
            raise IdentificationError(
                f"the index is {way} counts from the limit switch; allowed are {NEAR * self._every:.0f} to "
                f"{(1.0 - NEAR) * self._every:.0f}, else the next search may find another index",
                remedy="move the switch by about half of the distance between two indices",
            )

    def _check_distance(self, first: int, second: int) -> None:
        between = abs(second - first)
        if abs(between - self._every) > SAME_COUNTS:
            raise IdentificationError(
                f"the distance between two indices is {between} counts; described are {self._every}",
                remedy="check the encoder's wires, because noise may add or lose pulses and counts; or correct "
                "rig.encoder.counts_per_revolution, decoding or rig.reference.index_distance",
            )

    def into_the_window(self, zero: int) -> None:
        """Move the handle into the position window, so that a run may begin; `zero` is the count at position zero."""
        limits = self._experiment.rig.limits
        margin = MARGIN * (limits.position_maximum - limits.position_minimum)
        at = self._scale * (self._device.count() - zero)
        to = min(max(at, limits.position_minimum + margin), limits.position_maximum - margin)
        if to != at:
            self._tell("into the position window")
            self._go(zero + round(to / self._scale), "window", zero=zero)
