"""The operator's terminal: display a session, ask questions, and stop the rig even if the session's process hangs.

The session's process controls the device and writes the log (`desk`). The console, which controls the terminal, is a
child process (``python -m rig.session.terminal``); if the console hangs or dies, only the current hit ends. The two
processes exchange JSON lines over two pipes (`_messages`). The console also reads the rows of the running control loop
in shared memory, and can set the loop's stop word.
"""
