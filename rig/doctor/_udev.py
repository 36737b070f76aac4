"""Write the udev rules for rigs as text. Commands print the text; no code of this package installs the rules."""

from collections.abc import Iterable

from firmware_protocol.messages import USB_PRODUCT, USB_VENDOR
from rig.realtime.scheduling.refusals import GROUP, RULES_COMMAND, RULES_FILE

RIGS = ((USB_VENDOR, USB_PRODUCT),)  # every board with the firmware of this project

_HEAD = f"""\
# haptic-rig: rules of the device manager for rigs.
#     {RULES_COMMAND}
# The name {RULES_FILE} matters: after 60 (names), before 73 (access of who sits here).

"""
_RIG = """\
# Rig {vendor}:{product}: not a modem; yours when you sit here or are in dialout; named after its serial number.
SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", ATTR{{idVendor}}=="{vendor}", ATTR{{idProduct}}=="{product}", \
ENV{{ID_MM_DEVICE_IGNORE}}="1", GROUP="dialout", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="tty", ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", \
ENV{{ID_MM_DEVICE_IGNORE}}="1", ENV{{ID_MM_PORT_IGNORE}}="1", GROUP="dialout", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="tty", ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", ENV{{ID_SERIAL_SHORT}}=="?*", \
SYMLINK+="haptic-rig-$env{{ID_SERIAL_SHORT}}"

"""
_TAIL = f"""\
# FTDI adapters, all of them: hand bytes over after 1 ms, not after 16.
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{{latency_timer}}="1"

# Real-time programs may keep processors from deep sleep while they run.
KERNEL=="cpu_dma_latency", GROUP="{GROUP}", MODE="0660", TAG+="uaccess"
"""


def udev_rules(rigs: Iterable[tuple[int, int]] = RIGS) -> str:
    """Return the text of a udev rules file that lets users open rigs and makes ModemManager ignore rigs.

    Parameters
    ----------
    rigs
        USB vendor and product identifier of each kind of rig.
    """
    parts = [
        _RIG.format(vendor=f"{vendor:04x}", product=f"{product:04x}")
        for vendor, product in dict.fromkeys(rigs)
    ]
    return _HEAD + "".join(parts) + _TAIL
