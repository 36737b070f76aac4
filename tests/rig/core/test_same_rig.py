"""A device must match the experiment's rig; otherwise the error names both values of each difference."""

from dataclasses import replace
from typing import Any

import pytest

from firmware_protocol.dictionary import ConstantInfo, Dictionary, SettingInfo, decode, encode
from rig import config
from rig.config import presets
from rig.core.board import describe
from rig.core.check import Outcome
from rig.core.model import Reference, RigModel
from rig.core.same_rig import FRICTION_SHARE, check_rig

MODEL = config.rig_model(presets.load("koul-compliant"))
AMPLIFIER, ENCODER, MECHANICS = MODEL.amplifier, MODEL.encoder, MODEL.mechanics


def built_for(model: RigModel, **changes: Any) -> Dictionary:
    settings = changes.pop("settings_of_board", None)
    dictionary = describe(
        model, firmware="1", simulated=False, rate_default=1_000, rate_maximum=50_000, settings=settings
    )
    return replace(dictionary, **changes)


def with_amplifier(**changes: Any) -> RigModel:
    return replace(MODEL, amplifier=replace(AMPLIFIER, **changes))


def with_mechanics(**changes: Any) -> RigModel:
    return replace(MODEL, mechanics=replace(MECHANICS, **changes))


@pytest.mark.parametrize("name", presets.names())
def test_a_device_of_the_rig_is_accepted(name: str) -> None:
    model = config.rig_model(presets.load(name))
    found = check_rig(model, built_for(model))
    assert (found.outcome, "does not report" in found.text) == (Outcome.OK, False)


OTHERS = {
    "name": (replace(MODEL, name="other"), "the device is named other"),
    "quantum": (
        with_amplifier(current_quantum_a=2e-3),
        "quantum (A): 0.002 on the device, 0.001 in the experiment",
    ),
    "effort for an ampere": (
        with_amplifier(effort_per_ampere=0.468),
        "effort_quantum (N·m): 0.000468 on the device",
    ),
    "most that the amplifier gives": (
        with_amplifier(effort_limit=2.6),
        "effort_limit (N·m): 2.6 on the device, 1.3 in the experiment",
    ),
    "over-current": (with_amplifier(effort_limit=2.6), "over_current (quantum): 12222 on the device"),
    "direction of counting": (replace(MODEL, encoder=replace(ENCODER, sign=-ENCODER.sign)), "encoder_sign"),
    "resolution": (replace(MODEL, encoder=replace(ENCODER, ratio=2.0 * ENCODER.ratio)), "travel (rad)"),
    "inertia": (with_mechanics(link_inertia=10 * MECHANICS.link_inertia), "inertia (kg·m²)"),
    "friction": (with_mechanics(motor_coulomb=MECHANICS.motor_coulomb + 0.1), "friction (N·m)"),
    "lag": (with_amplifier(lag_s=3e-4), "lag_s (s): 0.0003 on the device, 0.0001 in the experiment"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_device_of_another_rig_is_refused_with_both_values(name: str) -> None:
    model, words = OTHERS[name]
    found = check_rig(MODEL, built_for(model))
    assert found.outcome is Outcome.REFUSED
    assert words in found.text
    assert "rig" in found.remedy


def test_identified_values_may_differ_by_less_than_the_stall_check_tolerates() -> None:
    near = with_mechanics(
        link_inertia=3 * MECHANICS.link_inertia,
        motor_coulomb=MECHANICS.motor_coulomb + 0.9 * FRICTION_SHARE * AMPLIFIER.effort_limit,
    )
    assert check_rig(MODEL, built_for(near)).outcome is Outcome.OK


def test_a_value_that_the_device_does_not_report_is_named_and_not_refused() -> None:
    found = check_rig(MODEL, built_for(MODEL, constants=()))
    assert found.outcome is Outcome.OK
    assert "does not report over_current (quantum), effort_quantum (N·m)" in found.text
    strange = check_rig(MODEL, built_for(MODEL, constants=(ConstantInfo("colour", "", 1.0),)))
    assert strange.outcome is Outcome.OK


def test_pins_and_scales_that_the_experiment_names_are_those_of_the_board() -> None:
    model = replace(MODEL, board=(("enable_pin", 6), ("full_scale", 12.0)))
    board = {"enable_pin": 6, "full_scale": 12, "pwm_pin": 8}
    dictionary = decode(encode(built_for(MODEL, settings_of_board=board)))
    assert check_rig(model, dictionary).outcome == Outcome.OK
    other = check_rig(model, replace(dictionary, settings=(SettingInfo("enable_pin", 10),)))
    assert other.outcome == Outcome.REFUSED
    assert "enable_pin of its board: 10 on the device, 6 in the experiment" in other.text
    assert "full_scale of its board: not reported on the device, 12.0 in the experiment" in other.text
    assert check_rig(model, replace(dictionary, settings=(), simulated=True)).outcome == Outcome.OK


def test_a_board_without_the_index_or_the_switch_of_the_rig_is_refused() -> None:
    model = replace(MODEL, reference=Reference(index=True, limit_switch="minimum", travel=1.0))
    bare = built_for(MODEL, settings_of_board={"encoder_index": "none", "limit_switch": "none"})
    refused = check_rig(model, bare)
    assert refused.outcome == Outcome.REFUSED
    assert "encoder_index of its board: none on the device, wired in the experiment" in refused.text
    assert "limit_switch of its board: none on the device, wired in the experiment" in refused.text
    wired = replace(bare, settings=tuple(SettingInfo(info.name, "wired") for info in bare.settings))
    assert check_rig(model, wired).outcome == Outcome.OK
    # A board without these settings.
    assert check_rig(model, replace(bare, settings=())).outcome == Outcome.OK
