"""`rig firmware selftest` on the whole binary: the reported values, and a law that is too slow for the board."""

from collections.abc import Callable

from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.devices.device import DeviceUrl
from rig.devices.framed import FramedDevice
from rig.firmware import _selftest as selftest
from tests.firmware.rp2040.emulator import PRESET
from tests.firmware.rp2040.session import Session

FLOAT32 = presets.load(PRESET)
INTEGERS = config.override(FLOAT32, {"controller.estimator": "fdm-butterworth-fixed"})
TOO_FAST = config.override(FLOAT32, {"controller.position_rate": 50_000, "controller.velocity_rate": 5_000})


def device_of(session: Session) -> FramedDevice:
    session.link.url = DeviceUrl.parse("emulated://pico")  # type: ignore[assignment]
    return FramedDevice(session.link)  # type: ignore[arg-type]


def test_the_board_passes_its_own_self_test(powered: Callable[..., Session]) -> None:
    session = powered(position=0.0)
    request = selftest.SelfTestRequest(experiment=INTEGERS, rate=20_000, seconds=0.04, stream=True)
    found = {check.name: check for check in selftest.selftest(device_of(session), request).checks}
    assert [check for check in found.values() if check.outcome == "refused"] == []
    assert found["stream"].outcome == "ok"
    assert session.pico.look()["overruns"] == 0


def test_a_law_that_is_too_slow_for_the_board_is_found_before_anything_moves(
    powered: Callable[..., Session],
) -> None:
    request = selftest.SelfTestRequest(experiment=TOO_FAST, seconds=0.01, stream=True)
    check = selftest._stream(device_of(powered(position=0.0)), request)
    assert check.outcome == "refused"
    assert Fault.TICK_OVERRUN.text in check.text
