"""Base of compiled code: decorator, plug types, atomics, codec, ring, mailbox, clocks, scheduling, system calls."""
