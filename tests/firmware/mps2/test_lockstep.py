"""The image in QEMU and this computer's build run the same hit with equal counts, currents and sent bytes."""

from pathlib import Path

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Input
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import encode_block
from firmware_protocol.transfer import set_parameters
from rig import config
from rig.config import Experiment, controller, device_law, presets
from rig.devices import framed
from rig.devices.framed import FramedDevice
from rig.firmware._flash import read_image
from tests.conformance.faults import FarEnd, check_faults
from tests.firmware import cross
from tests.firmware.mps2.lockstep import Partner, Rig, in_emulator, on_this_computer

RATE = 20_000
SUPERVISE_EVERY = RATE // 200
LIVE_AT = RATE // 50  # in free space: the handle is being taken to its start
FIXED = {"controller.estimator": "fdm-butterworth-fixed", "controller.parameters.cutoff_hz": 200.0}
UNIFORM = {"controller.velocity_rate": RATE}
SHORT = {"controller.loop": "device", "homing.settle_s": 0.02, "homing.speed": 1.5}
SHORT |= {"trial.duration_s": 0.2, "verdict.tail_s": 0.05}
CASES = {
    "M0+ code, integers, dual-rate": ("mps2-m0plus", FIXED, 12_000),
    "M4F, float32, dual-rate": ("mps2-an386", {}, 8_000),
    "M3, integers, uniform": ("mps2-an385", {**FIXED, **UNIFORM}, 7_000),
    "M7, float32, Kalman": (
        "mps2-an500",
        {"controller.estimator": "kalman", "controller.parameters": {"gain": "steady"}},
        7_000,
    ),
}


def experiment_of(changes: dict[str, object]) -> Experiment:
    return config.override(presets.load("koul-rigid"), {**SHORT, **changes})


def hit(partner: Partner, experiment: Experiment, ticks: int) -> Rig:
    """Identify, configure, arm, supervise, change the wall once, stop and disarm; all in virtual time."""
    rig = Rig(partner, config.rig_model(experiment))
    framed._dictionaries.clear()  # else the host would not read the dictionary of the second device
    device = FramedDevice(rig)
    quantum = device.dictionary.current_quantum_a
    known = {"current_quantum_a": quantum, "reference_count": 0}
    device.configure(controller.prepare_controller(experiment, verified=True, **known).parameters)
    device.arm()
    first = len(rig.trace)
    for tick in range(ticks):
        if tick % SUPERVISE_EVERY == 0:
            device.connection.receive_data(rig.read(0.0))  # a command answers the newest STATE
            while device.connection.next_event() is not None:
                continue
            supervise = m.Command(device.connection.answered, 20_000, int(m.Mode.SUPERVISE), 0, 0)
            rig.write(device.connection.send(supervise))
        if tick == LIVE_AT:
            wall = config.override(experiment, {"wall.stiffness": 200.0})
            prepared = controller.for_experiment(wall, **known)
            numbers = [wall.wall.position, *prepared.law.parameters]
            live = device_law.live_parameters(prepared, device_law.arithmetic_of(wall.controller), numbers)
            device._command(*set_parameters(encode_block(live), device._next_nonce()))
        rig.tick()
    assert rig.reply.state == State.RUNNING
    assert len(rig.trace) - first >= ticks
    device.stop()
    device.disarm()
    assert rig.reply.state == State.CONFIGURED
    return rig


@pytest.mark.parametrize("case", CASES)
def test_image_moves_and_sends_as_the_build_of_this_computer(case: str, tmp_path: Path) -> None:
    board, changes, ticks = CASES[case]
    cross.need_qemu()
    experiment = experiment_of(changes)
    for name in ("there", "here"):
        (tmp_path / name).mkdir()
    built = cross.image(board, "tests")
    traces, sent = [], []
    partners = (
        lambda: in_emulator(built, tmp_path / "there"),
        lambda: on_this_computer(config.rig_model(experiment), board, tmp_path / "here"),
    )
    for make in partners:
        partner = make()
        try:
            rig = hit(partner, experiment, ticks)
        finally:
            partner.close()
        traces.append(rig.trace)
        sent.append(b"".join(rig.sent))
    # Not compared in the assertion: its picture of where they differ would take minutes.
    same_trace, same_bytes = traces[0].tobytes() == traces[1].tobytes(), sent[0] == sent[1]
    assert (same_trace, same_bytes) == (True, True)
    assert len(sent[0]) > ticks * 4  # every tick is in a BATCH
    trace = traces[0]
    assert trace["count"].max() > 5, "it never met the wall"
    assert not trace["current"][-100:].any(), "the trial did not end"
    assert np.ptp(trace["current"]) > 500
    assert read_image(built.elf)[1].facts.board == board


class InLockStep(FarEnd):
    late = 1  # what the world shows at a sample is from the tick before

    def __init__(self, partner: Partner) -> None:
        self.rig = Rig(partner, config.rig_model(presets.load(cross.RIG)))
        super().__init__(self.rig)
        pressed, hardware = "the emergency stop is pressed", self.rig.hardware
        self.strikes = {
            pressed: lambda: self.show(Input.EMERGENCY_STOP, True),
            "a short circuit": lambda: setattr(hardware, "leak", 32_767),
        }
        self.repairs = {
            pressed: lambda: self.show(Input.EMERGENCY_STOP, False),
            "a short circuit": lambda: setattr(hardware, "leak", 0),
        }

    def parameters(self) -> dict[str, Value]:
        """Return parameters with wide limits, because the handle is pushed repeatedly and nothing holds it."""
        anywhere = {
            "window_minimum": -(2**31),
            "window_maximum": 2**31 - 1,
            "speed_limit": 2**32 - 1,
            "continuous_current": 5_000,
        }
        return {**super().parameters(), **anywhere}

    def show(self, which: Input, active: bool) -> None:
        self.rig.inputs = self.rig.inputs | which if active else self.rig.inputs & ~which

    def effort(self) -> float:
        return float(self.rig.reply.current)

    def enabled(self) -> bool:
        return self.rig.reply.enabled


def test_each_fault_is_zero_effort_in_time_on_the_processor(tmp_path: Path) -> None:
    partner = in_emulator(cross.image("mps2-m0plus", "tests"), tmp_path)
    try:
        far_end = InLockStep(partner)
        check_faults(lambda: far_end)
    finally:
        partner.close()
