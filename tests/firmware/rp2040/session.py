"""A host on the serial line of an emulated board."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.packing import unpack_batch_samples
from firmware_protocol.parameter import Value
from rig.config._load import override
from rig.config.controller import prepare_controller
from rig.config.presets import load
from rig.firmware._build import BuildResult
from tests.conformance.host import RUN_PARAMETERS, Host
from tests.firmware.rp2040.emulator import PRESET, Pico, PicoLink, Ticks

SUPERVISE_S = 0.005
WIDE_OPEN = {"window_minimum": -(2**31), "window_maximum": 2**31 - 1, "speed_limit": 2**32 - 1}


class Session:
    def __init__(self, pico: Pico, built: BuildResult) -> None:
        self.pico = pico
        self.link = PicoLink(pico)
        self.batches: list[m.Batch] = []
        self._seen = 0
        self.connect()
        assert self.host.hash == int(built.dictionary_hash, 16)

    def connect(self) -> None:
        """Start a new host that has none of the earlier frames."""
        self.host = Host(self.link)
        self.host.hash = self.host.ask(m.Identify(self.host.nonce(), 0)).dictionary_hash

    def configure(self, **values: Value) -> m.Ack:
        ack = self.host.configure(**{**RUN_PARAMETERS, **values})
        assert ack.status == 0, ack
        self.crc = ack.crc
        return ack

    def arm(self, session: int = 1) -> None:
        ack = self.host.arm(session, self.crc)
        assert ack.status == 0, ack

    def push(self, current: int = 300, position_rate: int = 5_000) -> None:
        """Arm and command a current (quanta), without position limits."""
        self.configure(position_rate=position_rate, **WIDE_OPEN)
        self.arm()
        self.host.command(current)
        self.listen(0.002)
        look = self.pico.look()
        assert look["enabled"]
        assert look["current"] == pytest.approx(current * 1e-3, abs=0.002)

    def begin_law(self, position_rate: int, velocity_rate: int, **changes: Any) -> dict[str, Value]:
        """Arm a trial with the integer law on the device; return its parameters.

        It goes to the start six times as fast as a person would like, so that 80 ms contain homing, settling and a
        contact.
        """
        keys = {"loop": "device", "estimator": "fdm-butterworth-fixed", "position_rate": position_rate}
        keys |= {"velocity_rate": velocity_rate}
        experiment = override(load(PRESET), {f"controller.{key}": value for key, value in keys.items()})
        quantum = experiment.rig.amplifier.current_quantum_a
        values = prepare_controller(
            experiment, current_quantum_a=quantum, reference_count=0, verified=True
        ).parameters
        values |= {
            "settle_ticks": position_rate // 1_000,
            "home_step": 6 * int(values["home_step"]),
            **changes,
        }
        self.configure(**values)
        self.arm()
        return values

    def listen(self, seconds: float) -> None:
        """Receive for some seconds; store STATE in `host.states` and BATCH in `batches`."""
        ends = self.link.clock.now_ns() + round(seconds * 1e9)
        while self.link.clock.now_ns() < ends:
            left_s = (ends - self.link.clock.now_ns()) * 1e-9
            for event in self.host.events(min(left_s, 0.001)):
                if isinstance(event.message, m.Batch):
                    self.batches.append(event.message)

    def supervise(self, seconds: float) -> int:
        """Supervise the law on the device for some seconds; return the number of requests."""
        ends = self.link.clock.now_ns() + round(seconds * 1e9)
        requests = 0
        while self.link.clock.now_ns() < ends:
            self.host.command(mode=m.Mode.SUPERVISE)
            self.listen(min(SUPERVISE_S, (ends - self.link.clock.now_ns()) * 1e-9))
            requests += 1
        return requests

    def ticks(self) -> Ticks:
        log = self.pico.ticks()
        since, self._seen = self._seen, len(log.at)
        return log[since:]

    def ticks_of(self, indices: NDArray[np.int64]) -> Ticks:
        return self.pico.ticks()[indices - 1]

    def counts(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return count and sample index of every tick in the received BATCH frames; each count was true in its tick."""
        counts: list[NDArray[np.int64]] = []
        indices: list[NDArray[np.int64]] = []
        for batch in self.batches:
            moved = np.array([sample[0] for sample in unpack_batch_samples(batch)], dtype=np.int64)
            counts.append(batch.base_count + np.cumsum(moved))
            indices.append(batch.first_index + np.arange(len(moved)))
        all_counts, all_indices = np.concatenate(counts), np.concatenate(indices)
        self.check_true(all_counts, all_indices)
        return all_counts, all_indices

    def check_true(self, counts: NDArray[np.int64], indices: NDArray[np.int64]) -> None:
        """Require that the encoder had these counts while the samples with these indices were taken."""
        ticks = self.ticks_of(indices)
        low, high = np.minimum(ticks.before, ticks.after), np.maximum(ticks.before, ticks.after)
        assert np.all((low <= counts) & (counts <= high) & (high - low <= 1)), (counts, low, high)
