"""Base of compiled code: decorator, function types, atomics, codec, ring, mailbox, clocks, scheduling, system calls.

All packages with kernels import it. It must not import another package of `rig` except `rig.core`.
"""
