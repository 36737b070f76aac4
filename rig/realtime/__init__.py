"""Base of compiled code: decorator, function types, atomics, codec, ring, mailbox, clocks, scheduling, system calls."""
