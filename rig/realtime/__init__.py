"""Compiled code's ground: decorator, plug types, atomics, codec, ring, mailbox, clocks, scheduling, system calls."""
