"""`rig doctor` and the checks before `rig hit`; devices are simulated, and some claim to be real."""

import dataclasses
import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import presets
from rig.core.check import Check, Outcome
from rig.core.errors import RealtimeError
from rig.devices import port_facts
from rig.devices.port_facts import PortFacts
from rig.doctor import _ports as ports
from rig.doctor import _round_trip as round_trip
from rig.doctor import gate
from rig.experiments.hits import examine as examining
from rig.recording.quantiles import Distribution
from rig.recording.reader import open_recording
from tests.conformance.claimed import claim_to_be_real
from tests.conformance.served import served_rig

QUICK = ("--seconds", "0.1", "--set", "host.realtime=off")


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the checks of the machine by one warning."""
    check = Check("governor", Outcome.WARNING, "powersave", "sudo set it", "clocks that ramp")
    monkeypatch.setattr(examining, "machine_checks", lambda host: [check])
    monkeypatch.setattr(ports, "available_ports", lambda: [])
    monkeypatch.setattr("rig.doctor._ports.available_devices", lambda: [])
    monkeypatch.setattr(gate, "LONGEST_S", 0.1)  # of measuring: a hit at 20 kHz does so for 1 s


@pytest.fixture
def port() -> Iterator[Any]:
    """Serve a simulated rig behind a pseudo-terminal and yield its URL."""
    with served_rig(config.rig_model(presets.load("koul-compliant")), rate=1000) as path:
        yield f"serial://{path}"


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> None:
    claim_to_be_real(monkeypatch)


@pytest.fixture
def quiet_link(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the measured round trip by half a millisecond without losses, however busy this machine is."""
    original = round_trip.measure_link

    def measured(*arguments: Any, **options: Any) -> Any:
        found = original(*arguments, **options)
        return dataclasses.replace(found, travel_s=Distribution.of(np.full(4000, 5e-4)), lost=0)

    for module in (examining, gate):
        monkeypatch.setattr(module, "measure_link", measured)


@pytest.fixture
def no_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the table of walls that a link supports, which takes most of the time."""
    monkeypatch.setattr(examining, "supported_walls", lambda *_: [])


def test_without_a_device_it_checks_machine_and_ports(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    facts = PortFacts(
        port="/dev/ttyUSB0", device="/dev/ttyUSB0", driver="ftdi_sio", ftdi=True, latency_timer_ms=16
    )
    monkeypatch.setattr(ports, "available_ports", lambda: [("/dev/ttyUSB0", "FT232R")])
    monkeypatch.setattr(ports, "port_facts", lambda name: facts)
    code, out, err = run("doctor")
    assert code == 0
    for text in (
        "governor: powersave",
        "clocks that ramp",
        "sudo set it",
        "serial:///dev/ttyUSB0",
        "FT232R",
        "16 ms",
    ):
        assert text in out
    assert f"echo 1 | sudo tee {port_facts.latency_timer_path('/dev/ttyUSB0')}" in out
    assert "examining the machine" in err
    for absent in ("round trip", "arming", "walls"):
        assert absent not in out


def test_a_device_behind_a_port(run: Any, port: Any, quiet_link: Any) -> None:
    code, out, err = run("doctor", "--url", port, "--rig", "koul-compliant", *QUICK)
    assert code == 0  # a simulated device is never refused
    assert "no serial port" not in out, "a rig answers over one"
    assert f"{port}\n" in out or f"{port} " in out
    for text in ("koul-compliant, simulated", "uniform 1 kHz", "dual 1/0.1 kHz", "uniform 4 kHz", "B = 0.2"):
        assert text in out
    for text in ("identifying the device", "measuring the link", "computing walls"):
        assert text in err


def test_a_wall_that_must_not_be_armed_on_a_real_rig_is_an_error(
    run: Any, real: None, port: Any, quiet_link: Any, no_walls: None
) -> None:
    code, out, err = run("doctor", "--url", port, *QUICK)
    assert code == 0, err
    assert "may be armed" in out
    code, out, err = run("doctor", "--url", port, "-K", "300", "--json", *QUICK)
    assert code == 2
    assert "--stiffness below" in err
    found = json.loads(out)
    assert found["armable"] is False
    refused = [one for one in found["gate"]["checks"] if one["outcome"] == "refused"]
    assert [one["name"] for one in refused] == ["stability"]
    assert "unstable at 1000 Hz with 1 tick of delay" in refused[0]["text"]
    assert "--stiffness below" in refused[0]["remedy"]


def test_scheduling_that_is_required_and_refused_forbids_arming(
    run: Any, real: None, port: Any, quiet_link: Any, no_walls: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = examining.obtained

    def obtained(host: Any, *, virtual: Any) -> Any:
        if host.realtime == "enforce":
            raise RealtimeError("no SCHED_FIFO here", remedy="sudo grant it")
        return original(host, virtual=virtual)

    monkeypatch.setattr(examining, "obtained", obtained)
    code, out, err = run("doctor", "--url", port, "--seconds", "0.1", "--set", "host.realtime=enforce")
    assert code == 2
    assert "real-time scheduling: no SCHED_FIFO here" in out
    assert "round trip" in out
    assert "sudo grant it" in err


def test_a_missing_device_does_not_hide_the_checks_of_the_machine(run: Any) -> None:
    code, out, err = run("doctor", "--url", "serial:///dev/nothere", *QUICK)
    assert code == 3
    assert "governor" in out
    assert "there is no port /dev/nothere" in err
    code, out, _ = run("doctor", "--url", "serial:///dev/nothere", "--json", *QUICK)
    assert code == 3
    found = json.loads(out)
    assert found["error"]["kind"] == "DeviceNotFoundError"
    assert found["checks"]


# ---------------------------------------------------------------------- rig hit

HIT = shlex.split("hit --no-plot --verified --duration 0.1 --set verdict.tail_s=0.05 --set host.realtime=off")


@pytest.mark.exhaustive("tests/rig/experiments/test_admission.py::test_doctor_gate_and_hit_agree")
def test_arm_anyway_arms_and_is_reported_and_recorded(
    run: Any, real: None, port: Any, quiet_link: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(gate, "LOST_SHARE", -1.0)  # no link is good enough, though the wall is calm
    code, _, err = run(*HIT, "--url", port)
    assert (code, "--arm-anyway" in err, list(tmp_path.iterdir())) == (2, True, [])
    code, _, err = run(*HIT, "--url", port, "--arm-anyway")
    assert code in (0, 6, 7, 10)  # in real time, on whatever machine this is
    (recording,) = (*tmp_path.rglob("*.rigcap"), *tmp_path.rglob("*.parquet"))
    result = open_recording(recording).header["extra"]["gate"]
    assert (result["forced"], result["armable"]) == (True, False)
    assert [one["name"] for one in result["checks"] if one["outcome"] == "refused"] == ["losses"]
    assert "arming despite the warning (--arm-anyway)" in err, "before it arms, however the run ends"
