"""Run the loop for a law on the device in a thread: encode parameter updates, compare currents of device and host.

Trials start it. Python must not send to the device while the loop runs: it posts updates.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.connection import State
from firmware_protocol.faults import Status
from firmware_protocol.messages import NO_COMMAND_YET
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import encode_block
from rig.core.errors import RigError
from rig.core.present import plain
from rig.loop import _supervise as supervise
from rig.loop._parameter_update import update_of
from rig.loop._run import LoopThread, fault_of
from rig.loop._supervision import SupervisionBuffers
from rig.realtime import control_words
from rig.realtime import mailbox as mailboxes
from rig.realtime.codec import STATE

# Quanta by which the device's current may differ from the host's law, by the arithmetic of a board. A drive that
# renders the wall itself has filters of its own: its difference is reported, without a limit.
BOUNDS = {"fixed": 1, "float32": 2}
NO_BOUND = 1 << 16  # quanta: more than any difference of two currents
# Too many ticks beyond the bound: more than this share of those compared, and more than this number.
MANY_SHARE, MANY_TICKS = 0.001, 10

# numbers of a parameter set → live parameters of the device
Live = Callable[[Sequence[float]], Mapping[str, Value]]


@dataclass(frozen=True, slots=True)
class DeviceHostAgreement:
    """Comparison of the device's current with the current of the same law on the host, computed from the same counts.

    Attributes
    ----------
    compared
        Number of compared ticks: no limit, ramp or gap acted in them.
    excluded
        Number of excluded ticks: a limit acted, no STATE covered them, or a gap was shortly before.
    differing
        Number of compared ticks in which the currents differ.
    greatest_quanta
        Greatest difference (current quanta).
    bound_quanta
        Largest difference that rounding explains (current quanta): `BOUNDS`.
    beyond
        Number of compared ticks with a difference above `bound_quanta`.
    holds
        True if `beyond` is at most `MANY_TICKS`, or at most the share `MANY_SHARE` of `compared`.
    """

    compared: int
    excluded: int
    differing: int
    greatest_quanta: int
    bound_quanta: int
    beyond: int
    holds: bool


class SupervisedThread(LoopThread):
    """A thread that runs the loop for a law on the device; it has the methods of `LoopThread`.

    Parameters
    ----------
    arguments, keywords
        Arguments of `LoopThread`.
    live
        Function that converts a new parameter set of the law to the device's parameters; if it raises a
        `rig.core.errors.RigError`, the set is refused. None: the wall cannot change.
    """

    compiled: ClassVar[tuple[Any, ...]] = (supervise.run, mailboxes.take)

    def __init__(self, *arguments: Any, live: Live | None = None, **keywords: Any) -> None:
        self._supervision = SupervisionBuffers.allocate()
        self._updates = np.zeros(mailboxes.MAILBOX_BYTES // 8, np.int64)
        mailboxes.clear(self._updates.ctypes.data)
        self._writer = mailboxes.Mailbox(self._updates.ctypes.data, keep=self._updates)
        self._posted = np.zeros(mailboxes.MOST_BYTES, np.uint8)
        self._live_parameters = live
        self._refused: list[str] = []
        super().__init__(*arguments, **keywords)
        # Until the first STATE comes: a device that sends samples runs, and its active command is not known.
        self._buffers.state[STATE.state] = State.RUNNING
        self._buffers.state[STATE.command_age] = NO_COMMAND_YET
        self._parameter_count = 1 + len(self._controller.law.parameters)

    @property
    def fault(self) -> int:
        """Return the fault code in the newest STATE, 0 without a fault."""
        return fault_of(self._supervision.newest)

    def agreement(self) -> DeviceHostAgreement:
        """Return the comparison so far of the device's current with the current of the host's law."""
        v = self._supervision.supervision[0]
        compared, beyond = int(v["compared"]), int(v["beyond"])
        return DeviceHostAgreement(
            compared=compared,
            excluded=int(v["excluded"] + v["open_compared"]),
            differing=int(v["differing"]),
            greatest_quanta=int(v["greatest"]),
            bound_quanta=self._settings.agreement_quanta,
            beyond=beyond,
            holds=beyond <= max(MANY_TICKS, MANY_SHARE * compared),
        )

    def messages(self) -> list[str]:
        """Return warnings for the user: refused parameter updates, or a device whose current differs from the law."""
        agreement, warnings = self.agreement(), list(self._refused)
        v = self._supervision.supervision[0]
        if v["refused_set"]:
            status = int(v["refused_status"])
            named = Status(status) if status in set(Status) else None
            why = f"status {status}" if named is None else f"{named.text}; {named.remedy}"
            warnings.append(f"the device refused parameter set {int(v['refused_set'])}: {why}")
        if not agreement.holds:
            cause = ": check that firmware and package are of one version (rig firmware info)"
            if lost := self.ring.get(control_words.LOST):
                cause = f"; {lost} samples were lost, so the two may be in different phases: reduce the link's load"
            warnings.append(
                f"the device's current differed from the host's law by more than {agreement.bound_quanta} quanta in "
                f"{agreement.beyond} of {agreement.compared} ticks, at most by {agreement.greatest_quanta}"
                f"{cause}"
            )
        return warnings

    def findings(self) -> dict[str, Any]:
        """Return the comparison of device and host currents, for the recording, as {"device_host_agreement": {…}}."""
        return {"device_host_agreement": plain(self.agreement())}

    def handover(self) -> dict[str, int] | None:
        """Return the numbers from which `FramedDevice.take_back` continues the protocol; None if no command was sent.

        They include ``parameters_crc``, the CRC of the device's parameters, if the wall has changed.
        """
        progress, v = self._buffers.progress[0], self._supervision.supervision[0]
        if not progress["sequence"] and not v["stop_sequence"] >= 0:
            return None
        received, changed = bool(v["heard"]), int(v["parameters_crc"])
        return {
            "next_command": int(progress["sequence"]),
            "newest_state": int(progress["answers"]) if received else 0xFFFF,
            "state": int(self._supervision.newest[STATE.state]) if received else int(State.RUNNING),
            "nonce": int(progress["nonce"]),
            **({} if changed < 0 else {"parameters_crc": changed}),
        }

    def _run(self) -> None:
        supervise.run(
            self._link.port(),
            self._controller.arguments(),
            self._shared(),
            self._settings.as_array(),
            self._buffers,
            self._supervision,
        )

    def _mailbox(self) -> int:
        """Return the address of the mailbox for parameter updates, 0 if the wall cannot change."""
        return int(self._updates.ctypes.data) if self._live_parameters and super()._mailbox() else 0

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return (*super()._arrays(), *self._supervision)

    def _attend(self) -> None:
        """Convert a posted parameter set to an update for the loop; store the reason if the set is refused."""
        if self._live_parameters is None or not super()._mailbox():
            return
        number = mailboxes.take(self.ring.mailbox, self._posted)
        if number == 0:
            return
        values = self._posted.view(np.float64)[: self._parameter_count].tolist()
        try:
            block = encode_block(self._live_parameters(values))
            self._writer.post(update_of(number, block, values))
        except RigError as error:
            self._refused.append(f"parameter set {number} was not sent to the device: {error}")
