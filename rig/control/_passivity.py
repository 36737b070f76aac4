"""Time-domain passivity controller: damping that takes back the energy which a wall has given too much.

The observer is the watch's sum of effort times travel (`rig.control._watch.add_energy`), of the effort that was
sent less the constant push of an automated trial. Where it is above zero inside the wall, damping is added that would
take the excess E within one tick at the present speed, B = E/(v²·T), but at most `limit`. A sampled damper is itself
passive only up to a bound (for a mass J and no delay B < 2·J/T, less with a filter and with delay), so a limit far
above what the rig renders stably makes the controller the source of the oscillation. At a speed of zero nothing can be
taken back, and with an estimate that rounds to zero the excess waits for motion: a limit cycle of one count is not
damped. The controller never reverses the wall's reaction: a wall that may not pull does not begin to.

Source: Hannaford and Ryu 2002, "Time-domain passivity control of haptic interfaces", the impedance causality; the limit
and the rule about reversal are ours.
"""

from __future__ import annotations

from rig.realtime.kernel import kernel


@kernel("f8(f8, f8, f8, f8, f8)", inline=True)
def damped(reaction: float, energy: float, inwards: float, limit: float, tick_s: float) -> float:
    """Return the wall's reaction with the damping that its energy asks for.

    Parameters
    ----------
    reaction
        Of the wall alone (N·m or N), positive out of it.
    energy
        What the wall has given more than it took (J).
    inwards
        Velocity into the wall (rad/s or m/s).
    limit
        Largest damping (N·m·s/rad or N·s/m).
    """
    if energy <= 0.0 or inwards == 0.0:
        return reaction
    # As E/(v·T), because v² of a slow handle underflows.
    wanted = energy / (abs(inwards) * tick_s)
    added = min(wanted, limit * abs(inwards))
    if inwards > 0.0:
        return reaction + added
    return min(reaction, max(reaction - added, 0.0))
