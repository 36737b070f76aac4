"""The serial link for systems other than Linux, on pseudo-terminals: the same contract, also with a law on a board."""

import errno
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import serial

from firmware_protocol import messages as m
from firmware_protocol.faults import LimitFlag
from firmware_protocol.framing import decode_frame
from firmware_protocol.messages import STOP_FRAMES
from firmware_protocol.packing import unpack
from rig import config, devices
from rig.config import Experiment, presets
from rig.core.errors import ConfigError, DeviceNotFoundError, LinkLostError, StoppedError
from rig.core.sample import Phase
from rig.devices import _threaded_serial as threaded_serial
from rig.devices._threaded_serial import ThreadedSerialLink, open_link
from rig.devices.device import DeviceUrl
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.recording.reader import open_recording
from tests.conformance.device import check_device
from tests.conformance.firmware import need_compiler
from tests.conformance.link import check_link
from tests.conformance.served import served_rig

SLACK_S = 5.0  # of a loaded machine
RATE_HZ = 5000


def opened(path: str, query: str = "") -> ThreadedSerialLink:
    return open_link(DeviceUrl.parse(f"serial://{path}{query}"))


@pytest.fixture(autouse=True)
def _patient_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a port accept no bytes for longer: pyserial also gives up when it was halted for as long after a write."""
    monkeypatch.setattr(threaded_serial, "BUFFER_S", SLACK_S)


@pytest.fixture
def board() -> Iterator[Callable[..., str]]:
    """Yield a function that serves a rig behind a pseudo-terminal and returns its path."""
    with ExitStack() as running:
        yield lambda model=None, **options: running.enter_context(served_rig(model, **options))


def test_it_conforms_as_a_link(board: Any, line: Any) -> None:
    path = board()
    check_link(lambda: opened(path), lambda: opened(line.path), slack_s=SLACK_S)


@pytest.mark.quiet  # a host that is halted for longer than a command's lifetime makes the device fault
def test_the_rig_behind_it_conforms_as_a_device(board: Any) -> None:
    path = board()
    check_device(lambda: opened(path), starts_in_boot=False)


def test_a_port_that_does_not_open_is_one_error(line: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    first = opened(line.path)
    with pytest.raises(DeviceNotFoundError, match="in use by another program"):
        opened(line.path)
    first.close()
    with pytest.raises(DeviceNotFoundError, match="there is no port /dev/nothere"):
        opened("/dev/nothere")
    with pytest.raises(ConfigError, match="baud"):
        opened(line.path, "?baud=fast")
    for text, words in (  # of pyserial on Windows
        ("could not open port 'COM7': FileNotFoundError(2, …)", "there is no port"),
        ("could not open port 'COM3': PermissionError(13, …)", "in use"),
        ("Cannot configure port, something went wrong", "cannot open"),
    ):
        with monkeypatch.context() as patched:

            def refuse(port: Any, text: str = text) -> None:
                raise serial.SerialException(text)

            patched.setattr(serial.Serial, "open", refuse)
            with pytest.raises(DeviceNotFoundError, match=words):
                opened("COM3")


def test_dtr_and_rts_are_set_before_the_port_opens(line: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    at_opening: list[tuple[bool, bool]] = []
    true_open = serial.Serial.open

    def watched(port: Any) -> None:
        at_opening.append((port.dtr, port.rts))
        true_open(port)

    monkeypatch.setattr(serial.Serial, "open", watched)
    for query, asserted in (("", True), ("?dtr=off", False)):
        opened(line.path, query).close()
        assert at_opening.pop() == (asserted, asserted)


def test_an_error_without_a_number_is_an_unplugged_port(line: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    link = opened(line.path)

    def gone(port: Any, data: bytes) -> int:
        raise serial.SerialException("WriteFile failed (PermissionError(13, …))")

    monkeypatch.setattr(serial.Serial, "write", gone)
    with pytest.raises(LinkLostError, match="unplugged") as caught:
        link.write(b"x")
    assert caught.value.__cause__.errno == errno.ENODEV  # type: ignore[union-attr]
    link.close()


# ---------------------------------------------------------------------- the law on the board


def on_the_board() -> Experiment:
    keys = {"loop": "device", "position_rate": RATE_HZ, "velocity_rate": RATE_HZ // 10}
    changes = {f"controller.{key}": value for key, value in (keys | {"supervise_lifetime_s": 0.1}).items()}
    changes |= {"wall.stiffness": 60.0, "wall.damping": 0.05, "trial.duration_s": 0.6}
    return config.override(presets.load("koul-rigid"), changes)


@pytest.mark.quiet
def test_a_law_on_the_board_runs_through_it_and_a_stop_is_sent_not_awaited(
    board: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A board without commands continues for the longest lifetime, so STOP is sent at once, and again."""
    need_compiler()
    monkeypatch.setitem(devices.BUILT_IN, "serial", "rig.devices._threaded_serial:open_link")
    sent: list[bytes] = []
    true_send = threaded_serial._Line.send
    monkeypatch.setattr(
        threaded_serial._Line, "send", lambda line, data: (sent.append(data), true_send(line, data))[1]
    )
    experiment = on_the_board()
    url = f"serial://{board(config.rig_model(experiment), rate=RATE_HZ, firmware=True)}"
    request = HitRequest(experiment=experiment, url=url, output=tmp_path, realtime=True)

    def stop_it(ticks: int, phase: int) -> None:
        if phase == Phase.TRIAL:
            raise StoppedError("enough")

    (result,) = hit(request, admit)
    sent.clear()
    with pytest.raises(StoppedError) as caught:
        list(hit(request, admit, lambda repeat, running: stop_it))
    assert result.verdict.kind == "stable"
    assert result.experiment.controller.supervise_lifetime_s == 0.1
    recording = open_recording(caught.value.recording)  # type: ignore[arg-type]
    assert recording.trailer["fault"] is None
    assert not (recording.column("limits") & LimitFlag.RAMPING).any()
    modes = [one.mode for one in frames_of(b"".join(sent)) if isinstance(one, m.Command)]
    stops = modes.index(m.Mode.STOP)
    assert set(modes[:stops]) == {m.Mode.SUPERVISE}
    assert set(modes[stops:]) == {m.Mode.STOP}
    assert len(modes) - stops >= STOP_FRAMES


def frames_of(data: bytes) -> list[object]:
    return [unpack(decode_frame(frame))[1] for frame in data.split(b"\0") if frame]
