"""Check that a device was built for the experiment's rig: the same name, scales, limits and monitors.

Experiments, sessions and firmware checks call it before a device moves. It must not change the experiment.
"""

import math

from firmware_protocol.dictionary import Dictionary, SettingValue
from rig.core.board import describe
from rig.core.check import Check, Outcome
from rig.core.model import RigModel

# What moves may have been identified anew since the firmware was built, or have an end mass now. The device's check of
# a stalled motor has a margin of three in time: of that an inertia of four times takes two. Damping has no part in the
# two counts that it waits for, friction may be larger by a twentieth of the effort limit. The comparison of currents
# was tried with half and twice the lag. All this as a share of the larger value.
SHARES = {"inertia": 0.75, "damping": 1.0, "lag_s": 0.5}
FRICTION_SHARE = 0.03  # of the effort limit
ROUNDING = 1e-6


def check_rig(model: RigModel, device: Dictionary) -> Check:
    """Check that a device was built for the experiment's rig `model`, by the description that it sent of itself.

    A failed check has both values of each difference. Constants that the description lacks are not compared; a passed
    check lists them.
    """
    ours = describe(
        model,
        firmware=device.firmware,
        simulated=device.simulated,
        rate_default=device.position_rate_default,
        rate_maximum=device.position_rate_maximum,
    )
    theirs, wanted = _known(device), _known(ours)
    differ = [
        f"{name}: {theirs[name]:g} on the device, {value:g} in the experiment"
        for name, value in wanted.items()
        if name in theirs and not _agree(name.split()[0], theirs[name], value, model.amplifier.effort_limit)
    ]
    differ += [] if device.simulated else _other_settings(model, device)
    if device.device != ours.device:
        differ = [f"the device is named {device.device}", *differ]
    if differ:
        return Check(
            "rig of the device",
            Outcome.REFUSED,
            f"{device.device} was built for another rig than {model.name}: {'; '.join(differ)}",
            f"open another device, give `rig` {device.device}, or build and flash the firmware of "
            f"{model.name}",
        )
    unreported = ", ".join(name for name in wanted if name not in theirs)
    text = f"{device.device}, of the same scales and limits as {model.name}"
    return Check(
        "rig of the device", Outcome.OK, f"{text}; it does not report {unreported}" if unreported else text
    )


def _other_settings(model: RigModel, device: Dictionary) -> list[str]:
    of_device = {info.name: info.value for info in device.settings}
    wanted = {
        **{name: value for name, value in _inputs(model).items() if name in of_device},
        **dict(model.board),
    }
    return [
        f"{name} of its board: {of_device.get(name, 'not reported')} on the device, {value} in the experiment"
        for name, value in wanted.items()
        if of_device.get(name) != value
    ]


def _inputs(model: RigModel) -> dict[str, SettingValue]:
    given = model.reference
    needed = {"encoder_index": given.index, "limit_switch": given.limit_switch != "none"}
    return {name: "wired" for name, wanted in needed.items() if wanted}


def _agree(name: str, theirs: float, ours: float, effort_limit: float) -> bool:
    slack = FRICTION_SHARE * effort_limit if name == "friction" else 0.0
    return math.isclose(theirs, ours, rel_tol=SHARES.get(name, ROUNDING), abs_tol=slack)


def _known(dictionary: Dictionary) -> dict[str, float]:
    found = {"current quantum (A)": dictionary.current_quantum_a}
    for name, unit in (("motion", ""), ("encoder_sign", ""), ("current_limit", " (quantum)")):
        if (info := dictionary.parameter(name)) is not None:
            found[name + unit] = info.maximum
    return found | {f"{constant.name} ({constant.unit})": constant.value for constant in dictionary.constants}
