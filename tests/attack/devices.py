"""Send the same bytes to the Python device and to the C firmware, most of the time armed.

Both must send the same bytes, and neither may produce a current that its state or its limits forbid.
"""

import ctypes
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from firmware_protocol.framing import ENCODED_LIMIT
from firmware_protocol.messages import DisarmFlag
from firmware_protocol.packing import LAYOUT_OF, LAYOUTS
from sim_backend.board import firmware_library
from sim_backend.board.safety import IDLE_LIFETIME_S
from tests.attack.area import Outcome, require
from tests.attack.frames import any_message, frame_of, mangled
from tests.attack.protocol import raw_frames
from tests.firmware.test_core_equals_the_simulated_device import (
    AGES,
    CHOICES,
    HOST_MESSAGES,
    RATES,
    Pair,
    random_step,
    rig_of,
)

STEPS = 60
FRAMES = 30  # of a volley
VOLLEYS = 4  # beside each step
TICKS_IN_SILENCE = 1_500
TICKS_ON = 60
LIVELY = (State.ARMED, State.RUNNING)
_REARMED = 0.9  # share of the steps without a session that begin one
_ARM, _DISARM = LAYOUT_OF[m.Arm].type_id, LAYOUT_OF[m.Disarm].type_id


class Watched(Pair):
    """The Python device and the C firmware, checked against the safety invariants after every step."""

    def __init__(self, library: ctypes.CDLL, chance: random.Random) -> None:
        self.figures: Counter[str] = Counter()
        self.last_session = 0
        self.incoming = self.unfinished = b""  # in this step, and the frame that it leaves in part
        self.lively = False
        self.latched = Fault.NONE
        self.reported_session = 0
        super().__init__(library, rig_of(chance.choice((1, -1))), seed=chance.randrange(100))

    def write(self, data: bytes) -> None:
        self.figures["bytes"] += len(data)
        self.incoming = self.unfinished + data
        super().write(data)
        self.unfinished = self.incoming.rpartition(b"\0")[2][-ENCODED_LIMIT:]
        self.incoming = b""

    def both(self, call: Callable[[Any], bytes | None]) -> None:
        super().both(call)
        self.figures["bytes_sent"] += len(self.sent)
        self._check_invariants()

    def tick(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.figures["ticks"] += 1
            self.figures["ticks_armed"] += self.lively
            super().tick()

    def _check_invariants(self) -> None:
        """Check the invariants of current, arming and faults that must hold after any step."""
        status = self.c.core.status
        state, fault = self.c.state, self.c.fault
        currents = (self.python.current, status.current)
        lively = state in LIVELY
        if lively:
            limit = self.python._configuration.values["current_limit"]
            require(all(abs(current) <= limit for current in currents), currents, "above", limit)
        else:
            require(currents == (0, 0) and not status.enabled, "currents", currents, "in", state.name)
        if lively and (not self.lively or self.c.session != self.reported_session):
            require(self._has_valid_arm(), "armed by", self.incoming.hex())
        if self.latched and not fault and state is not State.BOOT:
            require(self._has_clear_fault(), "a fault that left by", self.incoming.hex())
        require(bool(fault) == (state is State.FAULT), fault, "in", state.name)
        self.lively, self.latched, self.reported_session = lively, fault, self.c.session

    def _has_valid_arm(self) -> bool:
        """Return True if an ARM with this session and the device's dictionary hash and parameter CRC arrived."""
        right = self.python._configuration
        for raw in raw_frames(self.incoming):
            if raw[1] == _ARM and raw[3] == self.c.session != 0:
                arm = LAYOUTS[_ARM].unpack(raw)
                assert isinstance(arm, m.Arm)
                if (arm.dictionary_hash, arm.parameters_crc) == (right.hash, right.crc):
                    return True
        return False

    def _has_clear_fault(self) -> bool:
        flag = int(DisarmFlag.CLEAR_FAULT)
        return any(raw[1] == _DISARM and raw[8] & flag for raw in raw_frames(self.incoming))

    def restart(self, chance: random.Random) -> None:
        """Release the emergency stop, clear the fault and begin a session, as an operator does before a new run."""
        for hardware in self.hardware:
            hardware.external_effort = hardware.jump = hardware.spike = 0
        self.both(lambda device: device.press_emergency_stop(False))
        self.both(lambda device: device.hold_to_run(True))
        self.write(b"\0")
        self.send(m.Identify(self.next_nonce(), 0))
        self.send(m.Disarm(self.next_nonce(), DisarmFlag.CLEAR_FAULT))
        values = {name: chance.choice(some) for name, some in CHOICES.items() if chance.random() < 0.2}
        values |= {"verified": 1, "window_minimum": -(2**31), "window_maximum": 2**31 - 1}
        self.last_session = 1 + self.last_session % 255
        self.begin(self.last_session, **values, position_rate=chance.choice(RATES))

    def run_on(self, chance: random.Random) -> None:
        """Begin a session if one is missing (mostly), and let the device run for some ticks."""
        if not self.lively and chance.random() < _REARMED:
            self.restart(chance)
        current, lifetime_us = chance.choice((0, 5, -20, 60)), chance.choice((3_000, 20_000))
        for _ in range(chance.randrange(TICKS_ON)):
            if not self.lively:
                break
            self.command(current, lifetime_us)
            self.tick()

    def volley(self, chance: random.Random) -> None:
        """Write many mangled frames at once: commands of the session, and any other message of a host."""
        data = b""
        session = self.python.connection.session
        for _ in range(chance.randrange(1, FRAMES)):
            if self.lively and chance.random() < 0.5:
                current = chance.choice((0, 60, -300, 501, 32_767, -32_768))
                mode = chance.choice((0, 0, 0, 0, 1, 2, 9))
                frame = frame_of(
                    m.Command(
                        self.answered(chance.choice(AGES)), chance.choice((1_000, 20_000)), mode, 0, current
                    ),
                    session,
                    self.sequence,
                )
                self.sequence = (self.sequence + 1) & 0xFFFF
            else:
                kinds = [cls for cls in HOST_MESSAGES if cls is not m.Disarm or chance.random() < 0.1]
                frame = frame_of(any_message(chance, kinds), session, chance.randrange(4))
            data += mangled(chance, frame)
        self.write(data)

    def check_silence(self) -> None:
        """Send nothing for longer than any lifetime and ramp; then the device must be disarmed."""
        values = self.python._configuration.values
        longest_s = 1e-6 * (
            max(values["command_lifetime_us"], values["supervise_lifetime_us"]) + values["ramp_us"]
        )
        ticks = round((longest_s + IDLE_LIFETIME_S) * self.python.rate) + 3
        if ticks > TICKS_IN_SILENCE:
            return
        self.tick(ticks)
        self.figures["silences"] += 1
        require(self.c.state not in LIVELY, "still", self.c.state.name, "after", ticks, "ticks of silence")


class Devices:
    """The area "devices": each case is one random walk of both devices."""

    def __init__(self, place: Path) -> None:
        self._library = firmware_library.library()

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run `STEPS` random steps of the host, the operator and the hardware, with volleys of frames between them."""
        watched = Watched(self._library, chance)
        watched.restart(chance)
        for _ in range(STEPS):
            watched.run_on(chance)
            random_step(chance).act(watched)
            for _ in range(VOLLEYS):
                watched.volley(chance)
        watched.write(b"\0")
        watched.ask_everything()
        watched.check_silence()
        watched.ask_everything()
        return Outcome(watched.figures)
