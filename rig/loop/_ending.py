"""Find the reason for the end of a run (`EndReason`) in a STATE, a stop request, or the flags of the law.

Both loops call it in every tick. It must not wait, and must not ignore a stop request.
"""

from typing import Any

from numba import types

from firmware_protocol.connection import State
from firmware_protocol.faults import Input
from rig.control.step import DONE, MEMORY_TYPE
from rig.control.step import ENERGY as FLAG_ENERGY
from rig.control.step import HOMING_FAILED as FLAG_HOMING
from rig.control.step import NONFINITE as FLAG_NONFINITE
from rig.control.step import OUT_OF_WINDOW as FLAG_WINDOW
from rig.control.step import UNMOVED as FLAG_UNMOVED
from rig.control.step import VIOLENT as FLAG_VIOLENT
from rig.core.sample import RowFlag
from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop._contradictions import Contradiction
from rig.loop.layout import INTS, PROGRESS_TYPE, SETTINGS_TYPE, WORD, EndReason
from rig.realtime import control_words
from rig.realtime.atomics import load_word, store_word
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel

# Plain integers, as compiled code takes them.
FINISHED, STOPPED, HEARTBEAT = (int(EndReason[n]) for n in ("FINISHED", "STOPPED", "HEARTBEAT_MISSED"))
CLOSED, SILENT, FAULT = (int(EndReason[n]) for n in ("LINK_CLOSED", "LINK_SILENT", "DEVICE_FAULT"))
OVERRUN, DEVICE_ENDED = int(EndReason.OVERRUN), int(EndReason.DEVICE_ENDED)
_NONFINITE, _WINDOW, _HOMING = (int(EndReason[n]) for n in ("NONFINITE", "OUT_OF_WINDOW", "HOMING_FAILED"))
CONTRADICTS, RESTARTED = int(EndReason.DEVICE_CONTRADICTS), int(EndReason.DEVICE_RESTARTED)
_ENERGY, _VIOLENT, _UNMOVED = int(EndReason.ENERGY), int(EndReason.VIOLENT), int(EndReason.UNMOVED)
_ARMED, _RUNNING, _EMERGENCY = int(State.ARMED), int(State.RUNNING), int(Input.EMERGENCY_STOP)
_SWITCH, _LIMIT_SWITCH = int(Input.LIMIT_SWITCH), int(EndReason.LIMIT_SWITCH)
_ANEW = int(Contradiction.RESTARTED)
DELAYED = int(EndReason.LINK_DELAYED)
_CURRENT, _FLAG_CURRENT = int(EndReason.CURRENT_DIFFERS), int(RowFlag.CURRENT_DIFFERS)


@kernel(types.int64(PROGRESS_TYPE))
def reason_by_contradiction(progress: Any) -> int:
    """Return the end reason for contradictory data from the device, 0 without a contradiction."""
    found = progress[0]["contradiction"]
    if found == 0:
        return 0
    return RESTARTED if found == _ANEW else CONTRADICTS


@kernel(types.int64(INTS, PROGRESS_TYPE))
def reason_by_device(state: Any, progress: Any) -> int:
    """Return the end reason if a STATE message reports a fault, a disarmed device or impossible data; 0 to continue.

    A pressed emergency stop counts as a fault, although a device may still report ARMED.
    """
    # Not armed is enough: a device that left the session may report no fault.
    armed = state[STATE.state] == _ARMED or state[STATE.state] == _RUNNING
    if state[STATE.fault] != 0 or not armed or state[STATE.inputs] & _EMERGENCY != 0:
        return FAULT
    return int(reason_by_contradiction(progress))


@kernel(types.int64(INTS, SETTINGS_TYPE, PROGRESS_TYPE))
def reason_by_switch(state: Any, settings: Any, progress: Any) -> int:
    """Return the end reason if a STATE message reports a pressed limit switch or its broken wire, 0 to continue."""
    # The switch lies outside of the position window: where it is reached, position zero is wrong or the guard failed.
    s, p = settings[0], progress[0]
    if state[STATE.inputs] & _SWITCH == 0:
        p["switch_open"] += 1
        return 0
    if s["limit_switch"] != 0 and p["switch_open"] >= s["limit_switch"] - 1:
        return _LIMIT_SWITCH
    p["switch_open"] = 0
    return 0


@kernel(types.int64(PORT_TYPE, SETTINGS_TYPE, types.uintp))
def reason_by_request(port: LoopPort, settings: Any, words: int) -> int:
    """Return the end reason for a stop request or a missing heartbeat of the supervising thread, 0 to continue."""
    requests = settings[0]["stop_requests"]
    # The request is copied to the stop word of this run, so that `rig stop --list` shows that it is stopping.
    if requests != 0 and load_word(requests) != settings[0]["stop_requests_before"]:
        store_word(words + WORD * control_words.STOP, 1)
    if load_word(words + WORD * control_words.STOP) != 0:
        return STOPPED
    alive_until = load_word(words + WORD * control_words.HEARTBEAT)
    if alive_until != 0 and port.now(port.clock_handle) > alive_until:
        return HEARTBEAT
    return 0


@kernel(types.int64(MEMORY_TYPE))
def reason_by_law(memory: Any) -> int:
    """Return the end reason that follows from the flags and the phase in the law's state `memory`, 0 to continue.

    With the law on the device, the host runs the same law on the samples of each BATCH message.
    """
    # A device's law does not watch energy, violence or a count that stands: it drives until the STOP arrives, after the
    # rest of the batch (5 ms at most, `rig.config.device_law._batch`) and the transfer of both.
    flags = memory[0]["flags"]
    reason = 0
    if flags & FLAG_NONFINITE:
        reason = _NONFINITE
    elif flags & FLAG_WINDOW:
        reason = _WINDOW
    elif flags & FLAG_ENERGY:
        reason = _ENERGY
    elif flags & FLAG_VIOLENT:
        reason = _VIOLENT
    elif flags & _FLAG_CURRENT:
        reason = _CURRENT
    elif flags & FLAG_UNMOVED:
        reason = _UNMOVED
    elif flags & FLAG_HOMING:
        reason = _HOMING
    elif memory[0]["phase"] == DONE:
        reason = FINISHED
    return reason
