"""Conditions that end a run: too much energy, a violent oscillation, or an effort that does not move the count.

At the beginning of a tick `rig.control.step` evaluates the effort of the previous tick and the motion that followed.
Energy and oscillation are checked in the trial and its release, standstill while the motor moves a free handle. These
functions are part of the compiled tick and must not allocate.

Source: Hannaford and Ryu 2002, "Time-domain passivity control of haptic interfaces", for the observer. The rules about
oscillations and standstill are defined by this project.
"""

from rig.realtime.kernel import kernel

HIGH, LOW = 0.9, 0.1  # shares of the effort limit between which an oscillation rises
UNMOVED_SPEED = 0.5  # share of the speed limit that a handle may reach before a dead encoder is detected
UNMOVED_COUNTS = 2.0  # that a handle may travel on two neighbouring counts
# Travel required for an oscillation: a share of the verdict's threshold *moved*, and more than one toggling count.
TRAVEL, TRAVEL_COUNTS = 0.25, 1.5


@kernel("f8(f8, f8, f8, b1)", inline=True)
def add_energy(before: float, effort: float, travel: float, free: bool) -> float:
    """Return the energy (J) that the motor has given so far: `before` plus effort (N·m or N) times travel (rad or m).

    In free space (`free`) the result is at least 0: energy that damping has absorbed there is no credit for the next
    contact.
    """
    # A passivity observer: a passive wall returns at most the energy that it took, so with a person at the handle the
    # sum stays at or below zero; a motor that pushes adds the work of its push.
    # The effort is the one that was sent: where it acts d ticks later, the sum is off by effort times the travel in d
    # ticks. A sampled wall leaks: a count that is left and entered again gives stiffness times the count squared.
    given = before + effort * travel
    # In free space a wall stores nothing: energy that damping dissipated must be no credit for the next contact.
    return max(given, 0.0) if free else given


# A dead encoder, or one with a dead channel, shows at most two neighbouring counts. While the count stays on them, a
# free handle gathers the momentum p = ∫(effort − friction) dt; a handle that friction holds gathers none. If p exceeds
# the inertia times a share of the speed limit (`UNMOVED_SPEED`), the encoder is dead or the rig is blocked.
# Let v_b be that speed, and v_0 the speed of the handle when the encoder failed. A rig with at least the described
# friction and inertia, whatever its damping, is then never faster than v_b + max(v_b, v_0). For e = v − p/I obeys I ė =
# −b v − (F(v) − F(p/I)) with a friction F that rises with speed, hence e ė < 0 wherever |e| > |p|/I: |e| never grows
# beyond the larger of v_0 and v_b.
# Standstill is checked where only friction may hold the handle: in homing, and in a trial's push outside of the wall,
# but not while the slew limit acts. Ticks with lost samples are not counted: if a share s is lost, v_b is larger by
# 1/(1 − s).
@kernel("f8(f8, f8, f8, f8)", inline=True)
def free_impulse(before: float, effort: float, held: float, time_s: float) -> float:
    """Return the momentum (N·m·s or N·s) of a free handle: `before` plus effort times time, reduced by friction.

    `held` is the effort that friction and weight can hold without motion (N·m or N).
    """
    # `held` contains the weight: no motor removes what weight does to a handle.
    after, lost = before + effort * time_s, held * time_s
    return after - min(max(after, -lost), lost)


@kernel("i8(f8, f8, f8, f8, f8)", inline=True)
def extreme(reaction: float, limit: float, lowest: float, highest: float, travel: float) -> int:
    """Return −1 if the wall's reaction is next to zero, 1 if it is near its limit after enough travel, else 0.

    Parameters
    ----------
    reaction, limit
        Reaction of the wall, positive out of the wall, and the largest effort that is sent (N·m or N).
    lowest, highest, travel
        Extreme positions of the handle since the last oscillation, and the travel required between them (rad or m).
    """
    # An oscillation is the effort against the handle rising from next to zero (`LOW`) to its limit (`HIGH`) after
    # enough travel. The defaults are in `rig.config._sections`; the simulations behind them are in
    # `rig/session/README.md`.
    # From next to zero to the limit: an impact is one oscillation and a bounce another, each smaller; a buzz does not
    # span the range. One count of a coarse encoder that makes the whole effort cannot be distinguished from a buzz.
    if reaction <= LOW * limit:
        return -1
    return 1 if reaction >= HIGH * limit and highest - lowest > travel else 0
