"""Record the true state of the simulated rig in every tick, to compare it with what the sensors measure.

The simulated device and its firmware twin fill it. A sensor must not read it.
"""

import numpy as np
from numpy.typing import NDArray

from rig.core.sample import TRUTH
from sim_backend.mechanics.inner import Vector
from sim_backend.mechanics.plant import DiscretePlant

_FIRST_ROWS = 4096


class TruthLog:
    """A log of the plant's states by sample index, without delayed commands; its buffers double when they are full."""

    def __init__(self, plant: DiscretePlant) -> None:
        self._plant = plant
        self._size = 0
        self._indices = np.zeros(_FIRST_ROWS, np.int64)
        self._states = np.zeros((_FIRST_ROWS, plant.commands.start))

    def add(self, sample_index: int, state: Vector) -> None:
        """Append a copy of the plant's state `state` at a sample to the log."""
        indices, states, row = self.room()
        indices[row] = sample_index
        states[row] = state[: states.shape[1]]
        self._size = row + 1

    def room(self) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
        """Return the log's buffers (sample indices, states) with at least one free row, and that row's index."""
        if self._size == len(self._indices):
            self._indices = np.concatenate([self._indices, np.zeros_like(self._indices)])
            self._states = np.concatenate([self._states, np.zeros_like(self._states)])
        return self._indices, self._states, self._size

    def written(self, size: int) -> None:
        """Set the number of rows to `size`, after other code has written into the buffers that `room` returned."""
        self._size = size

    def table(self) -> NDArray[np.void]:
        """Return the logged states as an array of dtype `rig.core.sample.TRUTH`, one row for each sample."""
        plant, states = self._plant, self._states[: self._size]
        rows = np.zeros(self._size, TRUTH)
        rows["sample_index"] = self._indices[: self._size]
        rows["position_true"] = states[:, plant.sensed_position]
        rows["velocity_true"] = states[:, plant.sensed_position + 1]
        rows["effort_true"] = states[:, plant.effort]
        rows["handle_position_true"] = states[:, plant.handle_position]
        rows["handle_velocity_true"] = states[:, plant.handle_position + 1]
        return rows
