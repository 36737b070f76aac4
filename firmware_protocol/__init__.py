"""The wire protocol of a haptic rig: frames, messages, parameters, states.

Nothing here touches a port, a clock or a thread. Bytes go in, events come out (`Connection`), and the same
class serves the host and the device. `PROTOCOL.md` beside this file shows every byte.
"""
