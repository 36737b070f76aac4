"""The same lab tests on a real rig: consent, one process, one open device, its zero, and STOP however the run ends.

Devices here claim to be real. Most run in virtual time behind a patched opener; one is behind a port.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import rig
import rig.testing.hits
import rig.testing.served
from firmware_protocol.connection import State
from rig import config, devices
from rig.config import presets
from rig.core.model import RigModel
from rig.devices.framed import FramedDevice
from rig.realtime import control_words
from rig.realtime.ring import Ring
from rig.testing import Experiments, SerialRig, serve_rig
from sim_backend.board.make_device import make_device
from sim_backend.ends.link import MemoryLink
from tests.conformance.claimed import claim_to_be_real
from tests.conformance.served import served_rig
from tests.conformance.tiers import first_by_default

URL = "serial:///dev/ttyRIG"
TYPED = ("--rig-url", URL, "--rig-verified", "-n0")


class Bench:
    """A simulated rig on a bench, which keeps running when hosts disconnect."""

    def __init__(self) -> None:
        self.device, _ = make_device(config.rig_model(presets.load("koul-compliant")), None)
        self.opened = 0
        self.link: Any = None

    def open(self, url: str, model: object = None) -> FramedDevice:
        assert url == URL
        self.opened += 1
        self.link = MemoryLink(self.device)
        return FramedDevice(self.link)

    @property
    def at_rest(self) -> bool:
        return self.device.current == 0 and self.device.state not in (State.ARMED, State.RUNNING)


@pytest.fixture
def bench(suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Bench:
    claim_to_be_real(monkeypatch)
    made = Bench()
    monkeypatch.setattr(devices, "open_device", made.open)
    return made


@pytest.mark.parametrize(
    ("typed", "refusal"),
    [
        (("--rig-url", URL), "tests would move serial:///dev/ttyRIG: check the signs*type --rig-verified*"),
        (("--rig-url", URL, "--rig-verified", "-n2"), "*several processes: add -n0"),
    ],
)
def test_a_rig_moves_only_for_one_process_and_a_typed_word(
    typed: tuple[str, ...], refusal: str, bench: Bench, pytester: pytest.Pytester
) -> None:
    pytester.makepyfile("def test_it(rig_hit): rig_hit()")
    settings = pytester.path / "tox.ini"
    settings.write_text(f"{settings.read_text()} --rig-verified")  # a file is not a person's consent
    result = pytester.runpytest_inprocess(*typed)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([f"ERROR: {refusal}"])
    assert bench.opened == 0


def test_tests_share_one_open_device_and_its_position_zero(
    bench: Bench, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    zeros: list[int] = []
    monkeypatch.setattr(
        rig.testing.hits, "position_zero", lambda device, x: zeros.append(device.count()) or zeros[0]
    )
    pytester.makepyfile(
        """
        import pytest
        from rig.testing import assert_safe

        @pytest.mark.parametrize("again", range(2))
        def test_it(again, rig_hit, rig_experiment, rig_device):
            hit = rig_hit(rig_experiment.short())
            assert_safe(hit, within_ms=20.0)
            assert hit.recording.header["identity"]["parameters"]["reference_count"] == 0
            assert not hit.recording.header["identity"]["simulated"]

        def test_of_faults(rig_hit, rig_faults): raise AssertionError

        def test_of_gold(rig_hit, rig_golden): raise AssertionError

        @pytest.mark.rig_every_frame("drop")
        def test_of_frames(rig_hit): raise AssertionError
        """
    )
    result = pytester.runpytest_inprocess(*TYPED, "-rs")
    result.assert_outcomes(passed=2, skipped=3)
    result.stdout.fnmatch_lines(
        [f"SKIPPED * rig_faults: faults on command need a simulated rig, and the rig is {URL}"]
    )
    assert bench.opened == 1
    assert zeros == [0], "where the handle stood first; a hit leaves it elsewhere"
    assert bench.at_rest


@pytest.mark.parametrize(
    ("ending", "message"),
    first_by_default(
        [
            ("assert False", "assert False"),
            ("raise KeyboardInterrupt", "! KeyboardInterrupt !"),
            ("pytest.exit('enough')", "! _pytest.outcomes.Exit: enough !"),
            ("signal.raise_signal(signal.SIGALRM)", "Timeout (>60.0s)"),  # which says that its time is over
        ],
        2,
    ),
)
def test_however_a_test_ends_the_host_sends_its_rig_stop(
    ending: str, message: str, bench: Bench, pytester: pytest.Pytester
) -> None:
    pytester.makepyfile(
        f"""
        import signal
        import pytest

        @pytest.mark.timeout(60.0, method="signal")
        def test_it(rig_hit, rig_experiment, rig_device):
            rig_hit(rig_experiment.short())
            rig_device.arm()
            {ending}
        """
    )
    result = pytester.runpytest_inprocess(*TYPED, no_reraise_ctrlc=True)
    assert message in result.stdout.str()
    assert bench.at_rest
    assert bench.device.fault == 0, "it was disarmed, not left to its watchdog"
    with pytest.raises(rig.RigError, match="closed"):
        bench.link.read(0.0)


@pytest.mark.parametrize("answers", [["", "", "q"], []], ids=["not to the third", "no terminal"])
def test_a_person_agrees_to_each_hit_of_a_map(
    answers: list[str], bench: Bench, suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    given = iter(answers)

    def answer(text: str) -> str:
        asked.append(text)
        if (found := next(given, None)) is None:
            raise EOFError
        return found

    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr("rig.experiments.mapping._zwidth_rig.CALM_S", 0.0)
    suite.makepyfile(
        """
        def test_it(rig_zwidth):
            rig_zwidth(None, {"controller.position_rate": 1000, "controller.velocity_rate": 1000},
                       schemes=["uniform:1k"], dampings=[0.2], lowest=20.0, highest=30.0)
        """
    )
    result = suite.runpytest_inprocess(*TYPED)
    assert result.ret == 130
    result.stdout.fnmatch_lines(["*Exit: *0 of 1 series are done*"])
    assert len(asked) == max(1, len(answers))
    assert "B = 0.2, K = 20, hit 1 of series 1 of 1" in asked[0]
    assert bench.opened == 1
    assert bench.at_rest


def test_without_a_persons_consent_no_torque_pulse_moves_the_rig(
    bench: Bench, suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr("builtins.input", lambda text: asked.append(text) or "q")
    suite.makepyfile(
        """
        def test_it(rig_hit):
            person = {"trial.kind": "human", "rig.limits.human": True, "rig.limits.effort": 0.28,
                      "rig.limits.override_stall": True, "operator.press": 1.0, "wall.stiffness": 60.0,
                      "wall.damping": 0.1, "controller.position_rate": 2000, "controller.velocity_rate": 2000,
                      "verdict.lowpass_hz": 400.0}
            rig_hit(None, person)

        def test_of_the_next(rig_hit): raise AssertionError
        """
    )
    result = suite.runpytest_inprocess(*TYPED)
    assert (result.ret, len(asked)) == (130, 1)
    result.stdout.fnmatch_lines(["*Exit: the operator did not agree to the torque pulse*"])
    result.assert_outcomes()
    assert bench.at_rest
    assert not bench.device.truth()["effort_true"].any()


@pytest.fixture(scope="module")
def served() -> Iterator[SerialRig]:
    @contextmanager
    def in_this_process(url: str, model: RigModel, *, terminal: bool) -> Iterator[str]:
        assert (url, terminal) == ("sim://", True)
        with served_rig(model) as path:
            yield f"serial://{path}"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig.testing.served, "serve_locally", in_this_process)
        with serve_rig(Experiments("koul-compliant", Path()).short()) as one:  # the handle is at its start
            yield one


@pytest.fixture
def port(served: SerialRig, suite: pytest.Pytester) -> SerialRig:
    """Serve a rig in real time behind a port, with a test suite for it."""
    suite.makepyfile(
        """
        import pytest
        import rig
        from rig.testing import assert_safe

        def test_of_the_lock(rig_device, pytestconfig):
            rig_device.identify()
            with pytest.raises(rig.RigError, match="in use"):
                rig.open_device(pytestconfig.getoption("rig_url"))

        def test_of_a_hit(rig_hit):
            short = {"homing.settle_s": 0.01, "trial.duration_s": 0.1, "verdict.tail_s": 0.05}
            hit = rig_hit(None, short, may_end=True)
            assert_safe(hit, within_ms=1000.0)  # on a busy machine the link may be lost: it is safe all the same
        """
    )
    return served


def test_a_rig_behind_a_port_is_locked_hit_and_at_rest(port: SerialRig, pytester: pytest.Pytester) -> None:
    result = pytester.runpytest_inprocess("--rig-url", port.url, "--rig-verified", "-n0")
    result.assert_outcomes(passed=2)
    did = port.did()
    assert (did.state, did.current) == (State.CONFIGURED, 0)
    assert did.statistics.frames > 10


@contextmanager
def acting_person(sees: Callable[[], bool], does: Callable[[], object]) -> Iterator[None]:
    """Call `does` once as soon as `sees` returns True, as a watching person would act."""

    def watch() -> None:
        while not over.wait(0.02):
            if sees():
                does()
                return

    over = threading.Event()
    person = threading.Thread(target=watch)
    person.start()
    try:
        yield
    finally:
        over.set()
        person.join()


@pytest.mark.parametrize("may_end", [False, True])
def test_rig_stop_ends_all_tests(
    may_end: bool, bench: Bench, suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the next test would move the rig again."""
    allocate = Ring.allocate

    def stopped(*arguments: Any, **options: Any) -> Ring:
        ring = allocate(*arguments, **options)
        ring.put(control_words.STOP, -4711)  # as process 4711 does for `rig stop`
        return ring

    monkeypatch.setattr(Ring, "allocate", stopped)
    suite.makepyfile(
        f"""
        def test_of_a_hit(rig_hit, rig_experiment): rig_hit(rig_experiment.short(), may_end={may_end})

        def test_of_the_next(rig_hit): print("the next test runs")
        """
    )
    result = suite.runpytest_inprocess(*TYPED, "-s")
    assert result.ret == 130
    result.stdout.fnmatch_lines(["*Exit: stopped by process 4711 *; the effort is zero*"])
    assert "the next test runs" not in result.stdout.str()
    assert bench.at_rest


@pytest.mark.exhaustive("::test_rig_stop_ends_all_tests")
@pytest.mark.signals
def test_ctrl_c_in_a_hit_ends_all_tests(bench: Bench, suite: pytest.Pytester) -> None:
    suite.makepyfile(
        """
        def test_of_a_long_hit(rig_hit, rig_experiment):
            rig_hit(rig_experiment.short(None, {"trial.duration_s": 1000.0}))

        def test_of_the_next(rig_hit): rig_hit()
        """
    )
    with acting_person(lambda: bench.device.sample_index > 100, lambda: os.kill(os.getpid(), signal.SIGINT)):
        result = suite.runpytest_inprocess(*TYPED)
    assert result.ret == 130
    result.stdout.fnmatch_lines(["*Exit: stopped by SIGINT; the effort is zero*"])
    assert bench.at_rest
