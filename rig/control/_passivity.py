"""Time-domain passivity controller: damping that removes the excess energy of a wall.

The passivity observer is the sum E of effort times travel (`rig.control._watch.add_energy`), for the effort that was
active on the device minus the constant push of an automated trial. If E is above zero inside the wall, damping is
added that would remove E within one tick T at the present speed v, B = E/(v²·T), but at most `limit`.

`rig.control.step` calls it in each tick. It must not allocate.

Source: Hannaford and Ryu 2002, "Time-domain passivity control of haptic interfaces", the impedance causality; the limit
and the rule about reversal are defined by this project.
"""

from rig.realtime.kernel import kernel


@kernel("f8(f8, f8, f8, f8, f8)", inline=True)
def add_damping(reaction: float, energy: float, inwards: float, limit: float, tick_s: float) -> float:
    """Return a wall's reaction (N·m or N, positive out of the wall), with damping added if it has given energy.

    `reaction` is that of the wall alone, `energy` what the wall has given minus what it has absorbed (J), `inwards` the
    velocity into the wall (rad/s or m/s), and `limit` the largest damping that is added (N·m·s/rad or N·s/m).
    """
    # At an estimated speed of zero no energy can be removed, so a limit cycle of one count is not damped.
    if energy <= 0.0 or inwards == 0.0:
        return reaction
    # As E/(v·T), because v² of a slow handle underflows.
    wanted = energy / (abs(inwards) * tick_s)
    # A sampled damper is itself passive only up to a bound (for a mass J and no delay B < 2·J/T, less with a filter and
    # with delay): a limit far above the damping that the rig renders stably would cause an oscillation.
    added = min(wanted, limit * abs(inwards))
    if inwards > 0.0:
        return reaction + added
    # Never reversed: a wall that may not pull does not begin to pull.
    return min(reaction, max(reaction - added, 0.0))
