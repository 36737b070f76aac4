"""The error for what a law on the device cannot do."""

from __future__ import annotations

from rig.core.errors import PlanError

ELSE_HOST = 'let the host run the law (controller.loop = "host")'


def refusal(key: str, value: object, why: str, remedy: str) -> PlanError:
    """Error for a key whose value a law on the device does not support."""
    shown = f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else value
    return PlanError(
        f'{key} = {shown} with controller.loop = "device": {why}', remedy=f"{remedy}, or {ELSE_HOST}"
    )
