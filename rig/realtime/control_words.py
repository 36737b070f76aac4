"""Index, writer and meaning of each control word in a running loop's shared memory (`rig.realtime.ring`).

The loop, the recorder, `rig stop`, `rig set`, the console and LSL address the words by these numbers. Every word has
one writer. Words 0 to 3 and 7 have the same index in all versions, so that a run of any version can be stopped. If the
index of a word changes, change `LAYOUT_VERSION` too. This file imports nothing, because `rig stop` reads it first.
"""

LAYOUT_VERSION = 4
CONTROL_BYTES = 512

# Value of STOP after the owner has stopped waiting: link and descriptors may be reused, the loop must not use them.
ABANDONED = 2

# word                 writer       meaning
VERSION = 0  # creator     layout version, stored last
HEAD = 1  # loop        rows written so far
TAIL = 2  # recorder    rows drained so far
STOP = 3  # any process non-zero: the loop ends within one tick; below zero: minus that process
DROPPED = 4  # loop        rows lost because the ring was full
TICKS = 5  # loop        steps of the law so far
PHASE = 6  # loop        rig.core.sample.Phase now
LOOP_DONE = 7  # loop        1 when the loop has returned and will write nothing more
HEARTBEAT = 8  # supervisor  time (ns, loop's clock) until which the loop may run; 0 switches the check off
RECORDER_ERROR = 9  # recorder    0, or the errno that stopped the recorder
RECORDED = 10  # recorder    rows that are in the file
END_REASON = 11  # loop        why the loop ended (rig.loop.layout.EndReason)
END_ERRNO = 12  # loop        errno behind a broken link, else 0
INFO = 13  # who posts   length and place of the info
CREATED = 14  # creator     when the block was made (ns, CLOCK_REALTIME)
ROW_BYTES = 15  # creator     bytes of a row
# Counters of the link, written by the loop.
FRAMES = 16  # frames received whole
BAD_FRAMES = 17  # frames with a wrong checksum, encoding or length
OTHER_FRAMES = 18  # frames that were not STATE of this session
DUPLICATED = 19  # samples received twice
REORDERED = 20  # samples older than one already seen
LOST = 21  # samples that never arrived
COMMANDS = 22  # commands sent
UNSENT = 23  # commands that the link did not take whole
LATE = 24  # samples received more than one period after the grid
SKIPPED = 25  # samples that arrived, but behind a newer one that the law saw instead
STALE = 26  # ticks of a host-paced loop without a fresh sample
OVERRUNS = 27  # grid points of a host-paced loop that passed before it woke
EXCHANGES = 28  # clock exchanges completed
PARAMETER_SET = 29  # number of the active parameter set
CLOCK = 30  # loop        stamps of the last two clock exchanges, 8 words (`Ring.clock_exchange`)
CREATOR = 63  # creator     its process, as it calls itself
