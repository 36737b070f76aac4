"""The operator's terminal: it displays a session, asks its questions, and stops the rig without another process.

The session's program controls the device and the log (`desk`). The console is a child process (``python -m
rig.session.terminal``) that controls the terminal; if it hangs or dies, at worst the present hit ends. They exchange
JSON lines over two pipes (`_messages`). The console also reads the rows of the running loop in shared memory, and sets
its stop word.
"""
