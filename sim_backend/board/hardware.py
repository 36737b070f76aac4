"""Simulate the board's hardware: encoder counter, current amplifier and current sensor, and the rig behind them.

A simulated device calls it once a tick with a current and reads a count, the age of the last edge and a measured
current. All decisions belong to the device: this file only simulates the hardware layer of a firmware.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from rig.core.model import RigModel
from rig.realtime.groups import group_at, group_bytes
from rig.realtime.kernel import kernel, prepare
from sim_backend.board.lockstep import (
    COUNT,
    INDEX_COUNT,
    INDEX_EDGES,
    MEASURED,
    NOISE_LEFT,
    PLACES,
    ROW,
    TRUE_COUNT,
    TRUTH_ROWS,
    Lockstep,
    Supplies,
    Wires,
    Words,
    run_ticks,
    sense,
)
from sim_backend.mechanics.driven_hand import DrivenHand
from sim_backend.mechanics.inner import Vector
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import PLANT_TYPE, DiscretePlant, PlantArguments, advance
from sim_backend.mechanics.sensors import CURRENT_QUANTA_LIMIT, current_quanta, encoder_count
from sim_backend.mechanics.truth import TruthLog

# Drawn in blocks: one draw at a time costs a microsecond, as much as a compiled tick.
_NOISE_BLOCK = 4096
_PEAK = int(CURRENT_QUANTA_LIMIT)
NO_END = 1 << 62  # ticks
_NO_INDICES, _NO_STATES = np.zeros(0, np.int64), np.zeros((0, 0))


class World(NamedTuple):
    """A rig as arguments of `lockstep.run_ticks`, in their order."""

    plant: PlantArguments
    script: OperatorScript
    wires: Wires
    supplies: Supplies


_put, _at = group_at(PlantArguments)


@kernel(types.void(types.int64, PLANT_TYPE))
def _store_plant(handle: int, plant: PlantArguments) -> None:
    # To unpack the group of arguments at each call costs Python as much as a whole tick.
    _put(handle, plant)


@kernel(types.int64(types.int64, types.float64, types.float64), no_refcount=True)
def _advance(handle: int, command_effort: float, external_effort: float) -> int:
    """Move the plant that `_store_plant` stored at the address `handle` by one tick; return the encoder count.

    `command_effort` goes to the amplifier, `external_effort` acts on the link (N·m or N).
    """
    return int(advance(_at(handle), command_effort, external_effort))


class Hardware:
    """A simulated rig with its sensors, at rest at the start; a person holds the handle if the model has an operator.

    Parameters
    ----------
    model
        Rig to simulate.
    rate
        Ticks in a second (Hz).
    seed
        Seed of the current sensor's noise.
    initial_position
        Position of the handle at power-up (rad or m); None for that of the model, else 0.

    Attributes
    ----------
    count
        Encoder count at the last sample.
    measured
        Measured motor current at the last sample (quanta).
    external_effort
        External effort on the link from the next tick on (N·m or N).
    slip
        Encoder count minus true count, from the next sample on: counts gained or lost, or the start of a counter that
        begins at 0 at any position.
    leak
        Offset of the measured current (quanta), for example from a short circuit or a drifted sensor.
    marks
        True counts at which the encoder's indices lie and the limit switch closes (`marks_of`).
    drive, gain
        Ratio of motor current to commanded current, and of measured current to motor current. 0: a disconnected motor,
        a dead sensor. Negative: reversed. With both at −1 the motor's leads are swapped.
    """

    def __init__(self, model: RigModel, rate: int, *, seed: int, initial_position: float | None) -> None:
        if initial_position is None:
            initial_position = model.simulation.initial_position or 0.0
        self._model = model
        self._plant = DiscretePlant.build(model, 1.0 / rate)
        self._state = self._plant.at_rest(initial_position)
        self._memory = np.zeros(0, np.int64)
        self._renew_arguments()
        self._effort_quantum = model.amplifier.effort_quantum
        self._ampere_per_effort = 1.0 / model.amplifier.effort_per_ampere
        self._quantum_a = model.amplifier.current_quantum_a
        self._noise = Noise(model.amplifier.current_noise_a, seed)
        self.marks = marks_of(model)
        self._script, self._row = OperatorScript.silent(), 0
        self._sessions = 0
        self._hand: DrivenHand | None = None
        self._hand_driven = False  # True while the script consists of its blocks
        self.external_effort = 0.0
        self.slip = self.leak = 0
        self.drive = self.gain = 1.0
        self.count = self._plant.count(self._state)
        self.measured = 0

    def set_rate(self, rate: int) -> None:
        """Change the tick rate (Hz) from now on; raise `ConfigError` if the plant cannot be simulated at this rate."""
        self._plant = DiscretePlant.build(self._model, 1.0 / rate)
        # The delay is another number of ticks at another rate. No current is on its way: rates change only at rest.
        self._state = np.concatenate(
            [self._state[: self._plant.commands.start], np.zeros(self._plant.delay_ticks)]
        )
        self._renew_arguments()
        # A script is valid for one tick length. Without it the hand holds still at the handle.
        self._script = OperatorScript.silent()
        self._hand_driven = False

    def _renew_arguments(self) -> None:
        self._moving = self._plant.arguments(self._state)
        prepare(self._moving.other)  # a board does not compile between two ticks
        self._handle = 0

    def prepare(self) -> None:
        """Compile the functions that `advance` calls, or load them from the cache."""
        prepare(_advance, current_quanta)
        self._memory = np.zeros(-(-group_bytes(PlantArguments) // 8), np.int64)
        self._handle = int(self._memory.ctypes.data)
        _store_plant(self._handle, self._moving)

    def drive_hand(self, hand: DrivenHand) -> None:
        """Replace the scripted motion of the hand by an interactive hand, from the next session on."""
        self._hand = hand

    def begin_session(self) -> None:
        """Start the motion of the person who holds the handle, if there is one: homing, then a reach into the wall."""
        position = self._state.item(self._plant.handle_position)
        if self._hand is None:
            self._script = OperatorScript.of(self._model, self._plant.tick_s, position, self._sessions)
        else:
            self._hand.begin(position, self._plant.tick_s, self._sessions)
            self._hand_driven = True
        self._row = 0
        self._sessions += 1

    def _request_hand_motion(self) -> None:
        """Request the next block of motion from an interactive hand, if its last block is used up."""
        if self._hand_driven and self._row == 0 and self._hand is not None:
            hand, handle = self._plant.hand_position, self._plant.handle_position
            assert hand is not None
            velocity = handle + 1  # each velocity follows its position
            self._hand.tell(*(self._state.item(place) for place in (hand, handle, velocity)))
            self._script = self._hand.next(self._state.item(hand))

    def advance(self, current: int) -> None:
        """Simulate one tick with the motor current `current` (quanta), then update `count` and `measured`."""
        self._request_hand_motion()
        state, script = self._state, self._script
        if len(script.rows):
            state[self._plant.intentions] = script.rows[self._row]
            self._row = self._row + 1 if self._row + 1 < len(script.rows) else script.again
        effort = current * self._effort_quantum * self.drive
        if self._handle == 0:
            self.prepare()
        count = _advance(self._handle, effort, self.external_effort)
        self.count = count + self.slip
        measured_a = (
            # The sensor shows the effort behind the amplifier's lag, as a shunt in the motor's lead does.
            state.item(self._plant.effort) * (self._ampere_per_effort * self.gain) + self._noise.next()
        )
        self.measured = current_quanta(measured_a, self._quantum_a)
        if self.leak:
            self.measured = max(-_PEAK, min(_PEAK, self.measured + self.leak))

    def run(self, software: Lockstep, until: int, most: int, enough: int, truth: TruthLog | None) -> int:
        """Run ticks with the currents that a compiled device requests; return the number of ticks.

        `until`, `most` and `enough` limit the run (`lockstep.run_ticks`); `truth` is the log for true states (None: no
        log). The run also stops if noise, space in the log or motion of the hand are used up; call it again for more
        ticks.
        """
        world = self.world(truth)
        ticks = run_ticks(software, *world, until, min(most, self.most_ticks), enough)
        if ticks:
            self.passed(software, world, truth)
        return int(ticks)

    @property
    def most_ticks(self) -> int:
        """Return the number of ticks until the hand's next block of motion or new noise values are needed."""
        hand = len(self._script.rows) - self._row if self._hand_driven else NO_END
        return min(hand, self._noise.left or NO_END)

    def world(self, truth: TruthLog | None) -> World:
        """Return the rig for compiled ticks: plant, script of the hand, scales of the signals, buffers.

        The buffers for noise and true states (in the log, None: no log) last for at least one tick.
        """
        self._request_hand_motion()
        noise = self._noise
        noise.refill()
        indices, states, rows = truth.room() if truth is not None else (_NO_INDICES, _NO_STATES, 0)
        places = np.zeros(PLACES, np.int64)
        places[ROW], places[NOISE_LEFT], places[TRUTH_ROWS] = self._row, noise.left, rows
        supplies = Supplies(noise=noise.drawn, places=places, indices=indices, states=states)
        return World(self._moving, self._script, self._wires(), supplies)

    def _wires(self) -> Wires:
        return Wires(
            effort_quantum=self._effort_quantum * self.drive,
            ampere_per_effort=self._ampere_per_effort * self.gain,
            quantum_a=self._quantum_a,
            external_effort=self.external_effort,
            slip=self.slip,
            leak=self.leak,
            **self.marks,
        )

    def sense(self, words: Words) -> None:
        """Update encoder index and limit switch in `words` after a sample; compiled ticks do this themselves."""
        if self.marks["index_counts"] or self.marks["switch_way"]:
            sense(words, self.count - self.slip, self._wires())

    def power_up(self, words: Words) -> None:
        """Clear the encoder's index pulses in `words`, as at power-up, and set the limit switch by the position."""
        # Index and switch are mechanical: they follow the true count, also after lost counts.
        words[TRUE_COUNT] = self.count - self.slip
        words[INDEX_EDGES] = words[INDEX_COUNT] = 0
        self.sense(words)

    def passed(self, software: Lockstep, world: World, truth: TruthLog | None) -> None:
        """Take over hand, noise, count, current and log after compiled ticks have changed `world` (see `world`)."""
        places, words = world.supplies.places, software.words
        self._row, self._noise.left = places.item(ROW), places.item(NOISE_LEFT)
        self.count, self.measured = words.item(COUNT), words.item(MEASURED)
        if truth is not None:
            truth.written(places.item(TRUTH_ROWS))

    @property
    def effort(self) -> float:
        """Return the motor effort at the last sample, behind the amplifier's lag (N·m or N)."""
        return self._state.item(self._plant.effort)

    @property
    def edge_age_s(self) -> float:
        """Return the age of the last encoder edge at the last sample (s); ∞ before the first edge."""
        return self._state.item(self._plant.edge_age)

    def cut(self) -> None:
        """Disable the amplifier: commands that do not act yet because of the plant's delay are lost too."""
        self._state[self._plant.commands] = 0.0

    def reset(self) -> None:
        """Clear the captured encoder edge, as a reset of the counter does; the motion of the rig continues."""
        self._state[self._plant.edge_age] = math.inf

    def new_truth(self) -> TruthLog:
        """Return an empty log for the true states of this plant."""
        return TruthLog(self._plant)

    def log(self, truth: TruthLog, sample_index: int) -> None:
        """Append the plant's present state to a log, as the state at a sample."""
        truth.add(sample_index, self._state)


