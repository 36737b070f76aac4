"""What lost samples and late ticks do to verdicts and K_max, by where in a hit they fall: limits of `[verdict]`.

    python -m tests.benchmarks.gaps            # the table in `rig/session/README.md`: some minutes on two cores
    python -m tests.benchmarks.gaps 8          # with so many ladders a cell

A *ladder* is nine walls, four rungs below to four above the stiffest that passes; a rung is a ratio of 1.06, the one of
every search. Each ladder begins within homing's tolerance of its start, and its walls are hit twice, without losses and
with the same ticks lost in each. Its K_max is the highest rung that passes (`any`) below every failure.

What is written here was written before the first result.

* **A ladder changes** when its K_max moves by more than one rung. One rung is what a search resolves.
* **A hit changes** when its kind is another one, `gaps` and `late` aside, and it is *hidden* when it then reads as
  stable though it was not. These are told; near the limit either may come of one count more or less.
* **The control** loses nothing: the K_max of each ladder beside that of the next ladder, begun elsewhere. What happens
  there is how far a limit is defined at all.
* **A cell** (rate, part of the hit, loss) pools the rigs of a rate. It is *harmless* when the share of changed ladders is
  at most 5 %, or at most that of the control; *harmful* when the lower end of its one-sided 95 % Clopper-Pearson
  interval is above both; else it is undecided.
* **A limit** is the greatest loss in a part up to which no cell is harmful at any rate: the longest gap from single gaps, the
  share from scattered losses. Of ticks and milliseconds that variable is the key under which the rates agree better (the
  ratio of their longest harmless gaps is nearer to 1). Where a part has no harmful cell up to the device's
  command lifetime, it has no limit: a longer gap lets the watchdog act, and a device that overrules the law makes a hit
  invalid whatever was lost. Parts with the same limit share a key.
* A late tick is one whose command misses the tick that it is for: the device holds the last one for one tick more.

The law over a gap: no fresh STATE, no step and no command; the device holds its last command, which lives for five
ticks, at least 3 ms; the next step is told how many ticks have passed, and a recording has no row for a lost sample.
"""
