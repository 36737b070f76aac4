"""What ends a run before anybody is hurt: energy that the motor gives, and a wall that beats.

Both look, at the beginning of a tick, at the effort of the tick before and at how far the handle has moved under it.
They watch the trial and its release; homing has a servo of its own, whose effort is small.

**Energy.** The sum of effort times change of position is what the motor has given to the handle (a passivity observer).
A passive wall gives back at most what it took, so against a person's hand the sum stays at or below zero; a motor that
pushes adds the work of its push. In free space a wall stores nothing: what it took until then, by its damping say, is
forgotten there, so that it is no licence for the next contact. Two things belong to the reading. A sampled and
quantised wall leaks: a count that is left and entered again gives stiffness times the count squared. And the effort is
what was sent: where it acts d ticks later, the sum is off by effort times the travel of d ticks.

**Violence.** A *swing* is the effort against the handle rising from next to nothing (`LOW`) to its limit (`HIGH`) after
the handle has moved by a quarter of what the verdict calls *moved*, and by more than one count that toggles. An impact
is one swing and a bounce another, each smaller; a buzz does not reach both ends. So many swings in a row, none much
later than the one before, are a wall that throws the handle to and fro as hard as the motor can.

The defaults (`rig.core.swings`) are measured in 3,633 simulated hits: three rigs, three grips and a motor's push, the
motor's limit and a person's, five ways to sample, walls from soft to three times the stiffest that holds. None of 1,163
stable ones and 69 limit cycles is ended, nor would be with seven in a row; with six one stable one is. Of the 2,348
unstable ones 1,474 are, half of them within 88 ms of the first contact; the others swing less than fifty times a second
or not to the limit. What is not told from a buzz is one count of a coarse encoder that makes the whole effort.

Source: Hannaford and Ryu 2002, "Time-domain passivity control of haptic interfaces", for the observer. The rule about
swings is ours.
"""

from __future__ import annotations

from rig.realtime.kernel import kernel

HIGH, LOW = 0.9, 0.1  # shares of the effort limit between which a swing goes
TRAVEL, TRAVEL_COUNTS = 0.25, 1.5  # of the handle: share of what the verdict calls moved; counts at least


@kernel("f8(f8, f8, f8, b1)", inline=True)
def energy_given(before: float, effort: float, travel: float, free: bool) -> float:
    """Energy that the motor has given (J) after a travel (rad or m) under an effort (N·m or N), in free space or no."""
    given = before + effort * travel
    return max(given, 0.0) if free else given


@kernel("i8(f8, f8, f8, f8, f8)", inline=True)
def swung(reaction: float, limit: float, lowest: float, highest: float, travel: float) -> int:
    """What a reaction of the wall means: −1 where it is next to nothing, 1 at its limit after a travel, else 0.

    Parameters
    ----------
    reaction, limit
        Effort against the wall's side, and the most that is sent (N·m or N).
    lowest, highest, travel
        Positions of the handle since the last swing, and how far they must be apart (rad or m).
    """
    if reaction <= LOW * limit:
        return -1
    return 1 if reaction >= HIGH * limit and highest - lowest > travel else 0
