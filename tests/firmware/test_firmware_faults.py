"""The fault suite (`tests.conformance.faults`) on the Python device, the firmware, and the firmware with its own law.

The device with the law runs at 20 kHz, in a trial inside the wall. tests/system/test_faults.py has the host's
reactions.
"""

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Status
from firmware_protocol.messages import Mode
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME
from rig import config
from rig.config import controller, presets
from rig.core.model import RigModel
from rig.core.sample import Phase
from sim_backend.board import firmware_library
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.hardware import Hardware
from sim_backend.ends.link import MemoryLink
from sim_backend.mechanics.inner import COULOMB, COULOMB_LINK
from sim_backend.mechanics.plant import PlantArguments
from tests.conformance.faults import FarEnd, check_fault, faults_of
from tests.conformance.host import Host
from tests.conformance.rigs import rotary_rig
from tests.conformance.tiers import first_by_default
from tests.firmware import build
from tests.firmware.supervised import Sample, samples_of

RATE = 20_000
START = -0.015
LIBRARY = firmware_library.load(build.library())
LAG_TICKS = 200  # many times the lag of the amplifier: the residual effort is zero
CHANGES = {"controller.loop": "device", "controller.position_rate": RATE, "controller.velocity_rate": 2_000}
EXPERIMENT = config.override(
    config.with_realtime(presets.load("koul-compliant")), {**CHANGES, "trial.duration_s": 30.0}
)
MODEL = config.rig_model(EXPERIMENT)
PARAMETERS = controller.prepare_controller(
    EXPERIMENT, current_quantum_a=MODEL.amplifier.current_quantum_a, reference_count=0, verified=True
).parameters


class Simulated(FarEnd):
    blow = -5.0  # N·m against the effort

    def __init__(self, device: SimulatedDevice | FirmwareDevice) -> None:
        self.link = MemoryLink(device)
        super().__init__(self.link)
        hardware = device.hardware
        self.strikes = {
            "the emergency stop is pressed": device.press_emergency_stop,
            "the count jumps": partial(self.slip, 40_000),
            "a short circuit": partial(setattr, hardware, "leak", 32_767),
            "a blow": partial(self.push_handle, self.blow),
            **{
                f"the port finds {fault.name}": partial(device.inject_fault, fault)
                for fault in Fault
                if fault not in (Fault.NONE, Fault.EMERGENCY_STOP)
            },
        }
        if isinstance(device, FirmwareDevice):
            self.strikes["an illegal transition of the encoder"] = device.fail_encoder
        self.repairs = {
            "the emergency stop is pressed": partial(device.press_emergency_stop, False),
            "the count jumps": partial(self.slip, -40_000),
            "a short circuit": partial(setattr, hardware, "leak", 0),
            "a blow": partial(self.push_handle, 0.0),
        }

    def effort(self) -> float:
        return float(self.link.current)

    def parameters(self) -> dict[str, Value]:
        return {**super().parameters(), "continuous_current": 10_000}  # a short circuit leaves it cool

    def enabled(self) -> bool:
        device = self.link.device
        return isinstance(device, FirmwareDevice) and bool(device.status.enabled)

    def hold(self, held: bool) -> None:
        self.link.device.hold_to_run(held)

    def slip(self, counts: int) -> None:
        self.link.device.hardware.slip += counts

    def push_handle(self, effort: float) -> None:
        self.link.device.hardware.external_effort = effort


