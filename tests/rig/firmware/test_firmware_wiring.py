"""The reference rig's netlist: its pins are the board's, none gets 5 V, and the drawing matches."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from rig.core.errors import ConfigError
from rig.firmware import _boards as boards
from rig.firmware._wiring import Wiring, WiringPart, svg, wiring

BOARD = boards.load("rp2040")
SETTINGS = boards.settings_of(BOARD, {})
FOUND = wiring(BOARD, SETTINGS)
CHOSEN = {output: boards.settings_of(BOARD, {"output": output}) for output in ("pwm", "dac")}
ALONE = {"SYNC IN", "TRIAL", "INSIDE"}  # free for other equipment


def part(name: str, found: Wiring = FOUND) -> WiringPart:
    return next(one for one in found.parts if one.name == name)


def pins(name: str, found: Wiring = FOUND) -> dict[str, str]:
    return {pin.name: pin.net for pin in (*part(name, found).left, *part(name, found).right)}


@pytest.mark.parametrize("output", CHOSEN)
def test_every_net_joins_something_and_every_pin_of_the_board_is_wired(output: str) -> None:
    settings = CHOSEN[output]
    found = wiring(BOARD, settings)
    assert {net for net, joined in found.nets().items() if len(joined) == 1} == ALONE
    used = {name.split()[0] for name in pins("U1", found) if name.startswith("GPIO")}
    wanted = {
        int(settings[name]) + next_one
        for name, setting in BOARD.settings.items()
        for next_one in range(setting.pins)
        if setting.where.get("output", output) == output
        if name != "pwm_pin" or next_one == 0  # the amplifier of an offset set-point has no direction
    }
    assert used == {f"GPIO{number}" for number in (*wanted, 26)}


def test_the_line_that_switches_the_amplifier_off_holds_the_converter_in_reset_too() -> None:
    """The line is taken after monostable and dead-man contact, at the resistor to ground, not at the board."""
    nets = wiring(BOARD, CHOSEN["dac"]).nets()
    assert {"U5.RESET", "AMP.DigIN2 (enable)", "R1.2"} <= set(nets["ENABLE HELD"])
    assert set(nets["SET POINT"]) == {"U5.VOUT", "AMP.AnIN1+"}


def test_no_five_volts_reach_a_pin_of_the_board() -> None:
    tolerant = {"ENC", "RT", "U2"}
    for net in ("A5", "/A5", "B5", "/B5"):
        assert {name.partition(".")[0] for name in FOUND.nets()[net]} <= tolerant
    assert [name for name in FOUND.nets()["5V"] if name.startswith("U1.")] == ["U1.VBUS"]


def test_a_pin_that_moves_moves_in_the_drawing_and_a_board_without_wiring_is_refused(tmp_path: Path) -> None:
    moved = wiring(BOARD, boards.settings_of(BOARD, {"enable_pin": 6 + 14}))
    assert "U1.GPIO20 enable" in moved.nets()["ENABLE"]
    texts = [one.text for one in ElementTree.fromstring(svg(moved)).iter() if one.text]
    assert "GPIO20 enable" in texts
    with pytest.raises(ConfigError, match=r"mps2 has no wiring\.toml"):
        wiring(boards.load("mps2"), {})


def test_the_drawing_beside_the_netlist_is_fresh() -> None:
    assert (BOARD.directory / "wiring.svg").read_text(encoding="utf-8") == svg(FOUND)


def test_the_monitors_divider_gives_the_boards_zero() -> None:
    """1.65 V at zero current, and 0.05 to 3.25 V for ±4 V of the amplifier, within a percent."""
    from_amplifier, to_supply, to_ground = 10e3, 8.06e3, 40.2e3
    sum_of = 1 / from_amplifier + 1 / to_supply + 1 / to_ground
    low, zero, high = ((v / from_amplifier + 3.3 / to_supply) / sum_of for v in (-4.0, 0.0, 4.0))
    assert zero == pytest.approx(float(SETTINGS["monitor_zero"]), rel=0.01)
    assert 0.0 < low < 0.1
    assert 3.2 < high < 3.3
    for text in ("10 kΩ", "8.06 kΩ", "40.2 kΩ"):
        assert text in part("RM").what