def marks_of(model: RigModel) -> dict[str, int]:
    """Return first true count and spacing of the encoder's indices, and true count and direction of the limit switch.

    The keys are fields of `Wires`. The switch closes halfway between two indices, before the first index: the
    recommended position.
    """
    encoder, reference = model.encoder, model.reference
    # A limit switch half way between two indices leaves the most room to either side.
    every = reference.index_counts(encoder)
    first = encoder_count(reference.position, encoder.resolution, encoder.offset, encoder.sign)
    way = -encoder.sign * reference.away
    return {
        "index_first": first,
        "index_counts": every,
        "switch_count": first + way * (every // 2),
        "switch_way": way,
    }


class Noise:
    """Gaussian noise of the current sensor (A), drawn in blocks.

    Attributes
    ----------
    drawn
        A block of noise values (A), used from its end; empty for a sensor without noise.
    left
        Number of unused values in the block.
    """

    def __init__(self, rms_a: float, seed: int) -> None:
        self._rms_a = rms_a
        self._generator = np.random.default_rng(seed)
        self.drawn: Vector = np.zeros(0)
        self.left = 0
        self.refill()

    def refill(self) -> None:
        """Draw a new block of noise values if the last block is used up."""
        if self._rms_a != 0.0 and self.left == 0:
            self.drawn = self._generator.normal(0.0, self._rms_a, _NOISE_BLOCK)
            self.left = _NOISE_BLOCK

    def next(self) -> float:
        """Return the noise of the current sensor for one sample (A)."""
        if self._rms_a == 0.0:
            return 0.0
        self.refill()
        self.left -= 1
        return self.drawn.item(self.left)
