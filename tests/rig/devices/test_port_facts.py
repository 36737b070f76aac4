"""Properties of serial ports, read from sysfs trees like those of real adapters."""

import os
import pty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.devices import _tty as tty
from rig.devices import port_facts as module
from rig.devices.port_facts import PortFacts, port_facts


class Tree:
    """A directory with ``sys`` and ``dev``, in which ports are added one by one."""

    def __init__(self, root: Any) -> None:
        self.root = root
        (root / "dev").mkdir()

    def plug(
        self,
        name: Any,
        *,
        driver: Any,
        vendor: Any = None,
        product: str = "6001",
        serial: Any = None,
        title: Any = None,
        latency: Any = None,
        by_id: Any = None,
    ) -> Any:
        """Make the files that the kernel makes for a port."""
        sysfs = self.root / "sys"
        if vendor is None:
            node = sysfs / "devices/platform" / name
        else:
            usb = sysfs / "devices/pci0/usb1/1-1"
            node = usb / "1-1:1.0" / (name if driver != "cdc_acm" else "")
            node.mkdir(parents=True)
            for attribute, text in (
                ("idVendor", vendor),
                ("idProduct", product),
                ("serial", serial),
                ("product", title),
            ):
                if text is not None:
                    (usb / attribute).write_text(f"{text}\n")
        node.mkdir(parents=True, exist_ok=True)
        drivers = sysfs / "bus/usb-serial/drivers" / driver
        drivers.mkdir(parents=True)
        (node / "driver").symlink_to(drivers)
        tty_class = sysfs / "class/tty" / name
        tty_class.mkdir(parents=True)
        (tty_class / "device").symlink_to(node)
        if latency is not None:
            (node / "latency_timer").write_text(f"{latency}\n")
            bus = sysfs / "bus/usb-serial/devices"
            bus.mkdir(parents=True)
            (bus / name).symlink_to(node)
        port = self.root / "dev" / name
        port.touch()
        if by_id is not None:
            names = self.root / "dev/serial/by-id"
            names.mkdir(parents=True, exist_ok=True)
            (names / by_id).symlink_to(f"../../{name}")
            (names / "usb-another-device").symlink_to("../../ttyS9")
        return str(port)

    def facts(self, port: Any, descriptor: Any = None) -> Any:
        return port_facts(port, descriptor, root=self.root)


@pytest.fixture
def tree(tmp_path: Path) -> Any:
    return Tree(tmp_path)


def test_an_ftdi_adapter_with_its_timer_as_it_comes(tree: Tree) -> None:
    port = tree.plug(
        "ttyUSB0",
        driver="ftdi_sio",
        vendor="0403",
        serial="A50285BI",
        title="FT232R USB UART",
        latency=16,
        by_id="usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0",
    )
    facts = tree.facts(port)
    assert (facts.driver, facts.vid_pid, facts.serial_number) == ("ftdi_sio", "0403:6001", "A50285BI")
    assert facts.product == "FT232R USB UART"
    assert facts.ftdi
    assert facts.latency_timer_ms == 16
    assert [os.path.basename(name) for name in facts.by_id] == [
        "usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0"
    ]
    (problem,) = facts.problems()
    assert "16 ms" in problem.text
    assert problem.remedy.startswith("echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer;")
    assert "--print-udev" in problem.remedy
    assert tree.facts(facts.by_id[0]).vid_pid == "0403:6001", "the name that stays leads to the same port"


@pytest.mark.parametrize(("latency", "known_ms"), [(1, 1), ("soon", None)])
def test_an_ftdi_adapter_at_one_millisecond_or_without_a_timer_is_no_problem(
    latency: Any, known_ms: Any, tree: Tree
) -> None:
    facts = tree.facts(tree.plug("ttyUSB1", driver="ftdi_sio", vendor="0403", latency=latency))
    assert facts.ftdi
    assert facts.latency_timer_ms == known_ms
    assert facts.problems() == []


def test_a_board_that_is_a_usb_device_itself_has_no_latency_mode(
    tree: Tree, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tty, "low_latency", lambda descriptor: False)
    port = tree.plug("ttyACM0", driver="cdc_acm", vendor="2e8a", product="000a", serial="E66038B713")
    master, slave = pty.openpty()
    try:
        facts = tree.facts(port, slave)
    finally:
        os.close(master)
        os.close(slave)
    assert (facts.driver, facts.vid_pid, facts.ftdi) == ("cdc_acm", "2e8a:000a", False)
    assert facts.low_latency is None
    assert facts.latency_timer_ms is None


def test_a_uart_of_the_machine_belongs_to_no_usb_device(tree: Tree) -> None:
    facts = tree.facts(tree.plug("ttyS0", driver="serial8250"))
    assert (facts.driver, facts.vid_pid, facts.serial_number, facts.by_id) == ("serial8250", None, None, ())


def test_a_port_that_is_not_there_and_a_pseudo_terminal_are_unknown_and_no_problem(tree: Tree) -> None:
    for port in (str(tree.root / "dev/ttyUSB7"), "/dev/pts/0"):
        facts = tree.facts(port)
        assert facts == PortFacts(port=port, device=port)
        assert facts.problems() == []


def test_a_pseudo_terminal_is_not_taken_for_the_console_of_the_same_number(tree: Tree) -> None:
    tree.plug("0", driver="ftdi_sio", vendor="0403")
    assert tree.facts("/dev/pts/0").driver is None


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


# ---------------------------------------------------------------------- the line itself, on a pseudo-terminal


@pytest.fixture
def slave() -> Iterator[Any]:
    master, slave = pty.openpty()
    yield slave
    os.close(slave)
    os.close(master)


def test_settings_are_read_back_as_they_were_set(slave: Any) -> None:
    tty.configure(slave)
    assert tty.blocks_for_a_byte(slave)
    assert tty.hangs_up(slave) is False
    assert os.get_blocking(slave) is False
    for wanted in (True, False):
        assert tty.set_exclusive(slave, wanted) is wanted
        assert tty.is_exclusive(slave) is wanted


def test_reading_the_facts_of_a_port_does_not_open_it(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening a port changes its modem lines, and may reset a running board."""
    port = tree.plug("ttyUSB0", driver="ftdi_sio", vendor="0403", latency=16)
    opened = []
    real = os.open
    monkeypatch.setattr(
        module.os, "open", lambda path, *rest, **more: opened.append(path) or real(path, *rest, **more)
    )
    tree.facts(port)
    assert port not in opened
