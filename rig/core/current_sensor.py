"""Parameters that predict the measured motor current from the commanded one; host and device use the same numbers.

`rig.core.board` computes them; the loop and the C board use them. It must not import the description of a rig, because
a loop loads only this file.
"""

from dataclasses import dataclass

SPEED_LAG_S = 2.5e-3  # over which the comparison of currents smooths the count's speed, for the back-EMF


@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentSensor:
    """Parameters that predict the measured motor current from the commanded current (`rig.control.current`).

    The firmware's `struct current_sensor` has the same fields.

    Attributes
    ----------
    noise
        Noise of a measurement (quanta, rms), including its quantisation and, with back-EMF, that of the encoder count;
        negative: the currents are not compared.
    lag_s
        Time constant of the first-order lag from the set current to the motor current (s).
    delay_s
        Delay of the set-point to the amplifier, before the lag (s).
    back_emf
        Reduction of the current by the back-EMF at one count per second (quanta·s); 0 for a current amplifier.
    """

    noise: float
    lag_s: float
    delay_s: float
    back_emf: float
