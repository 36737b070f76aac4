"""The duties of the Pico's port, tested on the whole image with outputs wired to inputs and a flowing current."""

from rig.core.check import Outcome
from rig.devices.device import DeviceUrl
from rig.firmware._build import PORT_CHECK
from rig.firmware._port_check import PortCheckRequest, check_port
from tests.firmware.rp2040 import emulator

# 268 s of an emulated board, until bit 32 of its time changes, would take hours.
REQUEST = PortCheckRequest(current=400, wired=True, seconds=0.05, bootloader=True)
UNSEEN = {"time width"}


class Link(emulator.PicoLink):
    """A serial line that survives resets of the board."""

    url = DeviceUrl("emulated", "pico", {}, "emulated://pico")  # type: ignore[assignment]

    def failure(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_the_pico_keeps_every_duty_that_can_be_seen() -> None:
    model = emulator.built("usual")[0]
    built = emulator.image(model, PORT_CHECK)
    with emulator.Pico(model, built.bin) as pico:
        pico.ask("loop")
        link = Link(pico)
        found = check_port(lambda: link, REQUEST)  # type: ignore[arg-type, return-value]
        look = pico.look()
    not_ok = {one.name: one.text for one in found.checks if one.outcome is not Outcome.OK}
    assert set(not_ok) == UNSEEN, not_ok
    assert look["resets"] == 3  # two bites, and the way into the boot loader
    assert look["bootloader"]
    assert not look["enabled"]
