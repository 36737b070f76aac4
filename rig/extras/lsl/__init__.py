"""Lab Streaming Layer: what a running loop does, as streams for other recorders on the network.

A process of its own looks at the loop's ring (`rig.realtime.ring`) and never writes into it, so that no receiver,
however slow, can delay a tick. `follow` turns rows into samples and markers on the host's clock and knows nothing of
the network; `streams` are the outlets; `serve` joins the two; `session` is what a session says to such a process.
"""
