"""Properties of serial ports, read from sysfs trees like those of real adapters."""

import os
import pty
from pathlib import Path
from typing import Any

import pytest

from rig.devices import _tty as tty
from rig.devices import port_facts as module
from rig.devices.port_facts import PortFacts, port_facts


class Tree:
    """A directory with ``sys`` and ``dev``, in which ports are added one by one."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def plug(self, name: str, driver: str, latency: object = None, by_id: str = "", **usb: str) -> str:
        """Make the files that the kernel makes for a port; `usb` are attributes of its USB device."""
        sysfs, dev = self.root / "sys", self.root / "dev"
        device = sysfs / "devices/pci0/usb1/1-1"
        node = device / "1-1:1.0" / name if usb else sysfs / "devices/platform" / name
        drivers = sysfs / "bus/usb-serial/drivers" / driver
        links = {node / "driver": drivers, sysfs / "class/tty" / name / "device": node}
        if latency is not None:
            links[sysfs / "bus/usb-serial/devices" / name] = node
        if by_id:
            links |= {
                dev / "serial/by-id" / by_id: dev / name,
                dev / "serial/by-id/usb-another": dev / "ttyS9",
            }
        for place in (node, drivers, dev, *(link.parent for link in links)):
            place.mkdir(parents=True, exist_ok=True)
        for link, target in links.items():
            link.symlink_to(target)
        files = {device / attribute: text for attribute, text in usb.items()}
        for file, text in {**files, node / "latency_timer": latency or "none", dev / name: ""}.items():
            file.write_text(f"{text}\n")
        return str(dev / name)

    def facts(self, port: str, descriptor: int | None = None) -> PortFacts:
        return port_facts(port, descriptor, root=self.root)


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    return Tree(tmp_path)


FTDI = {"idVendor": "0403", "idProduct": "6001"}


def test_an_ftdi_adapter_with_its_timer_as_it_comes(tree: Tree) -> None:
    name, names = (
        "usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0",
        {"serial": "A50285BI", "product": "FT232R USB UART"},
    )
    facts = tree.facts(tree.plug("ttyUSB0", "ftdi_sio", 16, name, **FTDI, **names))
    assert (facts.driver, facts.vid_pid, facts.serial_number) == ("ftdi_sio", "0403:6001", "A50285BI")
    assert facts.product == "FT232R USB UART"
    assert facts.ftdi
    assert facts.latency_timer_ms == 16
    assert [os.path.basename(found) for found in facts.by_id] == [name]
    (problem,) = facts.problems()
    assert "16 ms" in problem.text
    assert problem.remedy.startswith("echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer;")
    assert "--print-udev" in problem.remedy
    assert tree.facts(facts.by_id[0]).vid_pid == "0403:6001", "the name that stays leads to the same port"


@pytest.mark.parametrize(("latency", "known_ms"), [(1, 1), ("soon", None)])
def test_an_ftdi_adapter_of_one_ms_or_without_timer_is_fine(latency: Any, known_ms: Any, tree: Tree) -> None:
    facts = tree.facts(tree.plug("ttyUSB1", "ftdi_sio", latency, **FTDI))
    assert facts.ftdi
    assert facts.latency_timer_ms == known_ms
    assert facts.problems() == []


def test_a_board_on_usb_itself_has_no_latency_mode(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tty, "low_latency", lambda descriptor: False)
    port = tree.plug("ttyACM0", "cdc_acm", idVendor="2e8a", idProduct="000a", serial="E66038B713")
    with os.fdopen(pty.openpty()[1]) as terminal:
        facts = tree.facts(port, terminal.fileno())
    assert (facts.driver, facts.vid_pid, facts.ftdi) == ("cdc_acm", "2e8a:000a", False)
    assert facts.low_latency is None
    assert facts.latency_timer_ms is None


def test_a_uart_of_the_machine_belongs_to_no_usb_device(tree: Tree) -> None:
    facts = tree.facts(tree.plug("ttyS0", "serial8250"))
    assert (facts.driver, facts.vid_pid, facts.serial_number, facts.by_id) == ("serial8250", None, None, ())


def test_a_port_that_is_not_there_and_a_pseudo_terminal_are_unknown_and_no_problem(tree: Tree) -> None:
    for port in (str(tree.root / "dev/ttyUSB7"), "/dev/pts/0"):
        facts = tree.facts(port)
        assert facts == PortFacts(port=port, device=port)
        assert facts.problems() == []


@pytest.mark.parametrize(
    ("changed", "command"),
    [
        ({"driver": "serial8250", "low_latency": False}, "sudo setserial /dev/ttyS0 low_latency"),
        ({"hangs_up": True}, "stty -F /dev/ttyS0 -hupcl"),
        ({"exclusive": False}, "fuser -v /dev/ttyS0"),
        ({"driver": "ch341-uart", "low_latency": False}, None),  # it has no such mode
        ({"low_latency": None, "exclusive": None, "dtr": None}, None),
    ],
)
def test_a_problem_has_the_command_that_removes_it(changed: Any, command: str | None) -> None:
    problems = PortFacts(port="/dev/ttyS0", device="/dev/ttyS0", **changed).problems()
    assert len(problems) == (command is not None)
    assert all(command in problem.remedy for problem in problems)


def test_a_pseudo_terminal_is_not_taken_for_the_console_of_the_same_number(tree: Tree) -> None:
    tree.plug("0", "ftdi_sio", **FTDI)
    assert tree.facts("/dev/pts/0").driver is None


def test_reading_the_facts_of_a_port_does_not_open_it(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening a port changes its modem lines, and may reset a running board."""
    port = tree.plug("ttyUSB0", "ftdi_sio", 16, **FTDI)
    opened = []
    real = os.open
    monkeypatch.setattr(
        module.os, "open", lambda path, *rest, **more: opened.append(path) or real(path, *rest, **more)
    )
    tree.facts(port)
    assert port not in opened
