"""Wall changes while the law runs on the compiled firmware: device and host switch at the same sample."""

from functools import partial

import numpy as np
import pytest

from rig import config
from rig.config import controller, device_law, presets
from rig.core.sample import Phase
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault, Happening
from rig.devices.framed import FramedDevice
from rig.experiments.trials.replay import COMPUTED
from rig.loop import _exchange as exchange
from rig.loop._run import LoopSettings
from rig.loop._supervised import BOUNDS, SupervisedThread
from rig.loop.layout import EndReason
from rig.loop.replay import replay_rows
from rig.realtime import control_words
from rig.realtime.ring import Ring
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.firmware import need_compiler
from tests.conformance.started import WAIT_S

RATE = 10_000
EXCITED = {
    "controller.loop": "device",
    "controller.position_rate": RATE,
    "controller.velocity_rate": 1000,
    "trial.duration_s": 0.5,
    "trial.release_s": 0.01,
    "homing.settle_s": 0.005,
    "verdict.tail_s": 0.01,
}


@pytest.fixture(scope="module", autouse=True)
def _has_compiler() -> None:
    need_compiler()


class Session:
    """One armed device and the thread that supervises it; new walls are posted at given ticks of the device."""

    def __init__(self, estimator: str, posts: dict[int, float], faults: tuple[FrameFault, ...] = ()) -> None:
        self.experiment = config.override(
            presets.load("koul-compliant"), {**EXCITED, "controller.estimator": estimator}
        )
        x = self.experiment
        happenings = tuple(
            Happening(tick, lambda _, stiffness=stiffness: self.post(stiffness))
            for tick, stiffness in posts.items()
        )
        model = config.rig_model(x)
        self.device = FirmwareDevice(model, initial_position=x.trial.start)
        self.link = MemoryLink(self.device, Faults(frames=faults, device=happenings))
        self.host = FramedDevice(self.link)
        self.arithmetic = device_law.arithmetic_of(x.controller)
        quantum = self.host.dictionary.current_quantum_a
        self.bundle, armed = (controller.for_experiment(x, current_quantum_a=quantum) for _ in range(2))
        parameters = controller.prepare_controller(
            x, current_quantum_a=quantum, reference_count=0, verified=True
        ).parameters
        self.echo = self.host.configure(parameters)
        self.memory = Ring.allocate(20_000)
        settings = LoopSettings(
            period_ns=10**9 // RATE, session=self.host.arm(), lifetime_us=20_000, lost_after_ns=50_000_000,
            device_tick_ps=62_500, current_quantum_a=quantum, wait_for_room=False,
            exchange_every_ns=exchange.EVERY_NS, supervise_every_ns=5_000_000,
            batch_samples=int(parameters["batch_samples"]), agreement_quanta=BOUNDS[self.arithmetic],
        )  # fmt: skip
        self.thread = SupervisedThread(
            self.link, self.bundle, settings, self.memory, nonce=self.host.nonce,
            live=partial(device_law.live_parameters, armed, self.arithmetic),
        )  # fmt: skip

    def post(self, stiffness: float) -> None:
        values = [self.experiment.wall.position, *self.bundle.law.parameters.tolist()]
        values[1] = stiffness
        self.memory.post(values)
        self.thread._attend()

    def run(self) -> np.ndarray:
        self.thread.start()
        self.thread._thread.join(WAIT_S)
        assert self.thread._ended.is_set()
        self.host.take_back(**self.thread.handover())
        self.host.stop()
        self.host.disarm(clear_fault=True)
        return self.memory.rows[: self.memory.get(control_words.HEAD)]


def replayed(session: Session, rows: np.ndarray) -> np.ndarray:
    fresh = controller.for_experiment(
        session.experiment, current_quantum_a=session.host.dictionary.current_quantum_a
    )
    sets = np.array(
        [[s["tick"], s["wall_position"], *s["parameters"]] for s in session.thread.parameter_sets()]
    )
    again = rows.copy()
    replay_rows(fresh.arguments(), rows, again, sets)
    return again


HOMING, FLYING, PRESSED = 200, 900, 2500  # ticks since the device started


def check(session: Session, rows: np.ndarray) -> None:
    """Check that device and host had the same wall in every tick, and that the rows record which."""
    found = session.thread.agreement()
    assert (found.beyond, found.holds) == (0, True), found
    assert found.compared > 0.7 * len(rows)
    again = replayed(session, rows)
    for name in COMPUTED:
        assert again[name][:-1].tobytes() == rows[name][:-1].tobytes(), name


@pytest.mark.parametrize("estimator", ["fdm-butterworth-fixed", "fdm-butterworth"])
def test_walls_change_on_both_sides_at_one_sample(estimator: str) -> None:
    session = Session(estimator, {HOMING: 500.0, FLYING: 150.0, PRESSED: 900.0})
    rows = session.run()
    assert session.thread.end().reason == EndReason.FINISHED
    assert session.thread.messages() == []
    check(session, rows)
    first, second, *third = session.thread.parameter_sets()
    assert (first["parameters"][0], second["parameters"][0]) == (500.0, 150.0)
    pressed = (rows["parameter_set"] == second["number"]) & (rows["penetration"] > 0.0)
    assert np.count_nonzero(pressed & (rows["phase"] == Phase.TRIAL)) > 100, "the second wall was felt"
    for change in third:  # only if the handle came out of the wall again
        assert rows["penetration"][change["tick"]] <= 0.0
    there = device_law.rendered_wall(session.host.active_parameters(), session.bundle)
    assert there.stiffness == pytest.approx([first, second, *third][-1]["parameters"][0], rel=1e-7)


@pytest.mark.exhaustive("::test_walls_change_on_both_sides_at_one_sample")
@pytest.mark.parametrize(
    "kind", [FaultKind.DROP, FaultKind.CORRUPT, FaultKind.DUPLICATE, FaultKind.REORDER, FaultKind.DELAY]
)
@pytest.mark.parametrize("way", Direction)
def test_after_a_fault_in_the_update_both_sides_have_the_same_wall(kind: FaultKind, way: Direction) -> None:
    """Each frame of the update suffers the fault once; a lost frame is sent again."""
    Session("fdm-butterworth-fixed", {})  # reads the dictionary, which is cached
    clean = Session("fdm-butterworth-fixed", {HOMING: 150.0})
    line = clean.link.line
    assert line is not None
    begun: list[dict[Direction, int]] = []
    attend = clean.thread._attend
    clean.thread._attend = lambda: (attend(), begun.append(dict(line.frames)))  # type: ignore[assignment,func-returns-value]
    clean.run()
    for frame in range(begun[0][way], begun[0][way] + 7):
        fault = FrameFault(kind=kind, direction=way, frame=frame, byte=frame, bit=frame % 8, ticks=60)
        session = Session("fdm-butterworth-fixed", {HOMING: 150.0}, (fault,))
        rows = session.run()
        assert session.thread.end().reason == EndReason.FINISHED
        assert len(session.thread.parameter_sets()) == 1, frame
        check(session, rows)
