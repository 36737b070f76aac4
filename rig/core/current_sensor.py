"""Expected motor current for a given set current: the same numbers for host and device.

`rig.core.board` computes them; the loop and the C board take them. It must not import the description of a rig:
a loop loads this file alone.
"""

from __future__ import annotations

from dataclasses import dataclass

SPEED_LAG_S = 2.5e-3  # over which the comparison of currents smooths the count's speed, for the back-EMF


@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentSensor:
    """Numbers from which the expected measured current follows (`rig.control.current`).

    `struct current_sensor` of the firmware.

    Attributes
    ----------
    noise
        Noise of a measurement with its quantisation, and with that of the count if there is back-EMF (quanta, rms);
        negative: the current is not measured.
    lag_s
        First-order lag between the current that is set and the one that flows (s).
    delay_s
        Delay of the set-point to the amplifier, before the lag (s).
    back_emf
        Current that the back-EMF takes off at one count per second (quanta·s); 0 for a current amplifier.
    """

    noise: float
    lag_s: float
    delay_s: float
    back_emf: float
