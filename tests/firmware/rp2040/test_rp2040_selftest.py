"""`rig firmware selftest` and `check-port` on whole images, the latter with outputs wired to inputs and a current."""

from collections.abc import Callable

from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.check import Outcome
from rig.devices.framed import FramedDevice
from rig.firmware import _selftest as selftest
from rig.firmware._build import PORT_CHECK
from rig.firmware._port_check import PortCheckRequest, check_port
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.emulator import PRESET
from tests.firmware.rp2040.session import Session

FLOAT32 = presets.load(PRESET)
INTEGERS = config.override(FLOAT32, {"controller.estimator": "fdm-butterworth-fixed"})
TOO_FAST = config.override(FLOAT32, {"controller.position_rate": 50_000, "controller.velocity_rate": 5_000})


def device_of(session: Session) -> FramedDevice:
    return FramedDevice(session.link)


def test_the_board_passes_its_own_self_test(powered: Callable[..., Session]) -> None:
    session = powered(position=0.0)
    request = selftest.SelfTestRequest(experiment=INTEGERS, rate=20_000, seconds=0.03, stream=True)
    found = {check.name: check for check in selftest.selftest(device_of(session), request).checks}
    assert [check for check in found.values() if check.outcome == "refused"] == []
    assert found["stream"].outcome == "ok"
    assert session.pico.look()["overruns"] == 0


def test_a_law_too_slow_for_the_board_is_found_before_anything_moves(powered: Callable[..., Session]) -> None:
    request = selftest.SelfTestRequest(experiment=TOO_FAST, seconds=0.01, stream=True)
    check = selftest._stream(device_of(powered(position=0.0)), request)
    assert check.outcome == "refused"
    assert Fault.TICK_OVERRUN.text in check.text


# ---------------------------------------------------------------------- the duties of the port


# 268 s of an emulated board, until bit 32 of its time changes, would take hours.
REQUEST = PortCheckRequest(current=400, wired=True, seconds=0.05, bootloader=True)
UNSEEN = {"time width"}


def test_the_pico_keeps_every_duty_that_can_be_seen() -> None:
    model = emulator.built("usual")[0]
    built = emulator.image(model, PORT_CHECK)
    with emulator.Pico(model, built.bin) as pico:
        pico.ask("loop")
        link = emulator.PicoLink(pico)
        found = check_port(lambda: link, REQUEST)
        look = pico.look()
    not_ok = {one.name: one.text for one in found.checks if one.outcome is not Outcome.OK}
    assert set(not_ok) == UNSEEN, not_ok
    assert look["resets"] == 3  # two bites, and the way into the boot loader
    assert look["bootloader"]
    assert not look["enabled"]
