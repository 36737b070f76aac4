"""What lost and late samples do to a verdict: the study from which the limits of `[verdict]` for them come.

What counts as changed, and how limits follow, was written before the first result.

**A series** is one case (rig, scheme, damping, held or not), one encoder offset and one seed: its limit K_max is the
highest stiffness that passes (criterion *any*, by the recorded signals) below every failure, on a ladder of rungs of
ratio 1.06, from eight rungs below the case's K_max to eight above. A ladder has the same rungs with and without losses.

**Changed** is a series whose limit lies more than one rung (6 %) away from its limit without losses, up or down. Near
the limit a hit is sensitive to anything, so what counts is the excess over the **control**: the same series with
another seed, which puts the start elsewhere within the tolerance of homing (and gives a hand another tremor), as anyone
gets who hits the same wall twice.

**Harmless** is a pattern of losses when the share of changed series exceeds that of the control by less than 5
percentage points, at 95 % confidence (one-sided, normal approximation of the difference of two shares), over all cases
together; and when in no case of at least 40 series the difference itself is above 15 points, lest one rig pays for the
others.

**Hidden** is a hit that passes as recorded while the whole truth, every tick of it, fails under *any* of heard and
instability, which the same wall does not do without losses. Harmless patterns may not hide more, by 1 percentage point
of all hits, than the control, which is a clean hit that passes as recorded though its truth fails.

**Patterns**: one gap of n samples, in the approach (ending at most 50 ms before contact), at the impact (it begins less
than n samples before first contact or up to 10 ms after it), while settling (from then to the tail) and at rest (in the
tail); samples lost at random at a rate in each of these parts or everywhere; and the same with late samples: of a
stretch of ten samples each one comes n ticks late, so that the command before holds and those after are n ticks old.
A law that gets no sample computes no command, and the device holds the last one. After a command's lifetime (five
periods, 3 ms at least) it ramps to zero, which is a device that overruled the law, and invalid already: no longer gap
is in question. A release is not judged, so nothing is lost there.

**The variable** of a limit (samples, velocity periods or time) is the one in which the shares of one rig at several
rates, by length, differ least.

**Limits**: of each part, the longest gap and the largest rate of losses or late ticks that are harmless, and all those
tried below them; a rate is rounded down to the next of 1, 2, 5 · 10ⁿ. A part in which everything that was tried is
harmless has no limit: what is lost there is counted and told.
"""
