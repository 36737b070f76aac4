"""Error numbers of links: each becomes one typed error with cause and remedy."""

import errno
from typing import Any

import pytest

from rig.core import errors
from rig.devices._failures import FAILURES, error_number, failure, link_error

USB, SERIAL = "usb://1209:0001", "serial:///dev/ttyACM0"


@pytest.mark.parametrize(
    ("number", "on_usb", "on_serial"),
    [
        (errno.ENODEV, errors.UnpluggedError, errors.UnpluggedError),
        (errno.ESHUTDOWN, errors.UnpluggedError, errors.UnpluggedError),
        (errno.EPIPE, errors.StalledError, errors.UnpluggedError),
        # A terminal reports EIO when the cable is pulled.
        (errno.EIO, errors.BrokenLineError, errors.UnpluggedError),
        (errno.EPROTO, errors.BrokenLineError, errors.BrokenLineError),
        (errno.ETIMEDOUT, errors.BlockedError, errors.BlockedError),
        (errno.EOVERFLOW, errors.OverflowedError, errors.OverflowedError),
        (errno.EREMOTEIO, errors.CutShortError, errors.CutShortError),
        (errno.EBADF, errors.LinkLostError, errors.LinkLostError),
        (0, errors.LinkLostError, errors.LinkLostError),
    ],
)
def test_each_number_has_its_error(number: Any, on_usb: Any, on_serial: Any) -> None:
    assert failure(number, USB).kind is on_usb
    assert failure(number, SERIAL).kind is on_serial


def test_every_error_has_its_device_and_a_remedy() -> None:
    for number in (*FAILURES, errno.EBADF, 0):
        error = link_error(number, USB)
        assert isinstance(error, errors.LinkLostError)
        assert error.exit_code == errors.LinkLostError.exit_code
        assert error.message.startswith(USB)
        assert error.remedy


def test_the_place_is_shown_where_one_is_given() -> None:
    assert link_error(errno.ENODEV, SERIAL, "/dev/ttyACM0").message.startswith("/dev/ttyACM0 is gone")


def test_exceptions_become_numbers() -> None:
    assert error_number(OSError(errno.EPIPE, "x")) == errno.EPIPE
    assert error_number(TimeoutError("x")) == errno.ETIMEDOUT
    assert error_number(ValueError("x")) == errno.EIO
