"""Move the plant of a simulated drive by the torque that the drive's control law requests, tick by tick.

A drive measures and drives at its shaft (revolutions of its encoder, N·m); the model of the rig uses the link. Both
drives use it. It must not contain a control law.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.realtime.groups import Float, Floats, Int, Ints, group, group_at, group_bytes, type_of
from rig.realtime.kernel import kernel, prepare
from sim_backend.mechanics.coupled_hand import want
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import DiscretePlant, PlantArguments, advance

Words = NDArray[np.float64]

# Signature of a drive's law: (memory, encoder count, shaft torque in N·m) -> wanted shaft torque (N·m).
LAW = types.float64(types.float64[::1], types.int64, types.float64)

SCRIPT_HZ = 1000  # rows per second of the hand's scripted motion
# Indices into `Shaft.places`: encoder count, row of the script, remaining ticks of the row, slip (counts).
COUNT, ROW, ROW_LEFT, SLIP = range(4)
PLACES = 4


@group
class Shaft(NamedTuple):
    """A drive's control law with its memory, between the encoder count and the torque at the shaft.

    Attributes
    ----------
    law
        Compiled function of signature `LAW`.
    words
        Memory of the law.
    places
        Encoder count, row of the hand's scripted motion, ticks left for that row, and slip (count minus true count).
    effort_per_torque
        Effort at the link (N·m) for 1 N·m at the shaft.
    row_ticks
        Number of ticks of each row of the hand's scripted motion.
    """

    law: Annotated[Any, types.FunctionType(LAW)]
    words: Floats
    places: Ints
    effort_per_torque: Float
    row_ticks: Int


@group
class Moving(NamedTuple):
    """A simulated rig with a drive: the plant, the scripted motion of its hand, and the drive at its shaft."""

    plant: Annotated[PlantArguments, type_of(PlantArguments)]
    script: Annotated[OperatorScript, type_of(OperatorScript)]
    shaft: Annotated[Shaft, type_of(Shaft)]


_put, _at = group_at(Moving)


@kernel(types.void(types.int64, type_of(Moving)))
def put(handle: int, moving: Moving) -> None:
    """Store a rig with its drive in the memory at the address `handle`."""
    _put(handle, moving)


@kernel(types.void(types.int64, types.int64), no_refcount=True)
def run(handle: int, ticks: int) -> None:
    """Simulate `ticks` control cycles of the rig and drive that `put` stored at the address `handle`."""
    moving = _at(handle)
    plant, script, shaft = moving.plant, moving.script, moving.shaft
    places = shaft.places
    for _ in range(ticks):
        # What a drive reports as torque is the effort behind the current loop's lag, without sensor noise.
        measured = plant.state[plant.effort] / shaft.effort_per_torque
        torque = shaft.law(shaft.words, places[COUNT] + places[SLIP], measured)
        if not math.isfinite(torque):
            torque = 0.0  # how a real drive responds to a torque that is not finite is unknown
        if places[ROW_LEFT] == 0:
            places[ROW] = want(plant.state, plant.edge_age, script.rows, places[ROW], script.again)
            places[ROW_LEFT] = shaft.row_ticks
        places[ROW_LEFT] -= 1
        places[COUNT] = advance(plant, torque * shaft.effort_per_torque, 0.0)


class Motor:
    """A rig at the shaft of a drive, at rest at the start; a person holds the handle if the model has an operator.

    Raise `ConfigError` if the rig is linear, so its encoder has no turns.

    Parameters
    ----------
    model
        Rig to simulate, without its computation delay: the drive and the bus have delays of their own.
    rate_hz
        Control cycles of the drive in a second (Hz).
    law, words
        Compiled control law of the drive, and its memory.

    Attributes
    ----------
    counts_per_turn
        Encoder counts in one turn of the shaft.
    effort_per_torque
        Effort at the link (N·m) for 1 N·m at the shaft.
    """

    def __init__(self, model: RigModel, rate_hz: int, law: Any, words: Words) -> None:
        encoder = model.encoder
        if encoder.counts_per_revolution is None:
            raise ConfigError(
                f"{model.name} is a linear rig, but a drive is rotary",
                remedy="use a rotary rig, with encoder counts_per_revolution and ratio, and efforts in N·m",
            )
        model = replace(
            model,
            simulation=replace(model.simulation, computation_delay_ticks=0),
            # The drive's current loop is the rig's amplifier, with its lag and limit, whatever drives the model. The
            # drive and the bus have delays of their own.
            amplifier=replace(model.amplifier, drive="current"),
        )
        self._model = model
        self.counts_per_turn = encoder.counts_per_revolution * encoder.decoding
        # A shaft that turns `ratio` times for one turn of the link puts `ratio` times its torque there. A calibrated
        # drive turns the way its encoder counts under a positive torque: hence the sign.
        self.effort_per_torque = encoder.sign * encoder.ratio
        self._law, self._words = law, words
        self._plant = DiscretePlant.build(model, 1.0 / rate_hz)
        self._state = self._plant.at_rest(model.simulation.initial_position or 0.0)
        self._places = np.zeros(PLACES, np.int64)
        self._places[COUNT] = self._plant.count(self._state)
        self._row_ticks = rate_hz // SCRIPT_HZ
        self._sessions = 0
        self._memory = np.zeros(-(-group_bytes(Moving) // 8), np.int64)
        self._handle = int(self._memory.ctypes.data)
        arguments = self._plant.arguments(self._state)
        prepare(arguments.other, law, put, run)
        self._play(OperatorScript.silent())

    def _play(self, script: OperatorScript) -> None:
        shaft = Shaft(
            law=self._law,
            words=self._words,
            places=self._places,
            effort_per_torque=self.effort_per_torque,
            row_ticks=self._row_ticks,
        )
        # Kept, because only its address is elsewhere.
        self._moving = Moving(plant=self._plant.arguments(self._state), script=script, shaft=shaft)
        self._places[ROW] = self._places[ROW_LEFT] = 0
        put(self._handle, self._moving)

    def begin_session(self) -> None:
        """Start the motion of the person who holds the handle, if there is one: homing, then a reach into the wall."""
        position = self._state.item(self._plant.handle_position)
        self._play(OperatorScript.of(self._model, 1.0 / SCRIPT_HZ, position, self._sessions))
        self._sessions += 1

    def run(self, ticks: int) -> None:
        """Simulate `ticks` control cycles of the drive and its rig."""
        run(self._handle, ticks)

    def happenings(
        self, words: Any, watchdog: int, reboot: Callable[[], None]
    ) -> dict[str, Callable[[float], None]]:
        """Return functions that apply an external event to the drive, by name of the event; each takes a value.

        The events of all drives are ``fault`` (a fault code of the drive), ``voltage`` (V), ``temperature`` (°C),
        ``slip`` (counts), ``expire`` (the watchdog expires now) and ``reboot``. `words` names the indices of the law's
        memory, `watchdog` is the index of the remaining watchdog time.
        """

        def setter(word: int) -> Callable[[float], None]:
            return lambda value: self._words.__setitem__(word, value)

        return {
            "fault": setter(words.struck),
            "voltage": setter(words.voltage),
            "temperature": setter(words.temperature),
            "slip": lambda counts: self.slip(round(counts)),
            "expire": lambda _: setter(watchdog)(0.0),
            "reboot": lambda _: reboot(),
        }

    def slip(self, counts: int) -> None:
        """Add `counts` to the encoder count without motion, as after lost or extra edges."""
        self._places[SLIP] += counts

    @property
    def turns(self) -> float:
        """Return the true shaft position (revolutions from the zero of the model), positive as the encoder counts."""
        sensed = self._state.item(self._plant.sensed_position)
        encoder = self._model.encoder
        return encoder.sign * sensed * encoder.ratio / (2.0 * math.pi)

    @property
    def count(self) -> int:
        """Return the encoder count at the last tick, including the slip."""
        return self._places.item(COUNT) + self._places.item(SLIP)

    @property
    def torque(self) -> float:
        """Return the torque at the shaft, behind the amplifier's lag (N·m)."""
        return self._state.item(self._plant.effort) / self.effort_per_torque
