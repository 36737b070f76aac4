"""The operator's terminal: what a session shows and asks there, and a STOP that needs no other process.

The session's program has the device and the log (`desk`); the console is a child (``python -m rig.session.terminal``)
that has the terminal, and that may hang or die without more harm than a hit that ends. They exchange JSON lines over
two pipes (`_messages`); besides, the console looks at the rows of the running loop in shared memory, and sets its stop
word.
"""
