"""A trial of the shipped host on a device with injected faults, and the claims that must hold however it ends."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Protocol, Self

from rig.config import Experiment
from rig.control.law import Law
from rig.core.errors import RigError, StoppedError
from rig.devices.fault_script import Faults
from rig.devices.framed import FramedDevice
from rig.experiments.trials.replay import replay
from rig.recording.reader import open_recording
from sim_backend.board.safety import IDLE_LIFETIME_S
from sim_backend.ends.link import MemoryLink
from tests.conformance.trials import trial_on


class Struck(Protocol):
    """A device with a script of faults."""

    def open(self) -> AbstractContextManager[FramedDevice]: ...

    def wait_for_rest(self) -> None:
        """Advance time until no effort is permitted, and check that it is zero then and later."""
        ...


class InMemory:
    """A simulated device in virtual time; `rest_s` is slightly more than a command's lifetime and its ramp."""

    def __init__(self, device: Any, faults: Faults | None = None, *, rest_s: float) -> None:
        self.device = device
        self.link = MemoryLink(device, faults or Faults())
        self._rest_s = rest_s

    @contextmanager
    def open(self) -> Iterator[FramedDevice]:
        with FramedDevice(self.link) as device:
            yield device

    def wait_for_rest(self) -> None:
        self.link.elapse(self._rest_s)
        assert self.device.current == 0
        if self.link.armed:  # it was never commanded to move anything
            self.link.elapse(IDLE_LIFETIME_S)
        assert not self.link.armed
        self.link.elapse(0.1)
        assert self.device.current == 0
        assert abs(self.device.hardware.effort) < 1e-6


class StruckTrial:
    """One trial, run to its end, with its recording, its error (None: it finished) and the host's other messages."""

    def __init__(
        self,
        far_end: Struck,
        directory: Path,
        experiment: Experiment,
        *,
        law: Law | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self.far_end = far_end
        self.path = directory / "trial.rigcap"
        self.error: RigError | None = None
        try:
            with far_end.open() as device:
                end = trial_on(device, experiment, self.path, law=law, progress=progress, sealed=False)
                self.messages = end.messages
        except RigError as error:
            self.error, self.messages = error, tuple(error.messages)

    def check(self, *errors: type[RigError], replays: bool = True) -> Self:
        """Require one of these errors (none: the trial finished), zero effort and a complete recording."""
        assert isinstance(self.error, errors or type(None)), self.error
        assert self.error is None or self.error.remedy or isinstance(self.error, StoppedError)
        self.far_end.wait_for_rest()
        if self.path.exists():
            recording = self.recording
            assert recording.complete
            assert not recording.lost
            assert len(recording.rows) + self.counters["rows_dropped"] == self.counters["ticks"]
            assert not replays or replay(recording).exact
        return self

    @property
    def recording(self) -> Any:
        return open_recording(self.path)

    @property
    def rows(self) -> Any:
        return self.recording.rows

    @property
    def counters(self) -> Any:
        return self.recording.trailer["counters"]
