"""The firmware's own USB registers on an emulated board, with pyusb, libusb, Linux and USB/IP; no time is asserted."""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import messages as m
from rig import config
from rig.config import presets
from rig.config.controller import prepare_controller
from rig.devices import open_device, open_link
from rig.devices.usb import available_devices
from rig.experiments.trials import _trial as trial
from rig.recording.reader import open_recording
from tests.conformance.host import Host
from tests.guest import pico, vhci
from tests.guest.hits import check_recorded, whole_hit
from tests.guest.pico_port import plugged_pico, port

WHY = os.environ.get("HAPTIC_RIG_NO_PICO") or "no emulated board here: run .ci/guest"
pytestmark = pytest.mark.skipif(not vhci.is_here() or port() is None, reason=WHY)

BATCHES = 5
LONG_S = 60.0
WORD_S = 0.005
PATIENCE_S = 5.0
SAMPLE_BYTES = 5  # of the layout with the measured current


@pytest.fixture(scope="module")
def board() -> Iterator[Any]:
    with plugged_pico() as made:
        yield made


def test_linux_makes_a_serial_port_of_it_and_rig_speaks_there(board: Any) -> None:
    # First, since the vendor interface keeps the link for a second of the board.
    vhci.wait_until("the board has a terminal", lambda: board.tty is not None)
    vhci.settle()
    with open_device(f"serial://{board.tty}") as device:
        assert device.dictionary.device == pico.RIG


def test_rig_finds_it_and_reads_its_dictionary(board: Any) -> None:
    assert board.url in {device.url for device in available_devices() if device.is_rig}
    with open_device(board.url) as device:
        assert device.dictionary.device == pico.RIG


def supervise_until(host: Host, frames: int) -> list[m.Batch]:
    batches: list[m.Batch] = []
    deadline = time.monotonic() + LONG_S
    while len(batches) < frames:
        assert time.monotonic() < deadline
        host.command(mode=m.Mode.SUPERVISE)
        batches += [event.message for event in host.events(WORD_S) if isinstance(event.message, m.Batch)]
    return batches


def check_at_rest(board: Any) -> None:
    """Require that the board's pins show no current and a disabled amplifier."""
    vhci.wait_until("the board is disabled", lambda: not board.status()["enabled"])
    status = board.status()
    assert status["current"] == 0
    assert status["resets"] == 0
    assert status["errors"] == []
    assert status["complaints"] == {}


def test_a_law_on_the_board_sends_its_ticks_and_leaves_no_current(board: Any) -> None:
    experiment = config.override(presets.load(pico.RIG), pico.CHANGES)
    quantum = experiment.rig.amplifier.current_quantum_a
    law = prepare_controller(
        experiment, current_quantum_a=quantum, reference_count=0, verified=True
    ).parameters
    link = open_link(board.url)
    try:
        host = Host(link)
        host.begin(**{**law, "batch_samples": 10})
        batches = supervise_until(host, BATCHES)
        host.command(mode=m.Mode.STOP)
        assert host.disarm().status == 0
    finally:
        link.close()
    sizes = [len(batch.data) // SAMPLE_BYTES for batch in batches]
    ends = [batch.first_index + size for batch, size in zip(batches, sizes, strict=True)]
    assert [batch.first_index for batch in batches[1:]] == ends[:-1]
    check_at_rest(board)


def test_a_whole_hit_with_the_law_on_the_board(
    board: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run ``rig hit --loop device --url usb://…``: the board runs the wall, and this kernel transfers its ticks.

    A second of the board takes many of ours, so the silence that ends a run is longer than on a real one.
    """
    monkeypatch.setattr(trial, "LOST_AFTER_S", PATIENCE_S)
    experiment = config.with_realtime(presets.load(pico.RIG))
    ended = whole_hit(board.url, tmp_path, experiment, pico.CHANGES, verified=True)
    print(f"{ended.wall_s:.1f} s: {type(ended.error).__name__}: {ended.error}; {board.status()}")
    check_at_rest(board)
    check_recorded(ended)
    recording = open_recording(ended.path)
    print(f"{len(recording.rows)} ticks, {recording.trailer['device_host_agreement']}")
    assert recording.trailer["device_host_agreement"]["holds"]
    assert len(recording.rows) > 0
    assert board.status()["strongest"] > 0
