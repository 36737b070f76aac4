"""Move the rig behind a drive: `sim_backend.mechanics.plant` under what the drive's law requests, tick by tick.

The simulated drives call it. A drive has its own shaft (revolutions of its encoder, N·m), the rig's model the link.
"""

from __future__ import annotations

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

# What a drive computes in a tick: its words, encoder count and torque at its shaft (N·m) in; torque wanted there out.
LAW = types.float64(types.float64[::1], types.int64, types.float64)

SCRIPT_HZ = 1000  # rows a second of what a hand wants
# the encoder's count; row of the script, ticks it lasts; counts gained or lost
COUNT, ROW, ROW_LEFT, SLIP = range(4)
PLACES = 4


@group
class Shaft(NamedTuple):
    """What turns a rig: the law of a drive, between encoder and torque.

    Attributes
    ----------
    law
        Plug point of signature `LAW`.
    words
        Of the drive, which the law alone gives a meaning.
    places
        By the constants of this file.
    effort_per_torque
        Effort at the link for 1 N·m at the shaft.
    row_ticks
        Ticks that a row of the script lasts.
    """

    law: Annotated[Any, types.FunctionType(LAW)]
    words: Floats
    places: Ints
    effort_per_torque: Float
    row_ticks: Int


@group
class Moving(NamedTuple):
    """A rig that is turned."""

    plant: Annotated[PlantArguments, type_of(PlantArguments)]
    script: Annotated[OperatorScript, type_of(OperatorScript)]
    shaft: Annotated[Shaft, type_of(Shaft)]


_put, _at = group_at(Moving)


@kernel(types.void(types.int64, type_of(Moving)))
def put(handle: int, moving: Moving) -> None:
    """Let a handle stand for a rig and its drive."""
    _put(handle, moving)


@kernel(types.void(types.int64, types.int64), no_refcount=True)
def run(handle: int, ticks: int) -> None:
    """Let a number of the drive's control cycles pass."""
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
    """A rig at rest behind a drive's shaft; in the hand of a person if the model has one.

    Parameters
    ----------
    model
        The physics. Its computation delay is left out: the drive and the bus have delays of their own.
    rate_hz
        Ticks a second of the drive's law.
    law, words
        Of the drive.

    Attributes
    ----------
    counts_per_turn
        Of the encoder, for one turn of the shaft.
    effort_per_torque
        Effort at the link for 1 N·m at the shaft.

    Raises
    ------
    ConfigError
        A linear rig, whose encoder has no turns.
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
        """Let the person who holds the handle, if there is one, begin: along to the start, and into the wall."""
        position = self._state.item(self._plant.handle_position)
        self._play(OperatorScript.of(self._model, 1.0 / SCRIPT_HZ, position, self._sessions))
        self._sessions += 1

    def run(self, ticks: int) -> None:
        """Let a number of the drive's control cycles pass."""
        run(self._handle, ticks)

    def happenings(
        self, words: Any, watchdog: int, reboot: Callable[[], None]
    ) -> dict[str, Callable[[float], None]]:
        """Return the events that any drive can be subjected to, by name.

        ``fault`` (its own), ``voltage`` (V), ``temperature`` (°C), ``slip`` (counts), ``expire`` (the watchdog, now),
        ``reboot``.

        `words` names the drive's words, `watchdog` is the one that counts down.
        """

        def put(word: int) -> Callable[[float], None]:
            return lambda value: self._words.__setitem__(word, value)

        return {
            "fault": put(words.struck),
            "voltage": put(words.voltage),
            "temperature": put(words.temperature),
            "slip": lambda counts: self.slip(round(counts)),
            "expire": lambda _: put(watchdog)(0.0),
            "reboot": lambda _: reboot(),
        }

    def slip(self, counts: int) -> None:
        """Let the encoder gain or lose counts against the truth."""
        self._places[SLIP] += counts

    @property
    def turns(self) -> float:
        """Return the true position of the shaft (revolutions from the model's zero), in the encoder's direction."""
        sensed = self._state.item(self._plant.sensed_position)
        encoder = self._model.encoder
        return encoder.sign * sensed * encoder.ratio / (2.0 * math.pi)

    @property
    def count(self) -> int:
        """Return the encoder count at the last tick."""
        return self._places.item(COUNT) + self._places.item(SLIP)

    @property
    def torque(self) -> float:
        """Return the torque at the shaft, behind the amplifier's lag (N·m)."""
        return self._state.item(self._plant.effort) / self.effort_per_torque
