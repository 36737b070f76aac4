"""The operator's terminal: what a session shows and asks there, and a STOP that needs no other process.

Two processes. The session's program has the device and the log; its side is `rig.session.terminal.desk.ConsoleDesk`.
The console is a child (``python -m rig.session.terminal``) that has the terminal, and that may hang or die without more
harm than a hit that ends. They talk JSON lines over two pipes (`messages`); besides, the console looks at the rows of
the running loop in shared memory, and sets its stop word.

===============  ===================================================================================================
`messages`       lines between the two
`asking`         the session's side over any line: questions with numbers, and what answers one
`desk`           that side here: the watch over the child
`child`          the child as a process: started, read, ended
`terminal`       how a terminal is taken and given back
`keyboard`       bytes from it → keys
`keymap`         keys → what they mean, from the protocol's ``[keys]``
`conversation`   what is shown and asked, and what a key does then; touches nothing
`held`           keys that were down before the question, which answer nothing until they are released
`live`           the running loop's newest rows → numbers
`seat`           all that a key, a message and the time come to, whatever shows it
`plain`          all of this as one line for each thing that changes
`pointer`        mouse or arrow keys → the simulated hand
`program`        the child's own loop
===============  ===================================================================================================
"""
