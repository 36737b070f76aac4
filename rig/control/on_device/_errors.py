"""Error for a setting that a law on the device does not support."""

from rig.core.errors import PlanError

ELSE_HOST = 'let the host run the law (controller.loop = "host")'


class NotOnDeviceError(PlanError):
    """A law on the device does not support a setting; `why` is the reason, `instead` the alternative setting."""

    def __init__(self, key: str, shown: object, why: str, instead: str) -> None:
        super().__init__(
            f'{key} = {shown} with controller.loop = "device": {why}', remedy=f"{instead}, or {ELSE_HOST}"
        )
        self.why = why
        self.instead = instead


def refusal(key: str, value: object, why: str, remedy: str) -> NotOnDeviceError:
    """Return the error, with reason and remedy, for a key of the experiment that a law on the device cannot have."""
    shown = f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else value
    return NotOnDeviceError(key, shown, why, remedy)
