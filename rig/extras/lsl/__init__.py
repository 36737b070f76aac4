"""Send the samples and events of running control loops to recorders on the network, by Lab Streaming Layer (LSL).

A process of its own reads the loop's ring buffer in shared memory (`rig.realtime.ring`) and never writes to it, so that
a slow receiver cannot delay a tick. `follow` converts rows to samples and markers on the host's clock, without network
code; `streams` are the outlets; `serve` connects them; `session` sends a session's markers to such a process.
"""