class InTheWall(Simulated):
    """The firmware with its own law in the wall; the host supervises."""

    rate, mode, send_every = RATE, Mode.SUPERVISE, RATE // 200
    most = float(PARAMETERS["current_limit"])
    blow = 5.0

    def __init__(self, model: RigModel = MODEL, **changes: Value) -> None:
        self.device = FirmwareDevice(model, library=LIBRARY, initial_position=START)
        super().__init__(self.device)
        self.changes = changes

    def parameters(self) -> dict[str, Value]:
        lifetimes = {"ramp_us": self.ramp_us, "supervise_lifetime_us": self.lifetime_us}
        return {**PARAMETERS, **lifetimes, **self.changes}

    def push(self) -> None:
        while self.device.hardware.count <= 0 or self.device.current >= -20:
            assert self.device.sample_index < 2 * RATE, "the handle does not come to the wall"
            self.run(self.send_every)

    def run(self, ticks: int) -> None:
        for _ in range(0, ticks, self.send_every):
            self.command()
            self._wait_until(self.link.clock.now_ns() + round(self.send_every * 1e9 / self.rate))

    @property
    def samples(self) -> list[Sample]:
        batches = (message for message in self.received if isinstance(message, m.Batch))
        return [sample for batch in batches for sample in samples_of(batch)]

    def ticks_to_fault(self, most: int) -> int:
        """Supervise until a fault is latched; return the number of ticks."""
        for ticks in range(1, most + 1):
            self.watch(1, self.command if ticks % self.send_every == 1 else None)
            if self.device.fault is not Fault.NONE:
                return ticks
        raise AssertionError("no fault")

    def check_at_rest(self, *faults: Fault) -> None:
        """Require a fault that is reported in its tick with all samples before it, and no effort from then on."""
        state = next(state for state in self.host.states if state.fault)
        assert (state.fault, state.state) == (self.device.fault, State.FAULT)
        assert self.device.fault in faults
        assert all(after.index - before.index == 1 for before, after in pairwise(self.samples))
        assert self.samples[-1].index >= state.sample_index - 1
        rows = len(self.device.truth())
        assert not any(self.watch(LAG_TICKS, self.command))
        assert not self.device.status.enabled
        assert np.abs(self.device.truth()["effort_true"][rows + LAG_TICKS // 2 :]).max() < 1e-6
        assert (self.device.fault in faults, self.device.state) == (True, State.FAULT)


FAR_ENDS: dict[str, Callable[[], Simulated]] = {
    "the readable device": lambda: Simulated(SimulatedDevice(rotary_rig())),
    "the firmware": lambda: Simulated(FirmwareDevice(rotary_rig(), library=LIBRARY)),
    "the law on the firmware": InTheWall,
}
OF_EACH_KIND = {
    "silence", "STOP", "hold-to-run is released", "the emergency stop is pressed",
    "an illegal transition of the encoder", "the count jumps", "a short circuit", "a blow",
}  # fmt: skip


def cases() -> list[Any]:
    """Return each fault of each device; by default all on the firmware, and one of each kind on the others."""
    found = [(end, name) for end, make in FAR_ENDS.items() for name in faults_of(make())]
    default = [(end, name) for end, name in found if end == "the firmware" or name in OF_EACH_KIND]
    return first_by_default(sorted(found, key=lambda case: case not in default), len(default))


@pytest.mark.parametrize(("far_end", "name"), cases())
def test_a_fault_is_zero_effort_in_time_latched_and_reported(far_end: str, name: str) -> None:
    check_fault(FAR_ENDS[far_end], name)


# ---------------------------------------------------------------------- with the law on the device alone


@pytest.mark.parametrize(
    "name", first_by_default(["the emergency stop is pressed", "an illegal transition of the encoder"])
)
def test_samples_up_to_a_fault_arrive_and_the_lagging_effort_ends(name: str) -> None:
    far = InTheWall().begin()
    assert far.state.phase == Phase.TRIAL
    far.strikes[name]()
    far.ticks_to_fault(1)
    far.check_at_rest(Fault.EMERGENCY_STOP, Fault.ENCODER)


def jam(plant: PlantArguments) -> PlantArguments:
    parameters = plant.parameters.copy()
    parameters[[COULOMB, COULOMB_LINK]] = 5.0
    return PlantArguments(**plant._asdict() | {"parameters": parameters})


def test_a_mechanism_that_jams_under_a_large_effort_is_a_runaway() -> None:
    far = InTheWall(current_limit=1_000).begin()
    while far.device.current > -600:
        far.watch(1, far.command)
        assert far.device.sample_index < RATE
    hardware = far.device.hardware
    hardware._moving, hardware._handle = jam(hardware._moving), 0
    far.ticks_to_fault(RATE)
    far.check_at_rest(Fault.RUNAWAY)


def test_a_motor_and_an_encoder_that_disagree_about_the_direction_are_stopped() -> None:
    far = InTheWall()
    assert far.arm().status == Status.OK
    far.host.next_state()
    wrong = replace(MODEL, encoder=replace(MODEL.encoder, sign=-MODEL.encoder.sign))
    far.device.hardware = Hardware(wrong, RATE, seed=0, initial_position=START)
    far.ticks_to_fault(RATE)
    far.check_at_rest(Fault.RUNAWAY, Fault.OVER_SPEED, Fault.POSITION_WINDOW)


@pytest.mark.parametrize(
    ("name", "value", "status"),
    [
        ("float_stiffness", float("inf"), Status.OUT_OF_RANGE),
        ("float_damping", -1.0, Status.OUT_OF_RANGE),
        ("position_rate", 1_000, Status.NOT_LIVE),
        ("current_limit", 32_767, Status.NOT_LIVE),
    ],
)
def test_invalid_parameter_is_refused_and_the_wall_continues(name: str, value: float, status: Status) -> None:
    parameter = BY_NAME[name]
    kind = "<Hf" if parameter.ctype == "f32" else "<HI"
    far, twin = (InTheWall().begin() for _ in range(2))
    ack = far.host.set_block(struct.pack(kind, parameter.id, value))
    assert ack.status in (status, Status.OUT_OF_RANGE)
    assert ack.detail == parameter.id
    for end in (far, twin):
        end.run(RATE // 20)
    np.testing.assert_array_equal(far.device.truth(), twin.device.truth())
    assert far.device.fault is Fault.NONE


def test_a_brown_out_in_mid_run_is_no_effort_and_a_device_that_knows_nothing() -> None:
    far = InTheWall().begin()
    before, stale = far.device.elapsed_ns, far.frame()
    far.device.brown_out()
    assert (far.device.current, far.device.status.enabled, far.device.session) == (0, 0, 0)
    assert far.device.hardware.count == 0
    assert not any(far.watch(LAG_TICKS, lambda: far.link.write(stale)))
    assert far.device.elapsed_ns > before
    assert far.device.status.counters.stale_session + far.device.status.counters.out_of_state > 0
    heir = Host(far.link)
    heir.identify()
    assert heir.ask(m.GetFaultLog(heir.nonce(), 0)).fault == Fault.WATCHDOG_RESET
    assert far.device.state is State.FAULT
